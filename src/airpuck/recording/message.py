"""ROS message types of each stream, and codecs between their bytes and a stream's numbers.

Definitions are parsed within limits. rosbags compiles a definition to code, with a line for each
element of an array of messages or texts. Its IDL parser tries every alternative in each pair of
brackets, and evaluates constant expressions. A definition of a few bytes can therefore grow without
bound.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from functools import cache
from operator import attrgetter
from types import MappingProxyType
from typing import Any

import numpy as np
from jaxtyping import Float, Int64

from airpuck.boundary.limits import DEFINITION_BYTES, DEFINITION_SIZE, MESSAGE_BYTES
from airpuck.recording.cdr import Field, Types, encode, flatten, layout_of, typestore
from airpuck.recording.conversion import SECOND_NS, yaw_of
from airpuck.recording.stream import COLUMNS, COMMANDS, POSES

#: Comments and strings of IDL, in which brackets and operators have no meaning.
_MEANINGLESS = re.compile(r'"(?:\\.|[^"\\])*+"|//[^\n]*|/\*.*?\*/', re.DOTALL)
#: Places where IDL allows an expression.
_EXPRESSION = re.compile(r"[@=(\[<,+-]")
#: The brackets of annotations. All other brackets, products, shifts and single bits are
#: computations.
_ANNOTATION = re.compile(r"@[\w:]++\s*+\(")
_COMPUTED = re.compile(r"[(*/%|^&~]|<<")
#: Cost of a type, of an element of an array of strings or types, and of an expression, in fields.
_FIELDS_PER_TYPE, _FIELDS_PER_ELEMENT, _FIELDS_PER_EXPRESSION = 20, 2, 5
HOLOHOVER_CONTROL = "holohover_msgs/msg/HolohoverControlStamped"
HOLOHOVER_MOTORS = ("motor_a_1", "motor_a_2", "motor_b_1", "motor_b_2", "motor_c_1", "motor_c_2")
_HEADER = "std_msgs/Header header\n"
_GAME = "airpuck_msgs/msg/GameEventStamped"
#: Definitions of the authors' messages, for bags that embed none, and of ours.
_OWN = {
    _GAME: _HEADER + "".join(f"float64 {column}\n" for column in COLUMNS["game"]),
    HOLOHOVER_CONTROL: _HEADER + "".join(f"float64 {motor}\n" for motor in HOLOHOVER_MOTORS),
    "holohover_msgs/msg/HolohoverIMUStamped": (
        f"{_HEADER}geometry_msgs/Vector3 acc\ngeometry_msgs/Vector3 gyro\n"
    ),
    "holohover_msgs/msg/HolohoverMouseStamped": f"{_HEADER}float64 v_x\nfloat64 v_y\n",
    "holohover_msgs/msg/HolohoverStateStamped": (
        f"{_HEADER}holohover_msgs/HolohoverState state_msg\n"
    ),
    "holohover_msgs/msg/HolohoverState": (
        "float64 x\nfloat64 y\nfloat64 v_x\nfloat64 v_y\nfloat64 yaw\nfloat64 w_z\n"
    ),
}
#: Frames named in messages; the other messages are in the world's frame.
_FRAMES = {**dict.fromkeys(COMMANDS, "body"), "imu": "body", "mouse": "body"}
#: Fields of a header's stamp, and the columns of the authors' files.
STAMP = ("header.stamp.sec", "header.stamp.nanosec")


def parse_definition(msgtype: str, text: str, *, idl: bool) -> Types:
    """Parse the definition of a message type and of its nested types."""
    from rosbags.typesys import get_types_from_idl, get_types_from_msg

    if len(text) > DEFINITION_BYTES:
        raise ValueError(
            f"the embedded definition of {msgtype} is longer than {DEFINITION_BYTES:,} characters"
        )
    if idl:
        # Several files follow each other, each under two lines that rosbags' parser does not know.
        # It does not know #include either, but the definition contains the included files.
        foreign = ("=" * 80, "IDL: ", "#")
        text = "\n".join(line for line in text.splitlines() if not line.startswith(foreign))
        meant = _ANNOTATION.sub("@=", _MEANINGLESS.sub("", text))
        if _COMPUTED.search(meant):
            raise ValueError(f"the embedded definition of {msgtype} contains constant expressions")
        _check_size(_FIELDS_PER_EXPRESSION * len(_EXPRESSION.findall(meant)), msgtype)
    try:
        types = get_types_from_idl(text) if idl else get_types_from_msg(text, msgtype)
    # A damaged definition can make the parser fail in any way.
    except Exception as error:
        raise ValueError(f"the embedded definition of {msgtype} cannot be parsed") from error
    _check_size(sum(_code_size(fields, msgtype) for _, fields in types.values()), msgtype)
    return types


def _check_size(size: int, msgtype: str) -> None:
    if size > DEFINITION_SIZE:
        raise ValueError(f"{msgtype} is defined with more than {DEFINITION_SIZE:,} elements")


def _code_size(fields: Any, msgtype: str) -> int:
    """Return the amount of code a type makes, in fields; reject impossibly large arrays."""
    from rosbags.interfaces import Nodetype

    size = _FIELDS_PER_TYPE + len(fields)
    for name, (node, description) in fields:
        if node != Nodetype.ARRAY:
            continue
        (kind, of), count = description
        if not 0 < count <= MESSAGE_BYTES:
            raise ValueError(f"{msgtype} is defined with {count:,} elements of {name}")
        if kind == Nodetype.NAME or of[0] == "string":
            size += _FIELDS_PER_ELEMENT * count
    return size


def _fields(*parents: str, of: str) -> tuple[str, ...]:
    return tuple(f"{parent}.{name}".lstrip(".") for parent in parents for name in of.split())


def _pose(translation: str, rotation: str) -> tuple[str, ...]:
    return _fields(translation, of="x y z") + _fields(rotation, of="x y z w")


_POSE_WITHIN = _pose("pose.pose.position", "pose.pose.orientation")
_STATE = _fields("", of="x y yaw v_x v_y w_z")
_STAMPED_STATE = _fields("state_msg", of="x y yaw v_x v_y w_z")
_OF_POSES = {
    "geometry_msgs/msg/PoseStamped": _pose("pose.position", "pose.orientation"),
    "geometry_msgs/msg/PoseWithCovarianceStamped": _POSE_WITHIN,
    "nav_msgs/msg/Odometry": _POSE_WITHIN,
    "geometry_msgs/msg/TransformStamped": _pose("transform.translation", "transform.rotation"),
    "geometry_msgs/msg/Pose": _pose("position", "orientation"),
    "geometry_msgs/msg/Pose2D": ("x", "y", "theta"),
    "ff_msgs/msg/Pose2DStamped": ("x", "y", "theta"),
}

#: Stream -> message type -> fields that hold the stream's columns. For a pose: x, y, z and
#: quaternion, or x, y and yaw. Bags are written with the first type. Commands may have any type.
PATHS: Mapping[str, Mapping[str, tuple[str, ...]]] = MappingProxyType(
    {
        **dict.fromkeys(POSES, _OF_POSES),
        "reference": {
            "holohover_msgs/msg/HolohoverState": _STATE,
            "holohover_msgs/msg/HolohoverStateStamped": _STAMPED_STATE,
        },
        "estimate": {
            "holohover_msgs/msg/HolohoverStateStamped": _STAMPED_STATE,
            "holohover_msgs/msg/HolohoverState": _STATE,
        },
        "imu": {
            "holohover_msgs/msg/HolohoverIMUStamped": _fields("acc", "gyro", of="x y z"),
            "sensor_msgs/msg/Imu": _fields("linear_acceleration", "angular_velocity", of="x y z"),
        },
        "mouse": {"holohover_msgs/msg/HolohoverMouseStamped": ("v_x", "v_y")},
        "game": {_GAME: COLUMNS["game"]},
    }
)


def definitions(msgtype: str = "", text: str = "", *, idl: bool = False) -> Types:
    """Parse the definitions in `text`; without a text, return ROS 2's and the authors'."""
    return parse_definition(msgtype, text, idl=idl) if text else _known_types()


@cache
def _known_types() -> Types:
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    types = dict(get_typestore(Stores.ROS2_HUMBLE).fielddefs)
    for name, definition in _OWN.items():
        types.update(get_types_from_msg(definition, name))
    return MappingProxyType(types)


def stamp_paths(fields: Sequence[Field]) -> tuple[str, ...]:
    """Return the fields of the time stamp, if any."""
    return STAMP if {field.path for field in fields}.issuperset(STAMP) else ()


def command_type(motors: tuple[str, ...]) -> tuple[str, Types]:
    """Choose the message type for writing a command, and return its definition."""
    from rosbags.typesys import get_types_from_msg

    if motors == HOLOHOVER_MOTORS:
        return HOLOHOVER_CONTROL, definitions()
    for motor in motors:
        if not re.fullmatch(r"[a-z](_?[a-z0-9])*", motor) or motor == "header":
            raise ValueError(
                f"{motor!r} cannot be a field of a ROS message (lower-case letters, digits, single "
                "underscores); rename the propeller"
            )
    name = f"airpuck_msgs/msg/Command{len(motors)}Stamped"
    text = _HEADER + "".join(f"float64 {motor}\n" for motor in motors)
    return name, {**definitions(), **get_types_from_msg(text, name)}


class MessageCodec:
    """Converts between CDR bytes and message objects of one type, through rosbags."""

    def __init__(self, msgtype: str, types: Types | None = None) -> None:
        self.msgtype = msgtype
        known = definitions() if types is None else types
        self.fields = flatten(known, msgtype)
        self._store = typestore(known, msgtype)
        # rosbags generates its code on first use, which must not happen in flight.
        self.decode(self.encode(self.message()))

    def encode(self, message: Any) -> bytes:
        """Write a message."""
        return bytes(self._store.serialize_cdr(message, self.msgtype))

    def decode(self, data: bytes) -> Any:
        """Read a message."""
        try:
            return self._store.deserialize_cdr(data, self.msgtype)
        # rosbags checks little, so a foreign message can make it fail in any way.
        except Exception as error:
            raise ValueError(f"{len(data)} bytes are not a valid {self.msgtype}") from error

    def message(self, msgtype: str = "", **fields: Any) -> Any:
        """Make a message, or one of a nested type; omitted fields are zero or empty."""
        from rosbags.interfaces import Nodetype

        values: dict[str, Any] = {}
        definition: Any = self._store.fielddefs[msgtype or self.msgtype]
        for name, (node, description) in definition[1]:
            if name in fields:
                values[name] = fields[name]
            elif node == Nodetype.NAME:
                values[name] = self.message(description)
            elif node == Nodetype.BASE:
                values[name] = "" if description[0] == "string" else 0
            elif node == Nodetype.ARRAY:
                (_, (kind, _)), count = description
                values[name] = np.zeros(count, kind)
            else:
                values[name] = []
        return self._store.types[msgtype or self.msgtype](**values)


class StreamCodec:
    """Converts between CDR bytes and numbers of a stream; `stamped` requests a header."""

    def __init__(self, stream: str, motors: tuple[str, ...] = (), *, stamped: bool = False) -> None:
        self._stream = stream
        if stream in COMMANDS:
            self.msgtype, self.types = command_type(motors)
            self._paths = self.columns = motors
        else:
            self.msgtype = next(name for name in PATHS[stream] if not stamped or "Stamped" in name)
            self.types = definitions()
            self._paths, self.columns = PATHS[stream][self.msgtype], COLUMNS[stream]
        self._codec = MessageCodec(self.msgtype, self.types)
        self._stamps = stamp_paths(self._codec.fields)
        self._read = attrgetter(*self._stamps, *self._paths)
        blank = self._codec.message()
        if self._stamps:
            blank.header.frame_id = _FRAMES.get(stream, "world")
        self._template = self._codec.encode(blank)
        self._layout: Any = layout_of(self._codec.fields, self._template)

    def encode(self, stamp_ns: int, values: Sequence[float] | Float[np.ndarray, " k"]) -> bytes:
        """Write a message."""
        return self.encode_all(np.array([stamp_ns]), np.array([values], dtype=float))[0]

    def encode_all(
        self, stamp_ns: Int64[np.ndarray, " N"], values: Float[np.ndarray, "N k"]
    ) -> list[bytes]:
        """Write many messages."""
        columns = values.T
        if self._stream in POSES:
            x, y, yaw = columns
            level = np.zeros(len(yaw))
            columns = (x, y, level, level, level, np.sin(yaw / 2), np.cos(yaw / 2))
        numbers = dict(zip(self._paths, columns, strict=True))
        if self._stamps:
            numbers.update(zip(self._stamps, np.divmod(stamp_ns, SECOND_NS), strict=True))
        return encode(self._template, self._layout, numbers)

    def decode(self, data: bytes) -> tuple[int | None, Float[np.ndarray, " k"]]:
        """Read a message: its stamp [ns since the epoch], if it has one, and its numbers."""
        numbers = self._read(self._codec.decode(data))
        stamp = None
        if self._stamps:
            stamp = numbers[0] * SECOND_NS + numbers[1]
            numbers = numbers[2:]
        values = np.array(numbers, dtype=float)
        if self._stream in POSES:
            values = np.array([*values[:2], *yaw_of(*values[3:, None])])
        return stamp, values
