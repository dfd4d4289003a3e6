"""Writing rosbag2 folders: one .mcap file, and metadata.yaml at the end."""

from __future__ import annotations

import os
from collections.abc import Mapping
from operator import itemgetter
from pathlib import Path
from types import MappingProxyType
from typing import Any

from ruamel.yaml import YAML

from airpuck.boundary.errors import InputError
from airpuck.recording.bag import METADATA
from airpuck.recording.cdr import Types, typestore
from airpuck.recording.conversion import SECOND_NS
from airpuck.recording.files import new_folder
from airpuck.recording.mapping import Topics
from airpuck.recording.message import StreamCodec
from airpuck.recording.stream import COMMANDS, POSES, Recording, Stream

#: Version 8 is the newest whose quality-of-service settings older releases of ROS 2 can read.
_ROSBAG2_VERSION = 8
#: Half a second to a few seconds of a flight: as much as a truncated file loses.
_CHUNK_BYTES = 2**17
#: The table's sensors and commands do not resend.
_BEST_EFFORT = (*POSES, *COMMANDS, "imu", "mouse")


def write_bag(
    recording: Recording, folder: str | os.PathLike[str], *, topics: Topics | None = None
) -> None:
    """Save a recording as a rosbag2 folder: ``metadata.yaml`` and one .mcap file.

    Every message definition is embedded. A command with the authors' six motors becomes a
    ``holohover_msgs/msg/HolohoverControlStamped``; other columns get a type of the same form. The
    same recording gives the same bytes.

    Parameters
    ----------
    recording : Recording
        Each stream should be in the order of its ``received_ns``, in which bags are read.
    folder : path-like
        The folder to create; it may exist if it is empty.
    topics : Topics, optional
        Topic names; the default is the authors' table.

    Raises
    ------
    InputError
        If the folder is not empty, or a stream cannot be stored: an unknown name, a stamp before
        1970 or after 2038, or a propeller name that ROS does not allow.

    Notes
    -----
    Poses are stored as quaternions: `read_recording` returns the yaw in (-π, π], accurate to 1e-15.
    Everything else is read back unchanged.

    Examples
    --------
    >>> airpuck.write_bag(recording, "bag/")
    >>> sorted(airpuck.read_recording("bag/").streams) == sorted(recording.streams)
    True
    """
    names = (topics or Topics()).by_stream
    codecs = {}
    for name, stream in recording.streams.items():
        try:
            codecs[name] = _codec(name, stream, known=name in names)
        except ValueError as error:
            raise InputError(str(error), file=recording.source, field=name) from error
    with new_folder(folder) as temporary:
        bag = BagFile(temporary, recording.about)
        messages = []
        for name, codec in codecs.items():
            stream = recording.streams[name]
            topic = bag.add_topic(
                names[name], codec.msgtype, codec.types, best_effort=name in _BEST_EFFORT
            )
            data = codec.encode_all(stream.stamp_ns, stream.values)
            times = stream.received_ns.tolist(), stream.stamp_ns.tolist()
            messages += zip([topic] * len(stream), *times, data, strict=True)
        for message in sorted(messages, key=itemgetter(1)):
            bag.add(*message)
        bag.close()


def _codec(name: str, stream: Stream, *, known: bool) -> StreamCodec:
    """Choose the format of a stream."""
    if not known:
        raise ValueError("is not a stream that a bag can hold")
    if len(stream) and (
        stream.stamp_ns.min() < 0
        or stream.stamp_ns.max() >= 2**31 * SECOND_NS
        or stream.received_ns.min() < 0
    ):
        raise ValueError("has time stamps that ROS cannot hold (before 1970 or after 2038)")
    # The table's references carry no header, but references with their own stamps need one.
    stamped = (stream.stamp_ns != stream.received_ns).any()
    return StreamCodec(name, stream.columns, stamped=bool(stamped))


class BagFile:
    """A bag being written, message by message."""

    def __init__(self, folder: Path, about: Mapping[str, str] = MappingProxyType({})) -> None:
        from mcap.writer import Writer

        folder.mkdir(exist_ok=True)
        self.folder, self._name = folder, f"{folder.name}_0.mcap"
        self._about = about
        # Another process that records into the same folder must fail, not write into this file.
        self._file = (folder / self._name).open("xb")
        # Uses mcap instead of rosbags: it writes checksums, and chunks of a chosen size.
        self._writer = Writer(self._file, chunk_size=_CHUNK_BYTES)
        self._writer.start("ros2", "airpuck")
        self._topics: list[dict[str, Any]] = []
        self._channels: list[int] = []
        self._first_ns: int | None = None
        self._last_ns = 0

    def add_topic(
        self,
        name: str,
        msgtype: str,
        types: Types,
        *,
        best_effort: bool = False,
        transient_local: bool = False,
    ) -> int:
        """Register a topic to record, and return its number."""
        store = typestore(types, msgtype)
        definition, _ = store.generate_msgdef(msgtype, ros_version=2)
        schema = self._writer.register_schema(msgtype, "ros2msg", definition.encode())
        digest = store.hash_rihs01(msgtype)
        profiles = _profiles(best_effort, transient_local)
        about = {"offered_qos_profiles": profiles, "topic_type_hash": digest}
        self._channels.append(self._writer.register_channel(name, "cdr", schema, about))
        metadata = {
            "name": name,
            "type": msgtype,
            "serialization_format": "cdr",
            "offered_qos_profiles": profiles,
            "type_description_hash": digest,
        }
        self._topics.append({"topic_metadata": metadata, "message_count": 0})
        return len(self._topics) - 1

    def add(self, topic: int, received_ns: int, sent_ns: int, data: bytes) -> None:
        """Record a message of the topic with this number."""
        first = received_ns if self._first_ns is None else self._first_ns
        self._first_ns = min(first, received_ns)
        self._last_ns = max(self._last_ns, received_ns)
        channel, about = self._channels[topic], self._topics[topic]
        self._writer.add_message(channel, received_ns, data, sent_ns, about["message_count"])
        about["message_count"] += 1

    @property
    def counts(self) -> dict[str, int]:
        """Messages written, by topic."""
        return {topic["topic_metadata"]["name"]: topic["message_count"] for topic in self._topics}

    def flush(self) -> None:
        """Close the chunk and pass it to the system: a process that dies now loses nothing."""
        self._writer.flush()
        self._file.flush()

    def close(self) -> None:
        """Write the index and ``metadata.yaml``."""
        self._writer.finish()
        self._file.close()
        # Quoted text keeps the line breaks of the profiles.
        yaml = YAML(typ="safe")
        yaml.default_flow_style = False
        yaml.width = 2**20
        # Repeated content is written out, not as a reference.
        yaml.representer.ignore_aliases = lambda *_: True
        with (self.folder / METADATA).open("w", encoding="utf-8", newline="\n") as output:
            yaml.dump({"rosbag2_bagfile_information": self._summary()}, output)

    def _summary(self) -> dict[str, Any]:
        """Return the metadata that rosbag2 stores beside its storage file."""
        first_ns = self._first_ns or 0
        span = {
            "starting_time": {"nanoseconds_since_epoch": first_ns},
            "duration": {"nanoseconds": self._last_ns - first_ns},
            "message_count": sum(self.counts.values()),
        }
        return {
            "version": _ROSBAG2_VERSION,
            "storage_identifier": "mcap",
            **span,
            "topics_with_message_count": self._topics,
            # For rosbag2's own compression. MCAP compresses its chunks without it.
            "compression_format": "",
            "compression_mode": "",
            "relative_file_paths": [self._name],
            "files": [{"path": self._name, **span}],
            "custom_data": {**self._about, "written_by": "airpuck"},
            "ros_distro": "unknown",
        }


def _profiles(best_effort: bool, transient_local: bool) -> str:
    """Return the quality of service in the format of the table's recorder."""
    never = "\n    sec: 9223372036\n    nsec: 854775807\n"
    return (
        f"- history: 3\n  depth: 0\n  reliability: {2 if best_effort else 1}\n"
        f"  durability: {1 if transient_local else 2}\n  deadline:{never}  lifespan:{never}"
        f"  liveliness: 1\n"
        f"  liveliness_lease_duration:{never}  avoid_ros_namespace_conventions: false"
    )
