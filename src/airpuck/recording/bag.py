"""Reading a rosbag2 recording: a folder or a bare storage file."""

from __future__ import annotations

import datetime
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path, PurePath
from typing import Any

import numpy as np

from airpuck.boundary.errors import InputError
from airpuck.recording.cdr import decode, flatten
from airpuck.recording.fingerprint import sha256
from airpuck.recording.listing import listing, one_line
from airpuck.recording.message_types import (
    PATHS,
    accepted,
    columns_of,
    definitions,
    motors_of,
    stamp_paths,
)
from airpuck.recording.salvage import salvage_mcap
from airpuck.recording.stream import COLUMNS, Recording, Stream
from airpuck.recording.topic_log import TopicLog
from airpuck.recording.topics import Topics

METADATA = "metadata.yaml"
#: Endings of storage files, compressed ones included.
STORAGE = (".mcap", ".db3", ".mcap.zstd", ".db3.zstd")
_SECOND = 10**9


@dataclass
class _Log:
    """What the files of a bag hold."""

    topics: dict[str, TopicLog] = field(default_factory=dict)
    n_messages: int = 0
    first_ns: int | None = None
    last_ns: int | None = None
    damage: list[str] = field(default_factory=list)

    def add(
        self,
        topics: Mapping[str, TopicLog],
        n_messages: int,
        first_ns: int | None,
        last_ns: int | None,
    ) -> None:
        """Append a later file."""
        for name, topic in topics.items():
            if name in self.topics:
                self.topics[name].extend(topic)
            else:
                self.topics[name] = topic
        self.n_messages += n_messages
        if first_ns is not None and last_ns is not None:
            self.first_ns = first_ns if self.first_ns is None else min(self.first_ns, first_ns)
            self.last_ns = last_ns if self.last_ns is None else max(self.last_ns, last_ns)


def is_bag(path: Path) -> bool:
    """Say whether a path is a storage file or a folder that holds some."""
    if path.is_dir():
        return any(entry.name.endswith(STORAGE) and entry.is_file() for entry in path.iterdir())
    return path.name.endswith(STORAGE)


def read_bag(path: Path, topics: Topics) -> Recording:
    """Read a rosbag2 folder, or a bare .mcap or .db3 file."""
    wanted = set(topics.by_stream.values())
    metadata = _metadata(path / METADATA) if path.is_dir() else {}
    files = _storage_files(path, metadata)
    hashes = {file.name: sha256(file) for file in files}
    if metadata:
        hashes[METADATA] = sha256(path / METADATA)
    if metadata.get("compression_mode"):
        log = _read_whole(path, wanted)
    else:
        log = _Log()
        for file in files:
            _read_file(file, wanted, log)
    warnings = _warnings(log, metadata)
    return Recording(_streams(log, topics, path), str(path), hashes, warnings)


def _metadata(path: Path) -> dict[str, Any]:
    """Return the recorder's summary; empty where there is none, or a killed recorder left half."""
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError

    try:
        content = YAML(typ="safe").load(path.read_text(encoding="utf-8"))
        information = content["rosbag2_bagfile_information"]
        return information if isinstance(information, dict) else {}
    except (OSError, UnicodeDecodeError, YAMLError, KeyError, TypeError, ValueError):
        return {}


def _storage_files(path: Path, metadata: Mapping[str, Any]) -> list[Path]:
    """Return the storage files in the order of recording."""
    if path.is_file():
        return [path]
    present = sorted(
        (entry for entry in path.iterdir() if entry.name.endswith(STORAGE) and entry.is_file()),
        key=_split_number,
    )
    named = metadata.get("relative_file_paths")
    if not isinstance(named, list):
        return present
    # Names alone: a bag is read from its own folder, wherever its metadata says it was.
    listed = [path / PurePath(str(name)).name for name in named]
    return [file for file in listed if file in present] or present


def _split_number(path: Path) -> tuple[str, int]:
    """Sort key: rosbag2 numbers the files of a split bag, and 10 comes after 9."""
    stem, _, number = path.name.partition(".")[0].rpartition("_")
    return (stem, int(number)) if number.isdecimal() else (path.name, 0)


def _read_file(path: Path, wanted: Collection[str], log: _Log) -> None:
    """Append one storage file to a log."""
    if path.stat().st_size == 0:
        raise InputError("is empty", file=path)
    try:
        whole = _read_whole(path, wanted)
    except InputError:
        if path.suffix != ".mcap":
            raise
    else:
        log.add(whole.topics, whole.n_messages, whole.first_ns, whole.last_ns)
        return
    rest = salvage_mcap(path, wanted)
    if rest.n_messages == 0:
        what = "; ".join(rest.damage) or "it holds no message"
        raise InputError(f"no message can be read: {what}", file=path)
    log.add(rest.topics, rest.n_messages, rest.first_ns, rest.last_ns)
    if rest.damage:
        log.damage.append(f"{path.name} is damaged: {'; '.join(rest.damage)}")


def _read_whole(path: Path, wanted: Collection[str]) -> _Log:
    """Read an undamaged file or folder through rosbags."""
    from rosbags.interfaces import MessageDefinitionFormat
    from rosbags.rosbag2 import Reader

    log = _Log()
    try:
        with Reader(path) as reader:
            for connection in reader.connections:
                if not isinstance(connection.topic, str) or not isinstance(connection.msgtype, str):
                    raise ValueError("a topic has no name or no type")
                log.topics.setdefault(
                    connection.topic,
                    TopicLog(
                        connection.msgtype,
                        connection.msgdef.data,
                        connection.msgdef.format == MessageDefinitionFormat.IDL,
                    ),
                )
            connections = [item for item in reader.connections if item.topic in wanted]
            if connections:
                for connection, time, message in reader.messages(connections):
                    # SQLite checks no types, so that a damaged file can hold anything anywhere.
                    if type(time) is not int or not 0 <= time < 2**63 or type(message) is not bytes:
                        raise ValueError("a message has no time or no content")
                    topic = log.topics[connection.topic]
                    topic.received_ns.append(time)
                    topic.messages.append(message)
            log.n_messages = reader.message_count
            if log.n_messages:
                log.first_ns, log.last_ns = reader.start_time, reader.end_time - 1
    # rosbags checks little, so that a damaged file can make it fail in any way.
    except Exception as error:
        reason = one_line(str(error).rstrip(".") or type(error).__name__)
        raise InputError(f"is not a readable recording ({reason})", file=path) from error
    return log


def _warnings(log: _Log, metadata: Mapping[str, Any]) -> tuple[str, ...]:
    """Say what is damaged, how far the rest reaches, and how much is missing."""
    said = _said(metadata)
    missing = "" if said is None else _missing(log, *said)
    if not log.damage:
        return (f"metadata.yaml promises more than the files hold: {missing}",) if missing else ()
    if log.first_ns is None or log.last_ns is None:
        return tuple(log.damage)
    moment = datetime.datetime.fromtimestamp(0, datetime.UTC) + datetime.timedelta(
        microseconds=log.last_ns // 1000
    )
    reach = (
        f"read up to {(log.last_ns - log.first_ns) / _SECOND:.3f} s from its start "
        f"({moment.isoformat(timespec='milliseconds').replace('+00:00', 'Z')})"
    )
    return (f"{'; '.join(log.damage)}; {reach}{'; ' if missing else ''}{missing}",)


def _said(metadata: Mapping[str, Any]) -> tuple[int, int] | None:
    """Return the end [ns since the epoch] and the number of messages by the recorder's summary."""
    try:
        start = int(metadata["starting_time"]["nanoseconds_since_epoch"])
        return start + int(metadata["duration"]["nanoseconds"]), int(metadata["message_count"])
    except (KeyError, TypeError, ValueError, OverflowError):
        return None


def _missing(log: _Log, end_ns: int, n_messages: int) -> str:
    """Say what the recorder's summary promises and the files do not hold."""
    if log.last_ns is None or n_messages <= log.n_messages:
        return ""
    # Lost chunks inside the recording take messages, but no time from its end.
    seconds = max(0, end_ns - log.last_ns) / _SECOND
    return f"the last {seconds:.3f} s and {n_messages - log.n_messages} messages are missing"


def _streams(log: _Log, topics: Topics, source: Path) -> dict[str, Stream]:
    """Decode the topics that are wanted and there."""
    streams = {}
    for stream, name in topics.by_stream.items():
        topic = log.topics.get(name)
        if topic is not None:
            try:
                streams[stream] = _stream(stream, topic)
            except InputError as error:
                raise InputError(error.problem, file=source, field=name) from error
            except (ValueError, OverflowError) as error:
                raise InputError(one_line(str(error)), file=source, field=name) from error
        elif topics.required(stream):
            raise InputError(_no_topic(stream, log), file=source, field=name)
    return streams


def _no_topic(stream: str, log: _Log) -> str:
    """Say what the user can name instead of a missing topic."""
    fitting = {
        name: topic.msgtype
        for name, topic in log.topics.items()
        if stream == "command" or topic.msgtype in PATHS[stream]
    } or {name: topic.msgtype for name, topic in log.topics.items()}
    shown = listing(f"{name} ({msgtype})" for name, msgtype in sorted(fitting.items()))
    damage = f" ({'; '.join(log.damage)})" if log.damage else ""
    return (
        f"there is no such topic{damage}; name the {stream} topic, [topics] {stream} = "
        f'"/...", out of {shown}'
    )


def _stream(stream: str, topic: TopicLog) -> Stream:
    """Decode one topic."""
    wrong = f"holds {one_line(topic.msgtype)}, but a {stream} is {accepted(stream)}"
    if stream != "command" and topic.msgtype not in PATHS[stream]:
        raise InputError(wrong)
    types = definitions(topic.msgtype, topic.definition, idl=topic.idl)
    if topic.msgtype not in types:
        raise InputError(f"the recording does not say what {one_line(topic.msgtype)} holds")
    fields = flatten(types, topic.msgtype)
    if stream == "command":
        paths = columns = motors_of(fields)
    else:
        paths, columns = PATHS[stream][topic.msgtype], COLUMNS[stream]
    if not paths:
        raise InputError(wrong)
    absent = set(paths) - {field.path for field in fields if field.count == 1}
    if absent:
        raise InputError(f"{topic.msgtype} is defined without the field {min(absent)}")
    stamps = stamp_paths(fields)
    values = decode(topic.messages, types, topic.msgtype, (*stamps, *paths))
    received = np.array(topic.received_ns, dtype=np.int64)
    stamp = received
    if stamps:
        seconds, nanoseconds = (values[path].astype(np.int64) for path in stamps)
        stamp = seconds * _SECOND + nanoseconds
    return Stream(
        stamp_ns=stamp,
        received_ns=received,
        values=columns_of(stream, [values[path].astype(np.float64) for path in paths]),
        columns=columns,
    )
