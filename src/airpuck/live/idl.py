"""IDL types and names as ROS 2 gives them to DDS, made of ROS message definitions."""

from __future__ import annotations

from typing import Any, ClassVar

from airpuck.recording.cdr import Types

_TOPIC_PREFIX = "rt"


def dds_topic(topic: str) -> str:
    """Return the DDS name of a ROS topic."""
    return _TOPIC_PREFIX + topic


def ros_topic(name: str) -> str | None:
    """Return the ROS topic of a DDS topic."""
    return name.removeprefix(_TOPIC_PREFIX) if name.startswith(f"{_TOPIC_PREFIX}/") else None


def dds_type(msgtype: str) -> str:
    """Return the DDS name of a ROS message type."""
    package, kind, name = msgtype.split("/")
    return f"{package}::{kind}::dds_::{name}_"


def ros_type(name: str) -> str:
    """Return the ROS message type of a DDS type."""
    parts = name.split("::")
    if len(parts) != 4 or parts[2] != "dds_" or not parts[3].endswith("_"):
        return name
    return f"{parts[0]}/{parts[1]}/{parts[3][:-1]}"


def idl_struct(types: Types, msgtype: str, made: dict[str, Any] | None = None) -> Any:
    """Make the IDL type of a ROS message."""
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
    """Make a type of messages that stay bytes, for Cyclone's readers and writers.

    What comes and goes is CDR as it is on the wire: a recorder need not take it apart, and bytes
    that are no message cannot make a reader fail. Cyclone asks a type for its name, its
    description, and to turn samples into bytes and back.
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

        @classmethod
        def deserialize_key(cls, data: bytes) -> RawMessage:
            return cls(data)

    return RawMessage
