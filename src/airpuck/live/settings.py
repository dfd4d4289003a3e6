"""Connection of a process to a graph: DDS domain, network and topics; and its duration."""

from __future__ import annotations

import os
import re
import socket
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

from airpuck.boundary import numbers
from airpuck.boundary.errors import InputError, check_known
from airpuck.boundary.settings import Setting, Settings

if TYPE_CHECKING:
    from airpuck.recording.mapping import Topics


_DOMAIN_VARIABLE = "ROS_DOMAIN_ID"
#: A killed process disappears from the graph after this long [s].
LEASE = 3
#: Largest number of processes of one domain on one machine that find each other by port.
_LOCAL_PEERS = (
    "<ParticipantIndex>auto</ParticipantIndex>"
    "<MaxAutoParticipantIndex>40</MaxAutoParticipantIndex>"
    '<Peers><Peer address="127.0.0.1"/></Peers>'
)


def domain_id(given: int | None) -> int:
    """Return the number of the DDS domain: as given, from the environment, or 0."""
    field, number = "--domain", given
    if number is None:
        field, text = _DOMAIN_VARIABLE, os.environ.get(_DOMAIN_VARIABLE, "").strip() or "0"
        number = int(text) if text.isdecimal() else -1
    numbers.DOMAIN.check(number, field)
    return number


def check_interface(name: str) -> None:
    """Raise InputError if this machine has no network interface of that name."""
    names = _interfaces()
    problem = f"there is no network interface {name!r}; there are {', '.join(names)}"
    check_known(name, names, problem, field="--interface")


def _interfaces() -> list[str]:
    return [name for _, name in socket.if_nameindex()]


def domain_config(interface: str | None) -> str:
    """Return Cyclone's configuration of a domain on an interface; None is loopback.

    On loopback there is no multicast: participants look for each other at the ports of 127.0.0.1,
    and no packet can leave the machine. On a named interface discovery uses multicast, as in ROS 2.
    """
    loopback = next((name for name in _interfaces() if name in ("lo", "lo0")), "lo")
    if interface is not None:
        check_interface(interface)
    name = interface or loopback
    multicast, peers = ("false", _LOCAL_PEERS) if name == loopback else ("true", "")
    return (
        '<CycloneDDS><Domain id="any"><General>'
        f'<Interfaces><NetworkInterface name="{escape(name)}"/></Interfaces>'
        f"<AllowMulticast>{multicast}</AllowMulticast></General>"
        f"<Discovery><LeaseDuration>{LEASE}s</LeaseDuration>{peers}</Discovery>"
        "</Domain></CycloneDDS>"
    )


def read_topics(path: Path) -> Topics:
    """Read the topics of a mapping; raise InputError if it also changes fields or units."""
    from airpuck.recording.mapping import read_mapping

    mapping = read_mapping(path)
    others = sorted(mapping.model_fields_set - {"topics"})
    if others:
        problem = "is for recordings; a live graph takes poses in m and commands in [0, 1]"
        raise InputError(problem, file=path, field=others[0])
    for stream, name in mapping.topics.by_stream.items():
        if not re.fullmatch(r"/[^\s]+", name):
            problem = f"{name!r} must begin with a slash and have no spaces on a live graph"
            raise InputError(problem, file=path, field=f"topics.{stream}")
    return mapping.topics


@dataclass(frozen=True)
class LiveSettings(Settings):
    """Connection of a process to a graph, and its duration.

    Attributes
    ----------
    domain : int, optional
        DDS domain; by default ``ROS_DOMAIN_ID``, or 0.
    interface : str, optional
        Network interface; by default loopback, so that nothing leaves the machine.
    duration : float, optional
        How long to run [s]; by default until SIGINT or SIGTERM.
    quiet : bool, default False
        Whether to print no events on standard error.
    topics : Topics, optional
        Names of the topics; the default is the authors' table.

    Raises
    ------
    InputError
        If the domain or the interface does not exist, or the duration is not above 0.
    """

    HEADING: ClassVar = "ROS 2 graph"

    domain: Annotated[
        int | None, Setting("DDS domain; by default $ROS_DOMAIN_ID, or 0", numbers.DOMAIN, "N")
    ] = None
    interface: Annotated[
        str | None,
        Setting(
            "Network interface, such as eth0; by default nothing leaves this machine.",
            metavar="NAME",
        ),
    ] = None
    duration: Annotated[
        float | None,
        Setting("How long to run; by default until Ctrl-C", numbers.LIVE_DURATION, "S"),
    ] = None
    quiet: Annotated[bool, Setting("Print only the results.", option="--quiet/-q")] = False
    topics: Annotated[
        Topics | None,
        Setting(
            "TOML file: names of the topics.",
            metavar="FILE",
            option="--mapping/--topics",
            read=read_topics,
        ),
    ] = None

    def __post_init__(self) -> None:
        super().__post_init__()
        domain_id(self.domain)
        domain_config(self.interface)
