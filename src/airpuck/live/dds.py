"""ROS 2 on DDS: names and types on the wire, and the network that a domain spans."""

from __future__ import annotations

import os
import socket
from collections.abc import Mapping
from typing import Any, ClassVar
from xml.sax.saxutils import quoteattr

from airpuck.boundary import numbers
from airpuck.boundary.errors import InputError, nearest
from airpuck.recording.cdr import Types

_TOPIC_PREFIX = "rt"
_DOMAIN_VARIABLE = "ROS_DOMAIN_ID"
#: A killed process disappears from the graph after this long [s].
LEASE = 3
#: Largest number of processes of one domain on one machine that find each other by port.
_LOCAL_PEERS = (
    "<ParticipantIndex>auto</ParticipantIndex>"
    "<MaxAutoParticipantIndex>40</MaxAutoParticipantIndex>"
    '<Peers><Peer address="127.0.0.1"/></Peers>'
)


def domain_id(given: int | None, environment: Mapping[str, str] = os.environ) -> int:
    """Return the number of the DDS domain: as given, from the environment, or 0."""
    field, number = "--domain", given
    if number is None:
        field, text = _DOMAIN_VARIABLE, environment.get(_DOMAIN_VARIABLE, "").strip() or "0"
        number = int(text) if text.isdecimal() else -1
    numbers.DOMAIN.check(number, field)
    return number


def check_interface(name: str) -> None:
    """Raise InputError if this machine has no network interface of that name."""
    names = _interfaces()
    if name not in names:
        raise InputError(
            f"there is no network interface {name!r}; there are {', '.join(names)}"
            + nearest(name, names),
            field="--interface",
        )


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
        f"<Interfaces><NetworkInterface name={quoteattr(name)}/></Interfaces>"
        f"<AllowMulticast>{multicast}</AllowMulticast></General>"
        f"<Discovery><LeaseDuration>{LEASE}s</LeaseDuration>{peers}</Discovery>"
        "</Domain></CycloneDDS>"
    )


def dds_topic(topic: str) -> str:
    """Return the DDS name of a ROS topic."""
    return _TOPIC_PREFIX + topic


def ros_topic(name: str) -> str | None:
    """Return the ROS topic of a DDS topic; None if ROS 2 did not name it."""
    return name.removeprefix(_TOPIC_PREFIX) if name.startswith(f"{_TOPIC_PREFIX}/") else None


def dds_type(msgtype: str) -> str:
    """Return the DDS name of a ROS message type."""
    package, kind, name = msgtype.split("/")
    return f"{package}::{kind}::dds_::{name}_"


def ros_type(name: str) -> str:
    """Return the ROS message type of a DDS type; other names do not change."""
    parts = name.split("::")
    if len(parts) != 4 or parts[2] != "dds_" or not parts[3].endswith("_"):
        return name
    return f"{parts[0]}/{parts[1]}/{parts[3][:-1]}"


def idl_struct(types: Types, msgtype: str, made: dict[str, Any] | None = None) -> Any:
    """Make the IDL type of a ROS message and its nested types, unless they are in `made`."""
    from cyclonedds.idl import make_idl_struct

    made = {} if made is None else made
    if msgtype not in made:
        if msgtype not in types:
            raise ValueError(f"the definition of {msgtype} is missing")
        fields = {
            name: _field(types, node, description, made)
            for name, (node, description) in types[msgtype][1]
        }
        made[msgtype] = make_idl_struct(msgtype.split("/")[-1] + "_", dds_type(msgtype), fields)
    return made[msgtype]


def _field(types: Types, node: Any, description: Any, made: dict[str, Any]) -> Any:
    """Return the IDL type of a field."""
    from cyclonedds.idl import types as idl
    from rosbags.interfaces import Nodetype

    if node == Nodetype.NAME:
        return idl_struct(types, description, made)
    if node == Nodetype.BASE:
        kind, bound = description
        if kind == "string":
            return idl.bounded_str[bound] if bound else str
        # ROS's byte and char are octets in IDL.
        if kind in ("byte", "char", "octet"):
            return idl.uint8
        return bool if kind == "bool" else getattr(idl, kind)
    (inner, of), count = description
    element = _field(types, inner, of, made)
    if node == Nodetype.ARRAY:
        return idl.array[element, count]
    return idl.sequence[element, count] if count else idl.sequence[element]


def raw_type(struct: Any) -> Any:
    """Make a type whose messages stay CDR bytes, for Cyclone's readers and writers.

    A recorder need not decode messages, and malformed bytes cannot make a reader fail. Cyclone asks
    a type for its name, its description, and conversion to and from bytes.
    """

    class RawMessage:
        __idl__: ClassVar[Any] = struct.__idl__
        __idl_typename__: ClassVar[str] = struct.__idl_typename__
        __slots__ = ("data", "sample_info")

        def __init__(self, data: bytes) -> None:
            self.data = data

        def serialize(self, **_: Any) -> bytes:
            return self.data

        @classmethod
        def deserialize(cls, data: bytes) -> RawMessage:
            return cls(data)

        deserialize_key = deserialize

    return RawMessage
