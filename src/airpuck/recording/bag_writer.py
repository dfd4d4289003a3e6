"""Writing a recording as a rosbag2 folder with MCAP storage."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from ruamel.yaml import YAML

from airpuck.errors import InputError
from airpuck.recording.bag import METADATA
from airpuck.recording.cdr import Types, definitions_within, encode, flatten
from airpuck.recording.message_types import PATHS, command_type, definitions, stamp_paths
from airpuck.recording.new_folder import new_folder
from airpuck.recording.stream import Recording, Stream
from airpuck.recording.topics import Topics

_SECOND = 10**9
#: Version 8 is the newest whose quality-of-service settings older releases of ROS 2 read as well.
_ROSBAG2_VERSION = 8
#: What a sender set before the recorder subscribed: the table's sensors and commands do not resend.
_BEST_EFFORT = ("pose", "command", "imu", "mouse")
#: Half a second to some seconds of a flight: as much as a file that is cut short loses.
_CHUNK_BYTES = 2**17
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
    """Write the storage file and its summary."""
    folder.mkdir()
    file = f"{folder.name}_0.mcap"
    hashes = _write_storage(prepared, folder / file)
    # Quoted text breaks no line, so that the profiles stay as they are.
    yaml = YAML(typ="safe")
    yaml.default_flow_style = False
    yaml.width = 2**20
    with (folder / METADATA).open("w", encoding="utf-8", newline="\n") as output:
        yaml.dump({"rosbag2_bagfile_information": _summary(prepared, hashes, file)}, output)


def _write_storage(prepared: Sequence[_Topic], path: Path) -> list[str]:
    """Merge the topics by the recorder's time; return the hash of each one's message type."""
    from mcap.writer import Writer
    from rosbags.typesys import Stores, get_typestore

    hashes = []
    events = []
    # Through mcap rather than rosbags: it writes checksums, and chunks of a chosen size.
    with path.open("wb") as output:
        writer = Writer(output, chunk_size=_CHUNK_BYTES)
        writer.start("ros2", "airpuck")
        channels = []
        for index, topic in enumerate(prepared):
            store = get_typestore(Stores.EMPTY)
            store.register(definitions_within(topic.types, topic.msgtype))
            definition, _ = store.generate_msgdef(topic.msgtype, ros_version=2)
            schema = writer.register_schema(topic.msgtype, "ros2msg", definition.encode())
            hashes.append(store.hash_rihs01(topic.msgtype))
            about = {"offered_qos_profiles": _profiles(topic), "topic_type_hash": hashes[-1]}
            channels.append(writer.register_channel(topic.name, "cdr", schema, about))
            events += [(time, index, place) for place, time in enumerate(topic.received_ns)]
        for time, index, place in sorted(events):
            topic = prepared[index]
            writer.add_message(
                channels[index], time, topic.messages[place], topic.stamp_ns[place], place
            )
        writer.finish()
    return hashes


def _summary(prepared: Sequence[_Topic], hashes: Sequence[str], file: str) -> dict[str, Any]:
    """Return what rosbag2 notes beside its storage file."""
    times = [time for topic in prepared for time in topic.received_ns]
    start, stop = min(times, default=0), max(times, default=0)

    # A new one for each place: YAML would write the second as a reference to the first.
    def span() -> dict[str, Any]:
        return {
            "starting_time": {"nanoseconds_since_epoch": start},
            "duration": {"nanoseconds": stop - start},
            "message_count": len(times),
        }

    topics = [
        {
            "topic_metadata": {
                "name": topic.name,
                "type": topic.msgtype,
                "serialization_format": "cdr",
                "offered_qos_profiles": _profiles(topic),
                "type_description_hash": digest,
            },
            "message_count": len(topic.messages),
        }
        for topic, digest in zip(prepared, hashes, strict=True)
    ]
    return {
        "version": _ROSBAG2_VERSION,
        "storage_identifier": "mcap",
        **span(),
        "topics_with_message_count": topics,
        # Of rosbag2's own compression; MCAP compresses its chunks by itself.
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [file],
        "files": [{"path": file, **span()}],
        "custom_data": {"written_by": "airpuck"},
        "ros_distro": "unknown",
    }


def _profiles(topic: _Topic) -> str:
    """Return the quality of service as the table's recorder notes it."""
    never = "\n    sec: 9223372036\n    nsec: 854775807\n"
    return (
        f"- history: 3\n  depth: 0\n  reliability: {2 if topic.best_effort else 1}\n"
        f"  durability: 2\n  deadline:{never}  lifespan:{never}  liveliness: 1\n"
        f"  liveliness_lease_duration:{never}  avoid_ros_namespace_conventions: false"
    )
