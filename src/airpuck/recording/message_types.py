"""Which ROS messages hold which stream, and where in the message its columns are."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from functools import cache
from types import MappingProxyType
from typing import Any

import numpy as np
from jaxtyping import Float

from airpuck.recording.cdr import Field, Types
from airpuck.recording.stream import COLUMNS

HOLOHOVER_CONTROL = "holohover_msgs/msg/HolohoverControlStamped"
HOLOHOVER_MOTORS = ("motor_a_1", "motor_a_2", "motor_b_1", "motor_b_2", "motor_c_1", "motor_c_2")

#: Definitions of the authors' own messages, for bags that embed none.
_HOLOHOVER = {
    HOLOHOVER_CONTROL: "std_msgs/Header header\n"
    + "".join(f"float64 {motor}\n" for motor in HOLOHOVER_MOTORS),
    "holohover_msgs/msg/HolohoverIMUStamped": (
        "std_msgs/Header header\ngeometry_msgs/Vector3 acc\ngeometry_msgs/Vector3 gyro\n"
    ),
    "holohover_msgs/msg/HolohoverMouseStamped": (
        "std_msgs/Header header\nfloat64 v_x\nfloat64 v_y\n"
    ),
    "holohover_msgs/msg/HolohoverStateStamped": (
        "std_msgs/Header header\nholohover_msgs/HolohoverState state_msg\n"
    ),
    "holohover_msgs/msg/HolohoverState": (
        "float64 x\nfloat64 y\nfloat64 v_x\nfloat64 v_y\nfloat64 yaw\nfloat64 w_z\n"
    ),
}


def _pose(translation: str, rotation: str) -> tuple[str, ...]:
    return (
        f"{translation}.x",
        f"{translation}.y",
        *(f"{rotation}.{axis}" for axis in ("x", "y", "z", "w")),
    )


def _state(prefix: str) -> tuple[str, ...]:
    return tuple(f"{prefix}{name}" for name in ("x", "y", "yaw", "v_x", "v_y", "w_z"))


_STATE = {
    "holohover_msgs/msg/HolohoverState": _state(""),
    "holohover_msgs/msg/HolohoverStateStamped": _state("state_msg."),
}

#: Stream -> message type -> fields that hold the stream's columns. For a pose: x, y, quaternion.
PATHS: Mapping[str, Mapping[str, tuple[str, ...]]] = MappingProxyType(
    {
        "pose": {
            "geometry_msgs/msg/PoseStamped": _pose("pose.position", "pose.orientation"),
            "geometry_msgs/msg/PoseWithCovarianceStamped": _pose(
                "pose.pose.position", "pose.pose.orientation"
            ),
            "nav_msgs/msg/Odometry": _pose("pose.pose.position", "pose.pose.orientation"),
            "geometry_msgs/msg/TransformStamped": _pose(
                "transform.translation", "transform.rotation"
            ),
        },
        "reference": _STATE,
        "estimate": dict(reversed(_STATE.items())),
        "imu": {
            "holohover_msgs/msg/HolohoverIMUStamped": tuple(
                f"{sensor}.{axis}" for sensor in ("acc", "gyro") for axis in "xyz"
            ),
            "sensor_msgs/msg/Imu": tuple(
                f"{sensor}.{axis}"
                for sensor in ("linear_acceleration", "angular_velocity")
                for axis in "xyz"
            ),
        },
        "mouse": {"holohover_msgs/msg/HolohoverMouseStamped": ("v_x", "v_y")},
    }
)

_UNIT = 1e-3
_STAMP = ("header.stamp.sec", "header.stamp.nanosec")


def definitions(msgtype: str, text: str = "", *, idl: bool = False) -> Types:
    """Return the definition of a message type and of all types within."""
    from rosbags.typesys import TypesysError, get_types_from_idl, get_types_from_msg

    try:
        if text and idl:
            types: dict[str, Any] = {}
            separator = "=" * 80 + "\n"
            # Several IDL files in a row, each under a line that names it.
            for part in text.split(separator) if text.startswith(separator) else [text]:
                body = part.partition("\n")[2] if part.startswith("IDL: ") else part
                # rosbags' parser knows no #include; the files included follow anyway.
                plain = "\n".join(line for line in body.splitlines() if line[:1] != "#")
                if plain.strip():
                    types.update(get_types_from_idl(plain))
            return types
        if text:
            return get_types_from_msg(text, msgtype)
    except (TypesysError, RecursionError) as error:
        raise ValueError(f"the embedded definition of {msgtype} cannot be parsed") from error
    return _known()


@cache
def _known() -> Types:
    """Return the definitions of ROS 2 and the authors' own."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    types = dict(get_typestore(Stores.ROS2_HUMBLE).fielddefs)
    for name, definition in _HOLOHOVER.items():
        types.update(get_types_from_msg(definition, name))
    return MappingProxyType(types)


def motors_of(fields: Sequence[Field]) -> tuple[str, ...]:
    """Return the motor columns of a command message."""
    header, rest = fields[:3], fields[3:]
    plain = all(field.kind == "float64" and field.count == 1 for field in rest)
    if tuple(field.path for field in header) != (*_STAMP, "header.frame_id") or not plain:
        return ()
    return tuple(field.path for field in rest)


def stamp_paths(fields: Sequence[Field]) -> tuple[str, ...]:
    """Return the fields of the time stamp."""
    return _STAMP if {field.path for field in fields}.issuperset(_STAMP) else ()


def accepted(stream: str) -> str:
    """Say which messages a stream can be read from."""
    if stream == "command":
        return "a message of std_msgs/msg/Header header, then one float64 for each motor"
    return " or ".join(PATHS[stream])


def columns_of(stream: str, values: Sequence[Float[np.ndarray, " N"]]) -> Float[np.ndarray, "N k"]:
    """Turn the message's fields into the stream's columns."""
    if stream == "pose" and len(values) > len(COLUMNS["pose"]):
        x, y, *quaternion = values
        values = (x, y, yaw_of(*quaternion))
    return np.stack(values, axis=1, dtype=np.float64)


def yaw_of(
    x: Float[np.ndarray, " N"],
    y: Float[np.ndarray, " N"],
    z: Float[np.ndarray, " N"],
    w: Float[np.ndarray, " N"],
) -> Float[np.ndarray, " N"]:
    """Return the rotation about the vertical axis of quaternions."""
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        square = x * x + y * y + z * z + w * w
        # Unit up to single precision: taken as it is, as the authors' conversion does.
        double = np.where(np.abs(square - 1) < _UNIT, 2.0, 2.0 / square)
        return np.arctan2(double * (w * z + x * y), 1 - double * (y * y + z * z))


def command_type(motors: tuple[str, ...]) -> tuple[str, Types]:
    """Choose the message type that a command is written as."""
    from rosbags.typesys import get_types_from_msg

    types = dict(definitions(""))
    if motors == HOLOHOVER_MOTORS:
        return HOLOHOVER_CONTROL, types
    for motor in motors:
        if not re.fullmatch(r"[a-z](_?[a-z0-9])*", motor) or motor == "header":
            raise ValueError(
                f"{motor!r} cannot be a field of a ROS message (lower-case letters, digits, single "
                "underscores); rename the propeller"
            )
    name = f"airpuck_msgs/msg/Command{len(motors)}Stamped"
    text = "std_msgs/Header header\n" + "".join(f"float64 {motor}\n" for motor in motors)
    return name, {**types, **get_types_from_msg(text, name)}
