"""The address of a page, and which requests it answers.

A page moves a craft, so only the page itself is served, under one of our names. Any site in a
browser may open a WebSocket to this machine, and a site whose name resolves to loopback seems to
have the same origin. The Origin header reveals the first, the Host header the second.
"""

from __future__ import annotations

import ipaddress
import re
import socket
import struct
import sys
from collections.abc import Sequence

from airpuck.boundary.errors import InputError
from airpuck.live.settings import check_interface

LOOPBACK = "127.0.0.1"
#: The system's call for the IPv4 address of an interface, by system.
_SIOCGIFADDR = {"linux": 0x8915, "darwin": 0xC0206921}
#: Hosts that mean all interfaces.
_ANY = ("", "0.0.0.0", "::")
#: A Host header: an IPv6 address in brackets, or a name or IPv4 address; then a port.
_HOST = re.compile(r"(?:\[(?P<six>[0-9a-f:.]+)\]|(?P<name>[a-z0-9._-]+))(?::[0-9]{1,5})?")


def listen(host: str, port: int) -> socket.socket:
    """Return a socket that listens for pages; raise InputError if the address is not free."""
    try:
        return socket.create_server((host, port))
    except (OSError, UnicodeError) as error:
        why = getattr(error, "strerror", None) or "no address"
        raise InputError(
            f"cannot serve at {host}:{port} ({why}); choose another --port", field="--port"
        ) from error


def address_of(interface: str) -> str:
    """Return the IPv4 address of a network interface."""
    check_interface(interface)
    if sys.platform not in _SIOCGIFADDR:
        raise InputError("works on Linux and macOS only", field="--interface")
    import fcntl

    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asking:
        request = struct.pack("256s", interface.encode()[:15])
        try:
            answer = fcntl.ioctl(asking.fileno(), _SIOCGIFADDR[sys.platform], request)
        except OSError as error:
            raise InputError(
                f"{interface} has no IPv4 address ({error.strerror})", field="--interface"
            ) from error
    return socket.inet_ntoa(answer[20:24])


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
