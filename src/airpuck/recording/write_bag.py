"""Writing a recording as a rosbag2 folder with MCAP storage."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from airpuck.errors import InputError
from airpuck.recording.cdr import Types, encode, flatten
from airpuck.recording.message_types import PATHS, command_type, definitions, stamp_paths
from airpuck.recording.new_folder import new_folder
from airpuck.recording.stream import Recording, Stream
from airpuck.recording.topics import Topics

if TYPE_CHECKING:
    from rosbags.interfaces import Qos

_SECOND = 10**9
#: Version 8 is the newest whose quality-of-service settings older releases of ROS 2 read as well.
_ROSBAG2_VERSION = 8
#: What a sender set before the recorder subscribed: the table's sensors and commands do not resend.
_BEST_EFFORT = ("pose", "command", "imu", "mouse")
_FRAMES = {"pose": "world", "command": "body", "imu": "body", "mouse": "body"}


@dataclass(frozen=True)
class _Topic:
    """A stream, ready to be written."""

    name: str
    msgtype: str
    types: Types
    received_ns: list[int]
    messages: list[bytes]
    best_effort: bool


def write_bag(
    recording: Recording, folder: str | os.PathLike[str], *, topics: Topics | None = None
) -> None:
    """Save a recording as a rosbag2 folder: ``metadata.yaml`` and one .mcap file.

    Every message definition is embedded. A command with the authors' six motors becomes a
    ``holohover_msgs/msg/HolohoverControlStamped``; for other columns a type of the same form is
    made. The same recording under the same folder name gives the same bytes.

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
    """Merge the topics by the recorder's time and write them."""
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    writer = Writer(folder, version=_ROSBAG2_VERSION, storage_plugin=StoragePlugin.MCAP)
    writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
    writer.set_custom_data("written_by", "airpuck")
    with writer:
        connections = []
        for topic in prepared:
            store = get_typestore(Stores.EMPTY)
            store.register(_within(topic.types, topic.msgtype))
            connections.append(
                writer.add_connection(
                    topic.name,
                    topic.msgtype,
                    typestore=store,
                    offered_qos_profiles=[_quality(best_effort=topic.best_effort)],
                )
            )
        events = [
            (time, index, position)
            for index, topic in enumerate(prepared)
            for position, time in enumerate(topic.received_ns)
        ]
        for time, index, position in sorted(events):
            writer.write(connections[index], time, prepared[index].messages[position])


def _within(types: Types, msgtype: str) -> dict:
    """Return the definitions that a type needs, so that only these are compiled."""
    from rosbags.interfaces import Nodetype

    needed = {msgtype: types[msgtype]}
    for _, (node, description) in types[msgtype][1]:
        while node in (Nodetype.ARRAY, Nodetype.SEQUENCE):
            node, description = description[0]
        if node == Nodetype.NAME:
            needed.update(_within(types, description))
    return needed


def _quality(*, best_effort: bool) -> Qos:
    """Return the quality of service as the table's recorder notes it."""
    from rosbags.interfaces import (
        Qos,
        QosDurability,
        QosHistory,
        QosLiveliness,
        QosReliability,
        QosTime,
    )

    never = QosTime(9223372036, 854775807)
    return Qos(
        history=QosHistory.UNKNOWN,
        depth=0,
        reliability=QosReliability.BEST_EFFORT if best_effort else QosReliability.RELIABLE,
        durability=QosDurability.VOLATILE,
        deadline=never,
        lifespan=never,
        liveliness=QosLiveliness.AUTOMATIC,
        liveliness_lease_duration=never,
        avoid_ros_namespace_conventions=False,
    )
