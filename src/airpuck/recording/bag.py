"""Reading a rosbag2 recording: a folder or a bare storage file."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from pathlib import Path, PurePath
from typing import Any

import numpy as np

from airpuck.boundary.errors import InputError
from airpuck.boundary.parsing import load_yaml
from airpuck.recording.cdr import decode, flatten
from airpuck.recording.files import listing, one_line, sha256
from airpuck.recording.log import Log, TopicLog
from airpuck.recording.mcap_file import read_mcap
from airpuck.recording.message import (
    PATHS,
    accepted,
    columns_of,
    definitions,
    motors_of,
    stamp_paths,
)
from airpuck.recording.sqlite_file import read_sqlite
from airpuck.recording.stream import COLUMNS, SECOND_NS, Recording, Stream, Topics
from airpuck.recording.unpacking import unpacked_file, unpacked_message

METADATA = "metadata.yaml"
#: Endings of storage files, compressed ones included.
STORAGE = (".mcap", ".db3", ".mcap.zstd", ".db3.zstd")


def is_bag(path: Path) -> bool:
    """Return whether a path is a storage file or a folder that holds some."""
    return bool(_stored(path)) if path.is_dir() else path.name.endswith(STORAGE)


def _stored(folder: Path) -> list[Path]:
    """List storage files by name, and by number where the name ends in one: 10 after 9."""

    def order(file: Path) -> tuple[str, int]:
        stem, _, number = file.name.partition(".")[0].rpartition("_")
        return (stem, int(number)) if number.isdecimal() else (file.name, 0)

    found = (file for file in folder.iterdir() if file.name.endswith(STORAGE) and file.is_file())
    return sorted(found, key=order)


def read_bag(path: Path, topics: Topics) -> Recording:
    """Read a rosbag2 folder, or a bare .mcap or .db3 file."""
    wanted = set(topics.by_stream.values())
    metadata = _metadata(path / METADATA) if path.is_dir() else {}
    files = [path] if path.is_file() else _in_order(_stored(path), metadata)
    hashes = {file.name: sha256(file) for file in files}
    if metadata:
        hashes[METADATA] = sha256(path / METADATA)
    log = Log()
    for file in files:
        log.extend(_read_file(file, wanted))
    if str(metadata.get("compression_mode")).lower() == "message":
        _unpack_messages(log, path)
    return Recording(_streams(log, topics, path), str(path), hashes, _warnings(log, metadata))


def _metadata(path: Path) -> dict[str, Any]:
    """Return the recorder's summary; empty where there is none, or a killed recorder left half."""
    try:
        information = load_yaml(path)["rosbag2_bagfile_information"]
    except (InputError, KeyError, TypeError):
        return {}
    return information if isinstance(information, dict) else {}


def _in_order(files: list[Path], metadata: Mapping[str, Any]) -> list[Path]:
    """Put storage files into the order of recording, and leave out those the metadata leaves out.

    By name alone: a bag is read from its own folder, wherever its metadata says it was.
    """
    named = metadata.get("relative_file_paths")
    names = [PurePath(str(name)).name for name in named] if isinstance(named, list) else []
    return [file for name in names for file in files if file.name == name] or files


def _read_file(path: Path, wanted: Collection[str]) -> Log:
    """Read one storage file; of a damaged .mcap, the intact part."""
    if path.stat().st_size == 0:
        raise InputError("is empty", file=path)
    if path.suffix == ".zstd":
        with unpacked_file(path) as plain:
            try:
                return _read_file(plain, wanted)
            except InputError as error:
                raise InputError(error.problem, file=path, field=error.field) from error
    if path.suffix == ".db3":
        return read_sqlite(path, wanted)
    log = read_mcap(path, wanted)
    if log.damage and log.n_messages == 0:
        raise InputError(f"no message can be read: {'; '.join(log.damage)}", file=path)
    log.damage = [f"{path.name} is damaged: {'; '.join(log.damage)}"] if log.damage else []
    return log


def _unpack_messages(log: Log, path: Path) -> None:
    """Unpack messages that the recorder compressed one by one."""
    for name, topic in log.topics.items():
        try:
            topic.messages = list(map(unpacked_message, topic.messages))
        except ValueError as error:
            raise InputError(str(error), file=path, field=name) from error


def _warnings(log: Log, metadata: Mapping[str, Any]) -> tuple[str, ...]:
    """Describe what is damaged, how far the rest reaches, and how much is missing."""
    missing = _missing(log, metadata)
    if not log.damage:
        return (f"metadata.yaml promises more than the files hold: {missing}",) if missing else ()
    parts = [*log.damage]
    if log.first_ns is not None and log.last_ns is not None:
        last = np.datetime_as_string(np.datetime64(log.last_ns // 10**6, "ms"), timezone="UTC")
        seconds = (log.last_ns - log.first_ns) / SECOND_NS
        parts.append(f"read up to {seconds:.3f} s from its start ({last})")
    return ("; ".join([*parts, missing] if missing else parts),)


def _missing(log: Log, metadata: Mapping[str, Any]) -> str:
    """Describe what the recorder's summary promises and the files do not hold."""
    try:
        start_ns = int(metadata["starting_time"]["nanoseconds_since_epoch"])
        end_ns = start_ns + int(metadata["duration"]["nanoseconds"])
        n_messages = int(metadata["message_count"])
    except (KeyError, TypeError, ValueError, OverflowError):
        return ""
    if log.last_ns is None or n_messages <= log.n_messages:
        return ""
    # Lost chunks inside the recording take messages, but no time from its end.
    seconds = max(0, end_ns - log.last_ns) / SECOND_NS
    return f"the last {seconds:.3f} s and {n_messages - log.n_messages} messages are missing"


def _streams(log: Log, topics: Topics, source: Path) -> dict[str, Stream]:
    """Decode the topics that are wanted and there."""
    streams = {}
    for stream, name in topics.by_stream.items():
        topic = log.topics.get(name)
        if topic is not None:
            try:
                streams[stream] = _stream(stream, topic)
            except (ValueError, OverflowError) as error:
                problem = error.problem if isinstance(error, InputError) else one_line(str(error))
                raise InputError(problem, file=source, field=name) from error
        elif topics.required(stream):
            raise InputError(_no_topic(stream, log), file=source, field=name)
    return streams


def _no_topic(stream: str, log: Log) -> str:
    """Describe what the user can name instead of a missing topic."""
    found = sorted((name, topic.msgtype) for name, topic in log.topics.items())
    fitting = [item for item in found if stream == "command" or item[1] in PATHS[stream]]
    shown = listing(f"{name} ({msgtype})" for name, msgtype in fitting or found)
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
    absent = set(paths) - {path for path, code in fields if code.startswith("<")}
    if absent:
        raise InputError(f"{topic.msgtype} is defined without the field {min(absent)}")
    stamps = stamp_paths(fields)
    values = decode(topic.messages, types, topic.msgtype, (*stamps, *paths))
    received = np.array(topic.received_ns, dtype=np.int64)
    stamp = received
    if stamps:
        seconds, nanoseconds = (values[path].astype(np.int64) for path in stamps)
        stamp = seconds * SECOND_NS + nanoseconds
    return Stream(
        stamp_ns=stamp,
        received_ns=received,
        values=columns_of(stream, [values[path].astype(np.float64) for path in paths]),
        columns=columns,
    )
