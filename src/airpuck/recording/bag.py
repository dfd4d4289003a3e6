"""Read bags of ROS 2 and ROS 1, as a folder or a bare storage file; write bags of ROS 2."""

from __future__ import annotations

import os
from collections.abc import Collection, Iterable, Mapping, Sequence
from operator import itemgetter
from pathlib import Path, PurePath
from types import MappingProxyType
from typing import Any

import numpy as np
from ruamel.yaml import YAML

from airpuck.boundary.errors import InputError, explained, listing, shortened
from airpuck.boundary.files import load_yaml
from airpuck.boundary.limits import DEFINITION_BYTES, sha256
from airpuck.boundary.outputs import new_folder
from airpuck.recording.cdr import Types, typestore
from airpuck.recording.conversion import SECOND_NS
from airpuck.recording.mapping import RecordingMapping, Topics, refuse_csv_settings
from airpuck.recording.mcap_file import read_mcap
from airpuck.recording.message import StreamCodec
from airpuck.recording.ros1_file import convert_ros1, read_ros1
from airpuck.recording.sqlite_file import journals, read_sqlite
from airpuck.recording.stream import COMMANDS, POSES, Recording, Stream, joined
from airpuck.recording.topic_stream import may_hold, topic_stream
from airpuck.recording.unpacking import Log, TopicLog, unpacked_file, unpacked_message

METADATA = "metadata.yaml"
#: Topics listed as suggestions when one is missing.
_MOST_LOOKED_AT = 100
#: A recorder that splits a bag begins the next file within this time of the last message [s], and
#: messages that it wrote late overlap by less.
_PAUSE_S, _OVERLAP_S = 60.0, 5.0
#: Suffixes of storage files, compressed ones included.
STORAGE = (".mcap", ".db3", ".mcap.zstd", ".db3.zstd", ".bag")


def is_bag(path: Path) -> bool:
    """Return whether a path is a storage file or a folder that contains one."""
    return bool(_stored(path)) if path.is_dir() else path.name.endswith(STORAGE)


def _stored(folder: Path) -> list[Path]:
    """List storage files by name, and by number if the name ends in one: 10 after 9."""
    found = (file for file in folder.iterdir() if file.name.endswith(STORAGE) and file.is_file())
    return sorted(found, key=_part)


def _part(file: Path) -> tuple[str, str, int]:
    """Return what the files of one split bag have in common, name and suffix, and the number."""
    stem, _, suffix = file.name.partition(".")
    before, _, number = stem.rpartition("_")
    return (before, suffix, int(number)) if number.isdecimal() else (stem, suffix, 0)


def read_bag(path: Path, mapping: RecordingMapping, needs: Sequence[str]) -> Recording:
    """Read a bag's folder, or a bare .mcap, .db3 or .bag file."""
    refuse_csv_settings(mapping, path, "a bag")
    wanted = set(mapping.topics.by_stream.values())
    metadata = _metadata(path / METADATA) if path.is_dir() else {}
    files = [path] if path.is_file() else _in_order(path, metadata)
    read = [path for file in files for path in (file, *journals(file))]
    hashes = {file.name: sha256(file) for file in read}
    if metadata:
        hashes[METADATA] = sha256(path / METADATA)
    log = Log(path)
    for file in files:
        later = _read_file(file, wanted)
        if not metadata:
            _check_follows(log, later, files, path)
        log.extend(later)
    if str(metadata.get("compression_mode")).lower() == "message":
        _unpack_messages(log, path)
    streams, said = _streams(log, mapping, needs, path)
    about = metadata.get("custom_data")
    about = {str(k): str(v) for k, v in about.items()} if isinstance(about, dict) else {}
    return Recording(streams, str(path), hashes, _warnings(log, metadata) + said, about)


def several_recordings(found: Iterable[Path], folder: Path) -> InputError:
    """Return the error for a folder from which one recording must be chosen."""
    names = listing(path.name for path in found)
    return InputError(f"contains several recordings; choose one of {names}", file=folder)


def _metadata(path: Path) -> dict[str, Any]:
    """Return the recorder's summary; empty if it is missing or incomplete."""
    try:
        information = load_yaml(path).get("rosbag2_bagfile_information")
    except InputError:
        return {}
    return information if isinstance(information, dict) else {}


def _in_order(folder: Path, metadata: Mapping[str, Any]) -> list[Path]:
    """Put storage files into recording order, and leave out those missing from the metadata.

    Files are matched by name alone: a bag is read from its own folder, whatever path its metadata
    states.
    """
    files = _stored(folder)
    named = metadata.get("relative_file_paths")
    names = [PurePath(str(name)).name for name in named] if isinstance(named, list) else []
    found = [file for name in names for file in files if file.name == name]
    if not found and len({_part(file)[:2] for file in files}) > 1:
        raise several_recordings(files, folder)
    return found or files


def _check_follows(log: Log, later: Log, files: Sequence[Path], folder: Path) -> None:
    """Raise InputError if a file without metadata does not continue the one before."""
    if log.last_ns is None or later.first_ns is None:
        return
    pause = (later.first_ns - log.last_ns) / SECOND_NS
    if not -_OVERLAP_S <= pause <= _PAUSE_S:
        raise several_recordings(files, folder)


def _read_file(path: Path, wanted: Collection[str]) -> Log:
    """Read one storage file; of a damaged .mcap or .bag, the intact part."""
    if path.stat().st_size == 0 and not journals(path):
        raise InputError("is empty", file=path)
    if path.suffix == ".zstd":
        with unpacked_file(path) as plain:
            try:
                return _read_file(plain, wanted)
            except InputError as error:
                raise InputError(error.problem, file=path, field=error.field) from error
    if path.suffix == ".db3":
        return read_sqlite(path, wanted)
    log = (read_ros1 if path.suffix == ".bag" else read_mcap)(path, wanted)
    convert_ros1(log, path)
    if log.damage and log.n_messages == 0:
        raise InputError(f"no message can be read: {'; '.join(log.damage)}", file=path)
    log.damage = [f"{path.name} is damaged: {'; '.join(log.damage)}"] if log.damage else []
    return log


def _unpack_messages(log: Log, path: Path) -> None:
    """Unpack messages that the recorder compressed one by one."""
    for topic in log.entries:
        with explained(ValueError, "{error}", file=path, field=topic.name):
            topic.messages = list(map(unpacked_message, topic.messages))


def _warnings(log: Log, metadata: Mapping[str, Any]) -> tuple[str, ...]:
    """Describe the damage, how far the rest reaches, and how much is missing."""
    missing = _missing(log, metadata)
    if not log.damage:
        return (f"metadata.yaml lists more than the files contain: {missing}",) if missing else ()
    parts = [*log.damage]
    if log.first_ns is not None and log.last_ns is not None:
        last = np.datetime_as_string(np.datetime64(log.last_ns // 10**6, "ms"), timezone="UTC")
        seconds = (log.last_ns - log.first_ns) / SECOND_NS
        parts.append(f"read up to {seconds:.3f} s from its start ({last})")
    return ("; ".join([*parts, missing] if missing else parts),)


def _missing(log: Log, metadata: Mapping[str, Any]) -> str:
    """Describe what the recorder's summary promises and the files do not contain."""
    try:
        start_ns = int(metadata["starting_time"]["nanoseconds_since_epoch"])
        end_ns = start_ns + int(metadata["duration"]["nanoseconds"])
        n_messages = int(metadata["message_count"])
    except (KeyError, TypeError, ValueError, OverflowError):
        return ""
    if log.last_ns is None or n_messages <= log.n_messages:
        return ""
    # Lost chunks inside the recording remove messages, but no time from its end.
    seconds = max(0, end_ns - log.last_ns) / SECOND_NS
    return f"the last {seconds:.3f} s and {n_messages - log.n_messages} messages are missing"


def _streams(
    log: Log, mapping: RecordingMapping, needs: Sequence[str], source: Path
) -> tuple[dict[str, Stream], tuple[str, ...]]:
    """Decode the requested topics that the bag has, and warn about missing stamps."""
    streams, warnings, missing = {}, [], []
    for stream, name in mapping.topics.by_stream.items():
        entries = log.topics.get(name)
        if entries is not None:
            try:
                streams[stream], stamped, said = _decoded(stream, entries, mapping)
            except (ValueError, OverflowError) as error:
                problem = error.problem if isinstance(error, InputError) else shortened(str(error))
                field = error.field if isinstance(error, InputError) else None
                raise InputError(problem, file=source, field=field or name) from error
            warnings += [f"{name}: {text}" for text in said]
            if not stamped and stream in (*POSES, *COMMANDS):
                warnings.append(
                    f"messages on {name} have no time: the recorder's arrival times are used, "
                    "which include transport jitter"
                )
        elif mapping.topics.required(stream, needs):
            missing.append(stream)
    if missing:
        absent = ", ".join(mapping.topics.by_stream[stream] for stream in missing)
        raise InputError(_no_topics(missing, log), file=source, field=absent)
    return streams, tuple(warnings)


def _decoded(
    stream: str, entries: Sequence[TopicLog], mapping: RecordingMapping
) -> tuple[Stream, bool, list[str]]:
    """Decode a topic, each message by its own definition; return whether all carry times."""
    entries = [entry for entry in entries if entry.messages or entry.foreign] or entries[:1]
    foreign = next((entry.encoding for entry in entries if entry.foreign), None)
    if foreign is not None:
        raise InputError(
            f"its messages are encoded as {shortened(foreign) or 'nothing'}, and airpuck reads cdr "
            "(ROS 2) and ros1; export the topic as CSV, and name its columns in a mapping"
        )
    parts = [topic_stream(stream, entry, mapping) for entry in entries]
    whole, stamped = joined([part for part, _ in parts]), all(timed for _, timed in parts)
    if len(parts) == 1:
        return whole, stamped, []
    types = listing(dict.fromkeys(entry.msgtype for entry in entries))
    text = f"has {len(parts)} definitions ({types}); each message is read by its own"
    return whole, stamped, [text]


def _quick_to_parse(log: Log) -> list[TopicLog]:
    """Return the topics suggested when one is missing; their definitions must be parsed."""
    found, spent = [], 0
    readable = [entry for entry in log.entries if not entry.foreign]
    for topic in sorted(readable, key=lambda entry: len(entry.definition)):
        spent += len(topic.definition)
        if spent <= DEFINITION_BYTES and len(found) < _MOST_LOOKED_AT:
            found.append(topic)
    return sorted(found, key=lambda entry: entry.name)


def _no_topics(missing: list[str], log: Log) -> str:
    """Return the error that names the missing topics and shows the mapping to write."""
    shown, choices = [], []
    topics = _quick_to_parse(log)
    for stream in missing:
        found = list(dict.fromkeys(topic.name for topic in topics if may_hold(stream, topic)))
        shown.append(f'{stream} = "{found[0] if found else "/..."}"')
        if len(found) != 1:
            types = found or sorted(log.topics)
            listed = listing(f"{name} ({_described(log.topics[name][0])})" for name in types)
            choices.append(f"; {stream} out of {listed}" if types else "")
    damage = f" ({'; '.join(log.damage)})" if log.damage else ""
    return (
        f"there is no such topic{damage}; name topics in a file for --mapping: "
        f"topics = {{{', '.join(shown)}}}{''.join(choices)}"
    )


def _described(topic: TopicLog) -> str:
    """Return a topic's type, and its encoding if that is not read."""
    return f"{topic.msgtype}, encoded as {topic.encoding}" if topic.foreign else topic.msgtype


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
        with explained(ValueError, "{error}", file=recording.source, field=name):
            codecs[name] = _codec(name, stream, known=name in names)
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
