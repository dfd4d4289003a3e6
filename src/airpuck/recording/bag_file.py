"""A rosbag2 folder that grows message by message: one .mcap file, and metadata.yaml at the end."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML

from airpuck.recording.bag import METADATA
from airpuck.recording.cdr import Types, definitions_within

#: Version 8 is the newest whose quality-of-service settings older releases of ROS 2 read as well.
_ROSBAG2_VERSION = 8
#: Half a second to some seconds of a flight: as much as a file that is cut short loses.
_CHUNK_BYTES = 2**17


@dataclass
class _Topic:
    """What is noted about a topic."""

    name: str
    msgtype: str
    profiles: str
    digest: str
    channel: int
    count: int = 0


class BagFile:
    """A bag being written."""

    def __init__(self, folder: Path) -> None:
        from mcap.writer import Writer

        folder.mkdir()
        self._folder, self._name = folder, f"{folder.name}_0.mcap"
        self._file = (folder / self._name).open("wb")
        # Through mcap rather than rosbags: it writes checksums, and chunks of a chosen size.
        self._writer = Writer(self._file, chunk_size=_CHUNK_BYTES)
        self._writer.start("ros2", "airpuck")
        self._topics: list[_Topic] = []
        self._first_ns = self._last_ns = 0

    def add_topic(
        self,
        name: str,
        msgtype: str,
        types: Types,
        *,
        best_effort: bool = False,
        transient_local: bool = False,
    ) -> int:
        """Note that a topic will be recorded."""
        from rosbags.typesys import Stores, get_typestore

        store = get_typestore(Stores.EMPTY)
        store.register(definitions_within(types, msgtype))
        definition, _ = store.generate_msgdef(msgtype, ros_version=2)
        schema = self._writer.register_schema(msgtype, "ros2msg", definition.encode())
        digest = store.hash_rihs01(msgtype)
        profiles = _profiles(best_effort, transient_local)
        about = {"offered_qos_profiles": profiles, "topic_type_hash": digest}
        channel = self._writer.register_channel(name, "cdr", schema, about)
        self._topics.append(_Topic(name, msgtype, profiles, digest, channel))
        return len(self._topics) - 1

    def add(self, topic: int, received_ns: int, sent_ns: int, data: bytes) -> None:
        """Record a message."""
        noted = self._topics[topic]
        empty = all(other.count == 0 for other in self._topics)
        self._first_ns = received_ns if empty else min(self._first_ns, received_ns)
        self._last_ns = max(self._last_ns, received_ns)
        self._writer.add_message(noted.channel, received_ns, data, sent_ns, noted.count)
        noted.count += 1

    @property
    def counts(self) -> dict[str, int]:
        """Messages so far, by topic."""
        return {topic.name: topic.count for topic in self._topics}

    def flush(self) -> None:
        """Close the chunk and hand all to the system: a process that dies now loses nothing."""
        self._writer.flush()
        self._file.flush()

    def close(self) -> None:
        """Write the index and ``metadata.yaml``."""
        self._writer.finish()
        self._file.close()
        # Quoted text breaks no line, so that the profiles stay as they are.
        yaml = YAML(typ="safe")
        yaml.default_flow_style = False
        yaml.width = 2**20
        with (self._folder / METADATA).open("w", encoding="utf-8", newline="\n") as output:
            yaml.dump({"rosbag2_bagfile_information": self._summary()}, output)

    def _summary(self) -> dict[str, Any]:
        """Return what rosbag2 notes beside its storage file."""
        n_messages = sum(topic.count for topic in self._topics)

        # A new one for each place: YAML would write the second as a reference to the first.
        def span() -> dict[str, Any]:
            return {
                "starting_time": {"nanoseconds_since_epoch": self._first_ns},
                "duration": {"nanoseconds": self._last_ns - self._first_ns},
                "message_count": n_messages,
            }

        topics = [
            {
                "topic_metadata": {
                    "name": topic.name,
                    "type": topic.msgtype,
                    "serialization_format": "cdr",
                    "offered_qos_profiles": topic.profiles,
                    "type_description_hash": topic.digest,
                },
                "message_count": topic.count,
            }
            for topic in self._topics
        ]
        return {
            "version": _ROSBAG2_VERSION,
            "storage_identifier": "mcap",
            **span(),
            "topics_with_message_count": topics,
            # Of rosbag2's own compression; MCAP compresses its chunks by itself.
            "compression_format": "",
            "compression_mode": "",
            "relative_file_paths": [self._name],
            "files": [{"path": self._name, **span()}],
            "custom_data": {"written_by": "airpuck"},
            "ros_distro": "unknown",
        }


def _profiles(best_effort: bool, transient_local: bool) -> str:
    """Return the quality of service as the table's recorder notes it."""
    never = "\n    sec: 9223372036\n    nsec: 854775807\n"
    return (
        f"- history: 3\n  depth: 0\n  reliability: {2 if best_effort else 1}\n"
        f"  durability: {1 if transient_local else 2}\n  deadline:{never}  lifespan:{never}"
        f"  liveliness: 1\n"
        f"  liveliness_lease_duration:{never}  avoid_ros_namespace_conventions: false"
    )
