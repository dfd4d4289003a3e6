"""Conversion of one topic's messages to a stream."""

from __future__ import annotations

from collections.abc import Callable, Container, Mapping, Sequence
from operator import attrgetter
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int64, Shaped

from airpuck.boundary.errors import InputError, listing, nearest, shortened
from airpuck.craft.vehicle import unnamed_columns
from airpuck.recording.cdr import Field, Types, decode, decode_singly, flatten
from airpuck.recording.conversion import (
    SECOND_NS,
    chosen_body,
    commands_of,
    poses_of,
    propellers_of,
    stamps_of,
)
from airpuck.recording.mapping import (
    AXES,
    ENTRY,
    CommandMapping,
    Orientation,
    PoseMapping,
    RecordingMapping,
    completed,
)
from airpuck.recording.message import PATHS, STAMP, definitions, stamp_paths
from airpuck.recording.stream import COLUMNS, COMMANDS, POSES, Stream
from airpuck.recording.unpacking import TopicLog

_JOINT_STATE = "sensor_msgs/msg/JointState"
#: Field in which a type names its values.
_JOINT_NAMES = "name"
#: Fields of a JointState that may hold the commands.
_JOINT_VALUES = ("position", "velocity", "effort")
#: Field in which a message, such as an odometry, names its rigid body.
_CHILD = "child_frame_id"
#: Parts of a message that contain no command.
_BESIDE = ("header.", "layout.")
#: PX4 counts microseconds, north, east and down, and marks what is stopped or unknown by NaN.
_PX4 = {"time": "timestamp", "units": ("us",)}
_PX4_POSE = {**_PX4, "time": "timestamp_sample", "axes": AXES["NED"]}
_PX4_ODOMETRY = {
    **_PX4_POSE,
    "position": tuple(f"position[{k}]" for k in range(3)),
    "orientation": Orientation("quaternion", tuple(f"q[{k}]" for k in (1, 2, 3, 0))),
}
_PX4_MOTORS, _PX4_LOCAL = "px4_msgs/msg/ActuatorMotors", "px4_msgs/msg/VehicleLocalPosition"
#: Field that tells whether x and y mean anything.
_VALID = "xy_valid"
#: Message type -> settings of a mapping where the user gives none.
_USUAL: Mapping[str, Mapping[str, Any]] = {
    _PX4_MOTORS: {**_PX4, "values": ("control",)},
    "px4_msgs/msg/VehicleOdometry": _PX4_ODOMETRY,
    _PX4_LOCAL: {
        **_PX4_POSE,
        "position": ("x", "y", "z"),
        "orientation": Orientation("yaw", ("heading",)),
    },
}

#: int64 nanoseconds end in the year 2262.
_LATEST_SECOND = 2**63 // SECOND_NS - 1
_ACCEPTED = (
    "a message of numbers of one type, one for each motor or an array of them, with or without a "
    "header (std_msgs/msg/Float64MultiArray, sensor_msgs/msg/JointState, own types)"
)
Decoded = Mapping[str, np.ndarray]
#: Fields to decode, and a function that turns them into columns and values.
Reader = tuple[Sequence[str], Callable[[Decoded], tuple[tuple[str, ...], Float[np.ndarray, "N k"]]]]


class Place(NamedTuple):
    """Location of the values in a message."""

    path: str
    #: Index into the array; None for all entries.
    entry: int | None


def place_of(name: str, known: Container[str]) -> Place:
    """Parse the name of a known field, or of an array's entry (``data[2]``)."""
    entry = None if name in known else ENTRY.fullmatch(name)
    return Place(entry[1], int(entry[2])) if entry else Place(name, None)


def _at(found: Decoded, place: Place) -> np.ndarray:
    """Return what messages hold at a place."""
    values = found[place.path]
    if place.entry is None:
        return values
    if values.ndim == 1 or place.entry >= values.shape[1]:
        entries = "no" if values.ndim == 1 else values.shape[1]
        raise InputError(
            f"{place.path} has {entries} entries, so there is no {place.path}[{place.entry}]"
        )
    return values[:, place.entry]


def command_fields(msgtype: str, fields: Sequence[Field]) -> tuple[str, ...]:
    """Return the fields that hold commands; empty if ambiguous."""
    if msgtype == _JOINT_STATE:
        return _JOINT_VALUES
    rest = [field for field in fields if not field.path.startswith(_BESIDE)]
    kinds = {_number(field.code) for field in rest}
    return tuple(field.path for field in rest) if len(kinds) == 1 and all(kinds) else ()


def _number(code: str) -> str:
    """Return the kind of number in a field or its array; empty if it contains no numbers."""
    return "" if "<" not in code else code[code.index("<") :]


def command_places(msgtype: str, fields: Sequence[Field], given: Sequence[str] = ()) -> list[Place]:
    """Return the location of commands: fields, arrays, array entries (``data[2]``) as `given`."""
    chosen = tuple(given) or command_fields(msgtype, fields)
    if not chosen:
        raise InputError(
            f"holds {shortened(msgtype)}, but a command is {_ACCEPTED}; choose its fields, as in "
            f'command = {{values = ["..."]}}, out of {listing(field.path for field in fields)}'
        )
    known = [field.path for field in fields if _number(field.code)]
    places = [place_of(name, known) for name in chosen]
    unknown = [place.path for place in places if place.path not in known]
    if unknown:
        problem = f"has no number {', '.join(unknown)} (it has {listing(known)})"
        raise InputError(problem + nearest(unknown[0], known))
    return places


def commands_in(
    found: Mapping[str, np.ndarray], places: Sequence[Place], given: Sequence[str] = ()
) -> tuple[tuple[str, ...], Float[np.ndarray, "N n"]]:
    """Return the values in decoded messages, and their names there."""
    joints = found.get(_JOINT_NAMES)
    joints = joints if joints is not None and joints.dtype.kind == "U" else None
    if joints is not None and not given:
        places = [place for place in places if found[place.path].shape[1]]
        if len(places) > 1:
            filled = ", ".join(place.path for place in places)
            raise InputError(
                f"has numbers in {filled}; choose some, as in "
                f'command = {{values = ["{places[0].path}"]}}'
            )
    names: list[str] = []
    parts = []
    for path, entry in places:
        part = _at(found, Place(path, entry)).astype(np.float64)
        single = found[path].ndim == 1
        part = part[:, None] if part.ndim == 1 else part
        parts.append(part)
        names += [path if single else ""] * part.shape[1]
    if not names:
        raise InputError("contains no message, or messages without a number")
    values = np.concatenate(parts, axis=1)
    whole = len(places) == 1 and places[0].entry is None
    if joints is not None and whole and values.shape[1] == joints.shape[1]:
        return _in_one_order(joints, values)
    return tuple(names) if all(names) else unnamed_columns(len(names)), values


def _in_one_order(
    names: Shaped[np.ndarray, "N n"], values: Float[np.ndarray, "N n"]
) -> tuple[tuple[str, ...], Float[np.ndarray, "N n"]]:
    """Sort values by the first message's names: each message may have its own order."""
    order = np.argsort(names, axis=1)
    ranked = np.take_along_axis(names, order, axis=1)
    differs = (ranked != ranked[:1]).any(axis=1)
    if differs.any() or (ranked[0, 1:] == ranked[0, :-1]).any():
        raise InputError(f"message {int(np.argmax(differs)) + 1} names other joints than the first")
    sorted_values = np.empty_like(values)
    sorted_values[:, order[0]] = np.take_along_axis(values, order, axis=1)
    return tuple(str(name) for name in names[0]), sorted_values


def may_hold(stream: str, topic: TopicLog) -> bool:
    """Return whether a topic's type can hold a stream."""
    if stream not in COMMANDS and topic.msgtype in PATHS[stream]:
        return True
    known = {msgtype for types in PATHS.values() for msgtype in types}
    try:
        types = definitions(topic.msgtype, topic.definition, idl=topic.idl)
        if stream not in COMMANDS:
            return stream in POSES and body_array(types, topic.msgtype) is not None
        fields = flatten(types, topic.msgtype)
    except ValueError:
        return False
    return topic.msgtype not in known and bool(command_fields(topic.msgtype, fields))


def topic_stream(stream: str, topic: TopicLog, mapping: RecordingMapping) -> tuple[Stream, bool]:
    """Decode one topic, and report whether its messages carry their times."""
    msgtype = topic.msgtype
    own = section_of(stream, msgtype, mapping)
    types = definitions(msgtype, topic.definition, idl=topic.idl)
    received = np.array(topic.received_ns, dtype=np.int64)
    if stream not in COMMANDS and not (msgtype in PATHS[stream] or getattr(own, "position", ())):
        several = body_array(types, msgtype) if stream in POSES else None
        if several is not None and isinstance(own, PoseMapping):
            return _stream_of_bodies(stream, topic, types, several, own)
        accepted = " or ".join(PATHS[stream])
        raise InputError(f"holds {shortened(msgtype)}, but a {stream} is {accepted}")
    if msgtype not in types:
        raise InputError(f"the recording does not say what {shortened(msgtype)} holds")

    def read(paths: Sequence[str]) -> Decoded:
        return decode(topic.messages, types, msgtype, paths)

    return stream_of(stream, msgtype, flatten(types, msgtype), read, received, own)


class BodyArray(NamedTuple):
    """Location of the poses in a message of several rigid bodies."""

    #: Field of the array, and the type of its entries.
    path: str
    msgtype: str
    #: Fields of an entry: its name (empty: entries are counted), position and quaternion.
    name: str
    pose: tuple[str, ...]


def body_array(types: Types, msgtype: str) -> BodyArray | None:
    """Find the array of named poses in a type such as NamedPoseArray, RigidBodies or TFMessage."""
    from rosbags.interfaces import Nodetype

    for path, (node, description) in types.get(msgtype, ((), ()))[1]:
        if node != Nodetype.SEQUENCE or description[0][0] != Nodetype.NAME:
            continue
        entry = description[0][1]
        fields = dict(flatten(types, entry))
        for position, quaternion in (("position", "orientation"), ("translation", "rotation")):
            ends = [f"{position}.{axis}" for axis in "xyz"]
            ends += [f"{quaternion}.{axis}" for axis in "xyzw"]
            found = [next((name for name in fields if name.endswith(end)), "") for end in ends]
            texts = [name for name, code in fields.items() if code == "string"]
            # A frame names the coordinates, not the body.
            names = [name for name in texts if not name.endswith("header.frame_id")]
            if all(found):
                return BodyArray(path, entry, "".join(names[:1]), tuple(found))
    return None


def _stream_of_bodies(
    stream: str, topic: TopicLog, types: Types, several: BodyArray, own: PoseMapping
) -> tuple[Stream, bool]:
    """Decode the poses of one body, from messages that hold several."""
    stamps = stamp_paths(flatten(types, topic.msgtype))
    inner = stamp_paths(flatten(types, several.msgtype))
    rows = decode_singly(topic.messages, types, topic.msgtype, [several.path, *stamps])
    read_name = attrgetter(several.name) if several.name else None
    read_pose = attrgetter(*several.pose, *(inner if not stamps else ()))
    names, received, numbers = [], [], []
    for arrived, (entries, *times) in zip(topic.received_ns, rows, strict=True):
        for place, entry in enumerate(entries):
            names.append(read_name(entry) if read_name else str(place))
            received.append(arrived)
            numbers.append((*read_pose(entry), *times))
    paths = (*several.pose, *(stamps or inner), _CHILD)
    found = dict(zip(paths, np.array(numbers).reshape(len(names), -1).T, strict=False))
    found[_CHILD] = np.array(names, dtype=str)
    fields = [Field(path, "string" if path == _CHILD else "<f8") for path in paths]
    split = len(several.pose) - 4
    usual = {
        "position": several.pose[:split],
        "orientation": Orientation("quaternion", several.pose[split:]),
    }
    arrivals, own = np.array(received, dtype=np.int64), completed(own, usual)
    return stream_of(stream, topic.msgtype, fields, lambda _: found, arrivals, own)


def stream_of(
    stream: str,
    msgtype: str,
    fields: Sequence[Field],
    read: Callable[[Sequence[str]], Decoded],
    received: Int64[np.ndarray, " N"],
    own: PoseMapping | CommandMapping,
) -> tuple[Stream, bool]:
    """Convert the fields that `read` decodes to a stream; report whether messages carry times."""
    usual = PATHS.get(stream, {}).get(msgtype, ())
    if isinstance(own, PoseMapping):
        names, convert = _pose_plan(usual, own)
    elif stream in COMMANDS:
        names, convert = _command_plan(msgtype, fields, own)
    else:
        names, convert = usual, lambda found: (COLUMNS[stream], _table(found, usual))
    times = (own.time,) if own.time else stamp_paths(fields)
    codes = dict(fields)
    single = times if stream in COMMANDS else (*times, *names)  # the plan has checked commands
    absent = [name for name in single if not _is_number(name, codes)]
    if absent:
        numbers = [path for path, code in fields if _number(code)]
        raise InputError(
            f"{msgtype} is defined without the number {', '.join(absent)} "
            f"(it has {listing(numbers)})"
        )
    bodies = (_CHILD,) if isinstance(own, PoseMapping) and codes.get(_CHILD) == "string" else ()
    checks = (_VALID,) if msgtype == _PX4_LOCAL and _VALID in codes else ()
    paths = (*times, *names, *bodies, *checks)
    found = read(tuple(dict.fromkeys(place_of(name, codes).path for name in paths)))
    if isinstance(own, PoseMapping) and (bodies or own.body):
        mine = _rows_of_body(found.get(_CHILD), own.body, stream)
        found = {path: values[mine] for path, values in found.items()}
        received = received[mine]
    columns, values = convert(found)
    if stream == "pose" and len(values):
        seen = found[_VALID] != 0 if checks else np.isfinite(values[:, :2]).all(axis=1)
        if not seen.any():
            raise InputError("contains no horizontal position; name a topic of motion capture")
        if checks:
            values[~seen] = np.nan
    stamp = _stamps([_at(found, place_of(name, found)) for name in times], own)
    if stamp is None:
        return Stream(received + round(own.start_s * SECOND_NS), received, values, columns), False
    return Stream(stamp, received, values, columns), True


def _rows_of_body(names: np.ndarray | None, body: str, stream: str) -> Any:
    """Return which rows are of the chosen rigid body; all, if no other is named."""
    if names is None and body:
        chosen_body((), body, stream=stream)
    if names is None or not len(names):
        return ...
    return names == chosen_body(map(str, names.tolist()), body, stream=stream)


def _is_number(name: str, codes: Mapping[str, str]) -> bool:
    """Return whether a type has a single number of this name."""
    path, entry = place_of(name, codes)
    code = codes.get(path, "")
    return bool(_number(code)) and (code[0] == "<") == (entry is None)


def section_of(
    stream: str, msgtype: str, mapping: RecordingMapping
) -> PoseMapping | CommandMapping:
    """Return the mapping's section for a stream, completed by its type."""
    section = CommandMapping()
    if stream in POSES:
        section = mapping.of_poses(stream)
    elif stream in COMMANDS:
        section = mapping.of_commands(stream)
    return completed(section, _USUAL.get(msgtype, {}))


def _table(found: Decoded, paths: Sequence[str]) -> Float[np.ndarray, "N k"]:
    return np.stack([_at(found, place_of(path, found)) for path in paths], axis=1, dtype=np.float64)


def _command_plan(msgtype: str, fields: Sequence[Field], mapping: CommandMapping) -> Reader:
    """Plan how commands are read from any message that holds numbers."""
    places = command_places(msgtype, fields, mapping.values)

    def convert(found: Decoded) -> tuple[tuple[str, ...], Float[np.ndarray, "N k"]]:
        names, values = commands_in(found, places, mapping.values)
        if msgtype == _PX4_MOTORS:
            whole = mapping.values == _USUAL[msgtype]["values"]
            there = np.isfinite(values).any(axis=0) if whole else np.ones(len(names), bool)
            # A craft has fewer motors than the message; the others are always NaN.
            values = np.nan_to_num(values[:, there] if there.any() else values)
            names = unnamed_columns(values.shape[1]) if whole else names
        return propellers_of(names, mapping), commands_of(values, mapping)

    names = (_JOINT_NAMES,) if msgtype == _JOINT_STATE else ()
    return [*(place.path for place in places), *names], convert


def _pose_plan(usual: tuple[str, ...], mapping: PoseMapping) -> Reader:
    """Plan how poses are read, from usual fields or those that the mapping names."""
    level = len(usual) == len(COLUMNS["pose"])  # x, y, yaw
    split = 2 if level else 3
    position = mapping.position or usual[:split]
    kind = "yaw" if level else "quaternion"
    orientation = mapping.orientation or Orientation(kind, usual[split:])
    if not position or not (orientation.columns or orientation.kind == "none"):
        raise InputError("name the fields of both, position and orientation", field="pose")
    paths = (*position, *orientation.columns)

    def convert(found: Decoded) -> tuple[tuple[str, ...], Float[np.ndarray, "N k"]]:
        table, n = _table(found, paths), len(position)
        parts = table[:, :n], table[:, n:]
        return COLUMNS["pose"], poses_of(*parts, orientation.kind, mapping, orientation.columns)

    return paths, convert


def _stamps(
    times: list[np.ndarray], mapping: PoseMapping | CommandMapping
) -> Int64[np.ndarray, " N"] | None:
    """Return the times in messages [ns]; None if they carry none or never set them."""
    if not times:
        return None
    if mapping.time:
        return stamps_of(times[0], mapping)
    seconds, nanoseconds = (time.astype(np.int64) for time in times)
    if len(seconds) and np.abs(seconds).max() > _LATEST_SECOND:
        problem = "holds seconds beyond the year 2262; are they nanoseconds?"
        raise InputError(problem, field=STAMP[0])
    stamps = seconds * SECOND_NS + nanoseconds
    if len(stamps) and not stamps.any():
        return None
    return stamps + round(mapping.start_s * SECOND_NS)
