"""Reading a PX4 log (ULog) through pyulog, the extra `px4`.

Definitions are checked first, because damaged ones can make pyulog loop forever. A format may also
nest others and declare arrays of any length, which pyulog unrolls field by field.
"""

from __future__ import annotations

import contextlib
import io
import re
import struct
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from airpuck.boundary.errors import InputError, explained, installed, listing, nearest
from airpuck.boundary.limits import DEFINITION_SIZE, refused, sha256
from airpuck.recording.cdr import Field
from airpuck.recording.mapping import ENTRY, RecordingMapping, refuse_csv_settings
from airpuck.recording.stream import Recording, Stream
from airpuck.recording.topic_stream import section_of, stream_of

ULOG = ".ulg"
#: Default topics; the first that is in the log is used. Motion capture comes before PX4's own
#: estimates.
_USUAL = {
    "pose": (
        "vehicle_visual_odometry",
        "vehicle_mocap_odometry",
        "vehicle_odometry",
        "vehicle_local_position",
    ),
    "command": ("actuator_motors",),
}
#: Topic in the log -> message type; for other topics both are the same.
_TYPES = {
    **dict.fromkeys(_USUAL["pose"], "px4_msgs/msg/VehicleOdometry"),
    "vehicle_local_position": "px4_msgs/msg/VehicleLocalPosition",
    "actuator_motors": "px4_msgs/msg/ActuatorMotors",
}
#: Length and kind before each message; length of the file's header [bytes].
_HEAD, _HEADER_BYTES = struct.Struct("<HB"), 16
_FORMAT, _DEFINITIONS, _DATA = ord("F"), frozenset(b"BFIMPQ"), frozenset(b"ALC")
_ARRAY = re.compile(r"(\w+)(?:\[(\d{1,9})\])?")
_MICROSECOND_NS = 1000


def read_ulog(path: Path, mapping: RecordingMapping, needs: Sequence[str]) -> Recording:
    """Read the required streams of a ULog file, and those that the mapping names."""
    with installed("PX4 logs need pyulog: pip install 'airpuck[px4]'", file=path):
        from pyulog import ULog

    refuse_csv_settings(mapping, path, "a PX4 log")
    content = path.read_bytes()
    _check_definitions(content, path)
    said = io.StringIO()
    # A damaged log can make pyulog fail in any way.
    unreadable = explained(Exception, "is not a readable PX4 log", file=path)
    with unreadable, contextlib.redirect_stdout(said):
        log = ULog(io.BytesIO(content))
    topics, said = _topics(log.data_list), []
    streams = {}
    for stream, name in mapping.topics.by_stream.items():
        if not mapping.topics.required(stream, needs):
            continue
        # A ROS name such as /fmu/out/actuator_motors ends in the log's name.
        named = (name.rpartition("/")[2],)
        named = named if stream in mapping.topics.model_fields_set else _USUAL.get(stream, named)
        found = [topic for topic in named if topic in topics]
        if not found:
            problem = f"there is no such topic; choose from {listing(sorted(topics))}"
            raise InputError(problem + nearest(named[0], topics), file=path, field=named[0])
        problems = []
        for topic in found:
            try:
                streams[stream] = _stream(stream, topic, topics[topic], mapping)
                if f"{topic}[1]" in topics:
                    said.append(f"there are several {topic}; a mapping can name {topic}[1]")
                break
            except (ValueError, OverflowError) as error:
                problem = error.problem if isinstance(error, InputError) else str(error)
                problems.append(InputError(problem, file=path, field=topic))
        else:
            raise problems[0]
    if log.file_corruption:
        said.append(f"{path.name} is damaged; only the intact part is used")
    return Recording(streams, str(path), {path.name: sha256(path)}, tuple(said))


def _topics(instances: Sequence[Any]) -> dict[str, Mapping[str, Any]]:
    """Return topics by name; `name[1]` is the second instance of a topic, such as outputs."""
    topics: dict[str, Mapping[str, Any]] = {}
    for data in sorted(instances, key=lambda data: data.multi_id):
        topics.setdefault(data.name, data.data)
        if data.data is not topics[data.name]:
            topics[f"{data.name}[{data.multi_id}]"] = data.data
    return topics


def _stream(
    stream: str, topic: str, data: Mapping[str, np.ndarray], mapping: RecordingMapping
) -> Stream:
    """Convert one topic; pyulog has a column for each entry of an array."""
    columns: dict[str, list[np.ndarray]] = {}
    single = set()
    for name, values in data.items():
        entry = ENTRY.fullmatch(name)
        columns.setdefault(entry[1] if entry else name, []).append(values)
        if not entry:
            single.add(name)
    found = {k: v[0] if k in single else np.stack(v, axis=1) for k, v in columns.items()}
    fields = [
        Field(
            name,
            ("" if name in single else str(values.shape[1])) + values.dtype.str.replace("|", "<"),
        )
        for name, values in found.items()
        if values.dtype.kind in "iuf"
    ]
    if "timestamp" not in single or found["timestamp"].dtype.kind not in "iu":
        raise ValueError("has no timestamp")
    arrived = found["timestamp"].astype(np.int64) * _MICROSECOND_NS
    name = topic.partition("[")[0]
    msgtype = _TYPES.get(name, name)
    own = section_of(stream, msgtype, mapping)
    return stream_of(stream, msgtype, fields, lambda _: found, arrived, own)[0]


def _check_definitions(content: bytes, path: Path) -> None:
    """Reject damaged definitions, and formats that unroll to too many fields."""
    formats, place = dict[str, list[tuple[str, int]]](), _HEADER_BYTES
    while place + _HEAD.size <= len(content):
        length, kind = _HEAD.unpack_from(content, place)
        place += _HEAD.size
        if kind in _DATA:
            break
        if kind not in _DEFINITIONS or place + length > len(content):
            raise InputError("is not a readable PX4 log: its definitions are damaged", file=path)
        if kind == _FORMAT:
            text = content[place : place + length].decode(errors="replace")
            name, _, fields = text.partition(":")
            parts = filter(None, map(_ARRAY.match, fields.split(";")))
            formats[name] = [(part[1], int(part[2] or 1)) for part in parts]
        place += length
    sizes: dict[str, int] = {}

    def size(name: str, depth: int = 0) -> int:
        if name not in formats:
            return 1
        if name not in sizes:
            # A format that contains itself would be expanded forever.
            total = DEFINITION_SIZE + 1 if depth > len(formats) else 0
            for of, count in formats[name] if not total else ():
                total += count * size(of, depth + 1)
                if total > DEFINITION_SIZE:
                    break
            sizes[name] = total
        return sizes[name]

    for name in formats:
        if size(name) > DEFINITION_SIZE:
            raise refused(
                f"defines {name} with too many fields", DEFINITION_SIZE, "log fewer", file=path
            )
