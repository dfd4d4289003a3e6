"""Writing a recording as a rosbag2 folder with MCAP storage."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from airpuck.boundary.errors import InputError
from airpuck.recording.bag_file import BagFile
from airpuck.recording.cdr import Types, encode, flatten
from airpuck.recording.message_types import PATHS, command_type, definitions, stamp_paths
from airpuck.recording.new_folder import new_folder
from airpuck.recording.stream import Recording, Stream
from airpuck.recording.topics import Topics

_SECOND = 10**9
#: What a sender set before the recorder subscribed: the table's sensors and commands do not resend.
_BEST_EFFORT = ("pose", "command", "imu", "mouse")
_FRAMES = {"pose": "world", "command": "body", "imu": "body", "mouse": "body"}


@dataclass(frozen=True)
class _Topic:
    """A stream, ready to be written."""

    name: str
    msgtype: str
    types: Types
    stamp_ns: list[int]
    received_ns: list[int]
    messages: list[bytes]
    best_effort: bool


def write_bag(
    recording: Recording, folder: str | os.PathLike[str], *, topics: Topics | None = None
) -> None:
    """Save a recording as a rosbag2 folder: ``metadata.yaml`` and one .mcap file.

    Every message definition is embedded. A command with the authors' six motors becomes a
    ``holohover_msgs/msg/HolohoverControlStamped``; for other columns a type of the same form is
    made. The same recording gives the same bytes.

    Parameters
    ----------
    recording : Recording
        Each stream should be in the order of its ``received_ns``, in which bags are read.
    folder : path-like
        The folder to make.
    topics : Topics, optional
        Topic names; by default those of the authors' table.

    Raises
    ------
    InputError
        If the folder exists, or a stream cannot be stored: an unknown name, a stamp before 1970 or
        after 2038, a propeller name that ROS does not allow.

    Notes
    -----
    Poses are stored as quaternions: `read_recording` gives the yaw in (-π, π], equal to 1e-15.
    Everything else is read back equal.
    """
    names = (topics or Topics()).by_stream
    prepared = [
        _prepare(name, stream, names, recording.source)
        for name, stream in recording.streams.items()
    ]
    with new_folder(folder) as temporary:
        _write(prepared, temporary)


def _prepare(name: str, stream: Stream, names: Mapping[str, str], source: str) -> _Topic:
    """Encode a stream."""
    if name not in names:
        raise InputError("is not a stream that a bag can hold", file=source, field=name)
    if len(stream) and (
        stream.stamp_ns.min() < 0
        or stream.stamp_ns.max() >= 2**31 * _SECOND
        or stream.received_ns.min() < 0
    ):
        raise InputError(
            "has time stamps that ROS cannot hold (before 1970 or after 2038)",
            file=source,
            field=name,
        )
    try:
        msgtype, types, values = _message(name, stream)
    except ValueError as error:
        raise InputError(str(error), file=source, field=name) from error
    fields = flatten(types, msgtype)
    if stamps := stamp_paths(fields):
        values[stamps[0]], values[stamps[1]] = np.divmod(stream.stamp_ns, _SECOND)
    frames = {"header.frame_id": _FRAMES.get(name, "world")} if stamps else {}
    return _Topic(
        names[name],
        msgtype,
        types,
        stream.stamp_ns.tolist(),
        stream.received_ns.tolist(),
        encode(types, msgtype, values, frames),
        name in _BEST_EFFORT,
    )


def _message(name: str, stream: Stream) -> tuple[str, Types, dict[str, np.ndarray]]:
    """Choose a stream's message type and fill its fields, all but the stamp."""
    if name == "command":
        msgtype, types = command_type(stream.columns)
        return msgtype, types, dict(zip(stream.columns, stream.values.T, strict=True))
    msgtype, *others = PATHS[name]
    # The table's references carry no header; one that would lose its stamps needs the other type.
    if name == "reference" and not np.array_equal(stream.stamp_ns, stream.received_ns):
        msgtype = others[0]
    values = stream.values
    if name == "pose":
        x, y, yaw = values.T
        none = np.zeros(len(stream))
        values = np.stack([x, y, none, none, np.sin(yaw / 2), np.cos(yaw / 2)], axis=1)
    return (
        msgtype,
        definitions(msgtype),
        dict(zip(PATHS[name][msgtype], values.T, strict=True)),
    )


def _write(prepared: Sequence[_Topic], folder: Path) -> None:
    """Write the bag, its topics merged by the recorder's time."""
    bag = BagFile(folder)
    channels = [
        bag.add_topic(topic.name, topic.msgtype, topic.types, best_effort=topic.best_effort)
        for topic in prepared
    ]
    events = [
        (time, index, place)
        for index, topic in enumerate(prepared)
        for place, time in enumerate(topic.received_ns)
    ]
    for time, index, place in sorted(events):
        topic = prepared[index]
        bag.add(channels[index], time, topic.stamp_ns[place], topic.messages[place])
    bag.close()
