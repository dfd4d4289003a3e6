"""The messages of one topic become a stream."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from jaxtyping import Float, Int64

from airpuck.boundary.errors import InputError
from airpuck.recording.cdr import Field, decode, flatten
from airpuck.recording.command_message import (
    command_fields,
    command_places,
    commands_in,
    joint_names,
)
from airpuck.recording.conversion import (
    SECOND_NS,
    commands_of,
    poses_of,
    propellers_of,
    stamps_of,
)
from airpuck.recording.files import listing, shortened
from airpuck.recording.log import TopicLog
from airpuck.recording.mapping import (
    CommandMapping,
    Orientation,
    PoseMapping,
    RecordingMapping,
)
from airpuck.recording.message import PATHS, definitions, stamp_paths
from airpuck.recording.stream import COLUMNS, COMMANDS, POSES, Stream

Decoded = Mapping[str, np.ndarray]
#: Fields to decode, and what turns them into columns and values.
Plan = tuple[Sequence[str], Callable[[Decoded], tuple[tuple[str, ...], Float[np.ndarray, "N k"]]]]


def may_hold(stream: str, topic: TopicLog) -> bool:
    """Return whether a topic is of a type that holds a stream."""
    if stream not in COMMANDS:
        return topic.msgtype in PATHS[stream]
    known = {msgtype for types in PATHS.values() for msgtype in types}
    try:
        types = definitions(topic.msgtype, topic.definition, idl=topic.idl)
        fields = flatten(types, topic.msgtype)
    except ValueError:
        return False
    return topic.msgtype not in known and bool(command_fields(topic.msgtype, fields))


def topic_stream(stream: str, topic: TopicLog, mapping: RecordingMapping) -> tuple[Stream, bool]:
    """Decode one topic, and say whether its messages carry their times."""
    msgtype = topic.msgtype
    own = _own(stream, mapping)
    usual = PATHS.get(stream, {}).get(msgtype, ())
    if stream not in COMMANDS and not usual and not (stream in POSES and mapping.pose.position):
        accepted = " or ".join(PATHS[stream])
        raise InputError(f"holds {shortened(msgtype)}, but a {stream} is {accepted}")
    types = definitions(msgtype, topic.definition, idl=topic.idl)
    if msgtype not in types:
        raise InputError(f"the recording does not say what {shortened(msgtype)} holds")
    fields = flatten(types, msgtype)
    if stream in COMMANDS:
        paths, convert = _command_plan(msgtype, fields, mapping.command)
    elif stream in POSES:
        paths, convert = _pose_plan(usual, mapping.pose)
    else:
        paths, convert = usual, lambda found: (COLUMNS[stream], _table(found, usual))
    times = (own.time,) if own.time else stamp_paths(fields)
    single = [path for path, code in fields if code.startswith("<")]
    absent = [
        path for path in (*times, *(() if stream in COMMANDS else paths)) if path not in single
    ]
    if absent:
        raise InputError(
            f"{msgtype} is defined without the number {', '.join(absent)} "
            f"(it has {listing(single)})"
        )
    found = decode(topic.messages, types, msgtype, tuple(dict.fromkeys((*times, *paths))))
    columns, values = convert(found)
    received = np.array(topic.received_ns, dtype=np.int64)
    stamp = _stamps([found[path] for path in times], own)
    if stamp is None:
        arrived = received + round(own.start_s * SECOND_NS)
        return Stream(arrived, received, values, columns), False
    return Stream(stamp, received, values, columns), True


def _own(stream: str, mapping: RecordingMapping) -> PoseMapping | CommandMapping:
    """Return what the mapping says of a stream; of all poses the same."""
    if stream in POSES:
        return mapping.pose
    return mapping.command if stream in COMMANDS else CommandMapping()


def _table(found: Decoded, paths: Sequence[str]) -> Float[np.ndarray, "N k"]:
    return np.stack([found[path] for path in paths], axis=1, dtype=np.float64)


def _command_plan(msgtype: str, fields: Sequence[Field], mapping: CommandMapping) -> Plan:
    """Plan how commands are read from any message that holds numbers."""
    places = command_places(msgtype, fields, mapping.values)

    def convert(found: Decoded) -> tuple[tuple[str, ...], Float[np.ndarray, "N k"]]:
        names, values = commands_in(found, places, mapping.values)
        return propellers_of(names, mapping), commands_of(values, mapping)

    return [*(place.path for place in places), *joint_names(msgtype)], convert


def _pose_plan(usual: tuple[str, ...], mapping: PoseMapping) -> Plan:
    """Plan how poses are read, from usual fields or those that the mapping names."""
    position = mapping.position or usual[:3]
    orientation = mapping.orientation or Orientation("quaternion", usual[3:])
    if not position or not orientation.columns:
        raise InputError("name the fields of both, position and orientation", field="pose")
    paths = (*position, *orientation.columns)

    def convert(found: Decoded) -> tuple[tuple[str, ...], Float[np.ndarray, "N k"]]:
        table, split = _table(found, paths), len(position)
        return COLUMNS["pose"], poses_of(
            table[:, :split], table[:, split:], orientation.kind, mapping
        )

    return paths, convert


def _stamps(
    times: list[np.ndarray], mapping: PoseMapping | CommandMapping
) -> Int64[np.ndarray, " N"] | None:
    """Return the times in messages [ns]; none where they carry none or never filled them in."""
    if not times:
        return None
    if mapping.time:
        return stamps_of(times[0], mapping)
    seconds, nanoseconds = (time.astype(np.int64) for time in times)
    stamps = seconds * SECOND_NS + nanoseconds
    if len(stamps) and not stamps.any():
        return None
    return stamps + round(mapping.start_s * SECOND_NS)
