"""What browsers ask of a page server: where it listens, which requests it answers, and messages.

A page moves a craft, so only the page itself is served, under one of our names. Any site in a
browser may open a WebSocket to this machine, and a site whose name resolves to loopback seems to
have the same origin. The Origin header reveals the first, the Host header the second.

Positions are sent as packed numbers, a hundred times a second; all else is JSON. Messages from a
page are checked here: they may contain anything.
"""

from __future__ import annotations

import ipaddress
import json
import math
import re
import socket
import struct
import sys
from collections.abc import Sequence
from typing import Any, Literal, NamedTuple, get_args

from airpuck.boundary.errors import InputError, explained
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


def address_of(interface: str | None) -> str:
    """Return the IPv4 address of a network interface; of loopback if None is given."""
    if interface is None:
        return LOOPBACK
    check_interface(interface)
    if sys.platform not in _SIOCGIFADDR:
        raise InputError("works on Linux and macOS only", field="--interface")
    import fcntl

    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asking:
        request = struct.pack("256s", interface.encode()[:15])
        problem = f"{interface} has no IPv4 address ({{error}})"
        with explained(OSError, problem, field="--interface"):
            answer = fcntl.ioctl(asking.fileno(), _SIOCGIFADDR[sys.platform], request)
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


#: Requests of a page other than a target for the mallet.
Deed = Literal["go", "pause", "restart", "level", "sit", "think"]
DEEDS = get_args(Deed)
#: Longest valid message from a page [bytes].
LONGEST = 64

_WISH = struct.Struct("<Ifff")
_STATE = struct.Struct("<dIB3x")


class Wish(NamedTuple):
    """A page's target for the mallet of a game, or for the set point of a craft."""

    #: Sequence number of this message, per page.
    number: int
    #: [m, m, rad]; a mallet has no yaw.
    x: float
    y: float
    yaw: float = 0.0


class Order(NamedTuple):
    """Another request of a page."""

    do: Deed
    #: The chosen level, if any.
    level: str = ""
    #: Whether to show the player's plans.
    on: bool = False


def read_message(message: str | bytes) -> Wish | Order | None:
    """Return a page's request; None for messages that our pages never send."""
    if len(message) > LONGEST:
        return None
    return _read_wish(message) if isinstance(message, bytes) else _read_order(message)


def packed_wish(wish: Wish) -> bytes:
    """Return the message of a wish."""
    return _WISH.pack(*wish)


def packed_state(
    time: float,
    heard: int,
    hidden: bool,
    puck: Sequence[float],
    mallet: Sequence[float],
    craft: Sequence[float],
    commands: Sequence[float],
) -> bytes:
    """Return the message of a state.

    Puck: x, y, yaw; mallet: x, y and their rates, or for a craft in its place: x, y, yaw, 0; craft,
    on the left: x, y, yaw. `commands` belong to the craft from left to right. `heard` is the
    sequence number of the newest wish that the game has processed.
    """
    numbers = [*puck[:3], *mallet[:4], *craft[:3], *commands]
    return _STATE.pack(time, heard, hidden) + struct.pack(f"<{len(numbers)}f", *numbers)


def _read_wish(data: bytes) -> Wish | None:
    """Return a wish, if the message is one."""
    if len(data) != _WISH.size:
        return None
    wish = Wish(*_WISH.unpack(data))
    return wish if all(map(math.isfinite, wish[1:])) else None


def _read_order(text: str) -> Order | None:
    """Return an order, if the message is one."""
    try:
        order: Any = json.loads(text)
    except (ValueError, RecursionError):
        return None
    if not isinstance(order, dict) or order.get("do") not in DEEDS:
        return None
    level, on = order.get("level", ""), order.get("on", False)
    if not isinstance(level, str) or not isinstance(on, bool):
        return None
    return Order(order["do"], level, on)
