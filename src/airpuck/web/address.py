"""The address of a page: on this machine alone, or on a named network interface."""

from __future__ import annotations

import socket
import struct
import sys

from airpuck.boundary.errors import InputError

#: The system's call for the IPv4 address of an interface, by system.
_SIOCGIFADDR = {"linux": 0x8915, "darwin": 0xC0206921}


LOOPBACK = "127.0.0.1"


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
    names = [name for _, name in socket.if_nameindex()]
    if interface not in names:
        raise InputError(
            f"there is no network interface {interface!r}; there are {', '.join(names)}",
            field="--interface",
        )
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
