"""Connection of a process to a graph, and its duration."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

from airpuck.boundary import numbers
from airpuck.boundary.errors import InputError
from airpuck.boundary.settings import Setting, Settings

if TYPE_CHECKING:
    from airpuck.recording.mapping import Topics


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
        from airpuck.live.dds import domain_config, domain_id

        domain_id(self.domain)
        domain_config(self.interface)
