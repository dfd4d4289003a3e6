"""Access control for a page that moves a craft: only the page itself, under one of our names.

Any site in a browser may open a WebSocket to this machine, and a site whose name resolves to
loopback seems to have the same origin. The Origin header reveals the first, the Host header the
second.
"""

from __future__ import annotations

import ipaddress
import re
import socket
from collections.abc import Sequence

#: Hosts that mean all interfaces.
_ANY = ("", "0.0.0.0", "::")
#: A Host header: an IPv6 address in brackets, or a name or IPv4 address; then a port.
_HOST = re.compile(r"(?:\[(?P<six>[0-9a-f:.]+)\]|(?P<name>[a-z0-9._-]+))(?::[0-9]{1,5})?")


def refusal(hosts: Sequence[str], origins: Sequence[str], served: str) -> str | None:
    """Return why a request with these headers is rejected, or None.

    A client other than a browser sends no origin. It may connect, since it could also publish on
    the graph itself.
    """
    if len(hosts) != 1 or not _is_ours(hosts[0], served):
        return "This page is not served under that name."
    if origins and [one.lower() for one in origins] not in (
        [f"{scheme}://{hosts[0].lower()}"] for scheme in ("http", "https")
    ):
        return "Another site may not use this page."
    return None


def _is_ours(host: str, served: str) -> bool:
    """Return whether a Host header names an IP address, loopback or this server.

    A name server cannot point an IP address at this machine. The port may differ, as in a tunnel.
    """
    found = _HOST.fullmatch(host.lower())
    if found is None:
        return False
    six, name = found["six"], found["name"]
    own = {"localhost", served.lower()}
    if served in _ANY:
        own |= {socket.gethostname().lower(), socket.getfqdn().lower()}
    try:
        address = ipaddress.IPv6Address(six) if six else name in own or ipaddress.IPv4Address(name)
    except ValueError:
        return False
    return bool(address)
