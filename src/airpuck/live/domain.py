"""Which network a graph spans: the loopback interface, unless another is named."""

from __future__ import annotations

import os
import socket
from collections.abc import Mapping
from xml.sax.saxutils import quoteattr

from airpuck.boundary.errors import InputError

LOOPBACK = "lo"
#: The highest domain whose ports exist: 7400 + 250 per domain.
HIGHEST_DOMAIN = 232
#: Processes of one domain on one machine, when they look for each other by port.
_MOST_PARTICIPANTS = 40
#: A process that was killed is gone from the graph after this long [s].
LEASE = 3

_VARIABLE = "ROS_DOMAIN_ID"


def domain_id(given: int | None, environment: Mapping[str, str] = os.environ) -> int:
    """Return the number of the DDS domain."""
    field = "--domain"
    number = given
    if number is None:
        field, text = _VARIABLE, environment.get(_VARIABLE, "").strip() or "0"
        number = int(text) if text.isdecimal() else -1
    if not 0 <= number <= HIGHEST_DOMAIN:
        raise InputError(f"must be a whole number from 0 to {HIGHEST_DOMAIN}", field=field)
    return number


def loopback_name() -> str:
    """Return the name of the loopback interface."""
    names = _interfaces()
    return next((name for name in names if name in (LOOPBACK, "lo0")), LOOPBACK)


def domain_config(interface: str | None) -> str:
    """Return Cyclone's configuration of a domain.

    On loopback there is no multicast: participants look for each other at the ports of 127.0.0.1,
    and no packet can leave the machine. On a named interface discovery is by multicast, as ROS 2
    does it.
    """
    names = _interfaces()
    loopback = loopback_name()
    if interface is not None and interface not in names:
        raise InputError(
            f"there is no network interface {interface!r}; there are {', '.join(names)}",
            field="--interface",
        )
    name = interface or loopback
    discovery = f"<LeaseDuration>{LEASE}s</LeaseDuration>"
    multicast = "true"
    if name == loopback:
        multicast = "false"
        discovery += (
            "<ParticipantIndex>auto</ParticipantIndex>"
            f"<MaxAutoParticipantIndex>{_MOST_PARTICIPANTS}</MaxAutoParticipantIndex>"
            '<Peers><Peer address="127.0.0.1"/></Peers>'
        )
    return (
        '<CycloneDDS><Domain id="any"><General>'
        f"<Interfaces><NetworkInterface name={quoteattr(name)}/></Interfaces>"
        f"<AllowMulticast>{multicast}</AllowMulticast></General>"
        f"<Discovery>{discovery}</Discovery></Domain></CycloneDDS>"
    )


def _interfaces() -> list[str]:
    """Return the names of the machine's network interfaces."""
    return [name for _, name in socket.if_nameindex()]
