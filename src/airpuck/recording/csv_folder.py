"""CSV files: one for each stream, or one for poses and commands together.

The authors' files are named after their topics (``/drone/control`` is in ``drone_control.csv``),
their columns after the message fields; ``log_time_ns`` is the recorder's clock. A mapping names the
columns of other files; exports of motion capture programs are recognised.
"""

from __future__ import annotations

import csv
import itertools
import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from airpuck.boundary.errors import InputError, listing, nearest
from airpuck.boundary.limits import sha256
from airpuck.boundary.outputs import new_folder
from airpuck.recording.cdr import Field
from airpuck.recording.conversion import SECOND_NS
from airpuck.recording.csv_table import (
    CsvTable,
    check_digits,
    collecting_no_garbage,
    is_list,
    of_body,
    plain_table,
    read_rows,
)
from airpuck.recording.mapping import (
    CommandMapping,
    Orientation,
    PoseMapping,
    RecordingMapping,
    Topics,
    completed,
)
from airpuck.recording.message import PATHS, STAMP
from airpuck.recording.motion_capture_export import VICON, is_export, read_export
from airpuck.recording.stream import COMMANDS, POSES, Recording, Stream, left_out
from airpuck.recording.topic_stream import place_of, section_of, stream_of

#: Suffixes of CSV files.
TABLES = (".csv", ".tsv")
_RECEIVED = "log_time_ns"
_SECONDS, _NANOSECONDS = STAMP
_FRAME = "header.frame_id"
_POSITION = PATHS["pose"]["geometry_msgs/msg/PoseStamped"][:2]
_HEIGHT = "pose.position.z"
_YAW = "pose.orientation.yaw"
_QUATERNION = tuple(f"pose.orientation.{axis}" for axis in "wxyz")
#: Mapping to write if columns are not the authors'.
_TO_WRITE = {
    "pose": 'time = "...", position = ["...", "..."], orientation = "..."',
    "command": 'time = "...", values = ["...", ...]',
    "puck": 'time = "...", position = ["...", "..."]',
}
#: What else to write if the units differ.
_OTHER_UNITS = {
    "pose": '; if units are not m, rad and s, add units = ["mm", "deg", "ms"] to pose',
    "command": "; if commands are not 0 to 1, add scale to command, 0.01 for percent",
}


def is_table(path: Path) -> bool:
    """Return whether a file is named like a CSV file."""
    return path.suffix.lower() in TABLES


def is_csv_folder(path: Path, mapping: RecordingMapping) -> bool:
    """Return whether a folder contains the CSV files of a recording."""
    return any(_candidates(path, stream, mapping) for stream in (*POSES, "command"))


def _named(stream: str, mapping: RecordingMapping) -> str:
    """Return the file that the mapping names for a stream."""
    section = mapping.sections.get(stream)
    return section.file if section else ""


def _candidates(folder: Path, stream: str, mapping: RecordingMapping) -> list[Path]:
    """Find files that may hold a pose or a command, by the mapping or by their names."""
    named = _named(stream, mapping)
    of_topic = folder / _file_name(mapping.topics.by_stream[stream])
    for path in (folder / named if named else None, of_topic):
        if path is not None and path.is_file():
            return [path]
    pattern = {"pose": "*pose*.csv", "command": "*control*.csv"}.get(stream)
    if pattern is None or named:
        return []
    others = {
        _file_name(topic) for name, topic in mapping.topics.by_stream.items() if name != stream
    }
    found = {file for file in folder.glob(pattern) if "state_ref" not in file.name}
    found = {file for file in found if file.name not in others}
    if stream == "pose" and not found:
        found = {file for file in folder.iterdir() if is_table(file) and file.is_file()}
        found = {file for file in found if is_export(file)}
    return sorted(file for file in found if file.is_file())


def read_csv(
    folder: Path, mapping: RecordingMapping, needs: Sequence[str], single: Path | None
) -> Recording:
    """Read a folder with CSV files, or a `single` file in it with poses and commands."""
    streams: dict[str, Stream] = {}
    hashes: dict[str, str] = {}
    warnings: list[str] = []
    problems: list[InputError] = []
    if single is not None and not is_export(single):
        _require_columns(single, mapping, needs)
    for stream in mapping.topics.by_stream:
        path = None
        try:
            path = _file_of(stream, folder, mapping, needs, single)
            if path is None:
                continue
            with collecting_no_garbage():
                streams[stream], said = _stream(stream, path, mapping)
            hashes[path.name] = sha256(path)
            warnings += said
        except InputError as error:
            file = error.file or path or single
            problems.append(InputError(error.problem, file=file, field=error.field))
    if len(problems) == 1:
        raise problems[0]
    if problems:
        raise InputError("; ".join(str(problem) for problem in problems))
    return Recording(streams, str(single or folder), hashes, tuple(dict.fromkeys(warnings)))


def _require_columns(single: Path, mapping: RecordingMapping, needs: Sequence[str]) -> None:
    """Raise InputError for a single file whose columns are unknown."""
    if not mapping.model_fields_set - {"topics"}:
        written = " and ".join(f"{stream} = {{{_TO_WRITE[stream]}}}" for stream in needs)
        found = listing(plain_table(read_rows(single)).columns)
        raise InputError(
            "is a single CSV file; name the folder with one file per stream, or name its columns "
            f"in a file for --mapping: {written} out of {found}{''.join(_OTHER_UNITS.values())}",
            file=single,
        )


def _file_of(
    stream: str, folder: Path, mapping: RecordingMapping, needs: Sequence[str], single: Path | None
) -> Path | None:
    """Find the file of a stream; None if it does not exist and is not needed."""
    named = _named(stream, mapping)
    if single is not None and not named:
        if stream == "command" and is_export(single):
            raise InputError(
                "contains only poses; name the file of the commands in a file for --mapping: "
                f'command = {{file = "...", {_TO_WRITE["command"]}}}'
            )
        return single if stream in needs or stream in mapping.model_fields_set else None
    candidates = _candidates(folder, stream, mapping)
    if len(candidates) > 1:
        names = listing(file.name for file in candidates)
        raise InputError(
            f"contains several files that may be the {stream} ({names}); keep one, or name it in a "
            f'file for --mapping: {stream} = {{file = "{candidates[0].name}"}}',
            file=folder,
        )
    if candidates:
        return candidates[0]
    if not named and not mapping.topics.required(stream, needs):
        return None
    usual = named or f"{_file_name(mapping.topics.by_stream[stream])} or the like"
    problem = f"has no {stream} file ({usual})"
    if stream in _TO_WRITE:
        there = listing(sorted(file.name for file in folder.iterdir() if is_table(file)))
        problem += (
            f'; name it in a file for --mapping: {stream} = {{file = "...", {_TO_WRITE[stream]}}} '
            f"out of {there}{_OTHER_UNITS.get(stream, '')}"
        )
    raise InputError(problem, file=folder)


def _file_name(topic: str) -> str:
    """Return the name that the authors' conversion gives a topic's file."""
    return f"{topic.strip('/').replace('/', '_')}.csv"


def _stream(stream: str, path: Path, mapping: RecordingMapping) -> tuple[Stream, tuple[str, ...]]:
    """Read a stream from a file, and describe what was left out."""
    rows = read_rows(path)
    own, msgtype = section_of(stream, "", mapping), ""
    exported = read_export(rows, mapping.pose.body) if stream == "pose" else None
    if exported is None:
        table = plain_table(rows)
    else:
        table, usual = exported
        if own.time not in ("", usual["time"]):
            program = rows.cells[0][0].strip()
            program = "Vicon" if program in VICON else "motion capture"
            problem = f"is a {program} export, whose rate gives the times; leave out `time`"
            raise InputError(problem, file=path, field="pose.time")
        own = completed(own, usual).model_copy(update={"body": ""})
    groups: tuple[Sequence[str], ...] = ()
    if isinstance(own, PoseMapping):
        own, groups = _of_poses(stream, table, own)
    elif stream in COMMANDS:
        own = own.model_copy(update={"values": _values(table, own)})
        groups = (tuple(place_of(name, table.columns).path for name in own.values),)
    else:
        fits = (kind for kind, names in PATHS[stream].items() if set(names) <= set(table.columns))
        msgtype = next(fits, next(iter(PATHS[stream])))
    names = tuple(itertools.chain(*groups))
    if groups:
        _require(stream, table, names, own)
    if isinstance(own, PoseMapping):
        table = of_body(table, own.body, (own.time, own.interval, *names), stream)
    timed = _timed(table, own)
    poses = isinstance(own, PoseMapping)
    table, blank = timed.without_blank(*groups, most=all if poses else any)
    made = _converted(stream, msgtype, table, own)
    if groups and not (poses and (own.rate_hz or own.stamps)):
        check_digits(table, made)
    kind = "commands" if stream in COMMANDS else "poses"
    return made, table.warnings + left_out(kind, blank)


def _of_poses(
    stream: str, table: CsvTable, own: PoseMapping
) -> tuple[PoseMapping, tuple[Sequence[str], Sequence[str]]]:
    """Choose the columns of positions and orientations: those in the mapping, or the authors'."""
    heights = table.columns.get(_HEIGHT, ())
    level = (*_POSITION, _HEIGHT) if heights and all(map(str.strip, heights)) else _POSITION
    # The authors' conversion added the yaw; a plain conversion contains only the quaternion.
    plain = set(_QUATERNION) <= set(table.columns) and _YAW not in table.columns
    usual = Orientation("quaternion", _QUATERNION[1:] + _QUATERNION[:1])
    orientation = own.orientation or (usual if plain else Orientation("yaw", (_YAW,)))
    if stream == "puck" and own.orientation is None and own.position:
        orientation = Orientation("none", ())  # A camera sees the puck's position, not its angle.
    found = {"position": own.position or level, "orientation": orientation}
    return own.model_copy(update=found), (found["position"], orientation.columns)


def _values(table: CsvTable, own: CommandMapping) -> tuple[str, ...]:
    """Choose the columns of commands: those in the mapping, or the authors' motors."""
    if own.values:
        return own.values
    if own.propellers and set(own.propellers) <= set(table.columns):
        return own.propellers
    times = (_RECEIVED, own.time, own.interval)
    names = [n for n in table.columns if n not in times and not n.startswith("header.")]
    names = [name for name in names if name.startswith("motor")] or names
    if not names:
        _require("command", table, (), own)
        problem = f"has no column of a motor (it has {listing(table.columns)})"
        raise InputError(problem, file=table.path)
    return tuple(names)


def _converted(
    stream: str, msgtype: str, table: CsvTable, own: PoseMapping | CommandMapping
) -> Stream:
    """Convert a table like the messages of a topic with a field for each column."""

    def read(names: Sequence[str]) -> dict[str, np.ndarray]:
        return {name: cells(name) for name in names}

    def cells(name: str) -> np.ndarray:
        if not own.time and name in STAMP:
            return table.numbers(name, int)
        if name == own.time:
            exact = own.size("time") == 1 / SECOND_NS and not own.interval
            return table.times(name, exact=exact)
        if isinstance(own, CommandMapping) and own.bits:
            return table.masks(name)
        texts = table.columns.get(name, ())
        return table.lists(name) if texts and is_list(texts[0]) else table.numbers(name)

    if own.interval:
        own = own.model_copy(update={"time": own.interval})
    logged = _RECEIVED in table.columns and not own.time
    received = table.numbers(_RECEIVED, int) if logged else np.zeros(len(table.lines), np.int64)
    if isinstance(own, PoseMapping):
        own = own.model_copy(update={"body": ""})  # the table has the rows of one
    stamps = () if _RECEIVED in table.columns and _SECONDS not in table.columns else STAMP
    names = dict.fromkeys((*table.columns, *stamps, *PATHS.get(stream, {}).get(msgtype, ())))
    fields = [Field(name, "<f8") for name in names]
    made, _ = stream_of(stream, msgtype, fields, read, received, own)
    return made if logged else replace(made, received_ns=made.stamp_ns)


def _require(
    stream: str, table: CsvTable, names: Sequence[str], mapping: PoseMapping | CommandMapping
) -> None:
    """Raise InputError for missing columns, listing all of them and the mapping to write."""
    times = tuple(name for name in (mapping.time, mapping.interval) if name)
    if not times and _RECEIVED not in table.columns:
        times = STAMP
    missing = [name for name in (*times, *names) if name not in table.columns]
    if missing:
        keys = _TO_WRITE.get(stream, _TO_WRITE["pose"])
        # A user who names columns does not expect the authors' stamps.
        unnamed = not (mapping.time or mapping.interval) and set(missing).issubset(STAMP)
        problem = "no column is named for the time" if unnamed else "there is no such column"
        raise InputError(
            f"{problem}; name columns in a file for --mapping: {stream} = "
            f"{{{keys}}} out of {listing(table.columns)}" + nearest(missing[0], table.columns),
            file=table.path,
            field="time" if unnamed else ", ".join(missing),
        )


def _timed(table: CsvTable, mapping: PoseMapping | CommandMapping) -> CsvTable:
    """Replace a column of intervals by times."""
    if not mapping.interval:
        return table
    texts = list(table.columns[mapping.interval])
    if texts and not texts[0].strip():
        texts[0] = "0"  # The first row has no predecessor.
    table = replace(table, columns={**table.columns, mapping.interval: texts})
    steps = table.numbers(mapping.interval)
    if (steps < 0).any():
        problem = (
            f"row {int(np.argmax(steps < 0)) + 1} is negative; for a column of times use `time`"
        )
        raise InputError(problem, file=table.path, field=mapping.interval)
    with np.errstate(over="ignore"):  # reported with the time that follows from it
        times = list(map(repr, np.cumsum(steps).tolist()))
    return replace(table, columns={**table.columns, mapping.interval: times})


def write_csv(
    recording: Recording, folder: str | os.PathLike[str], *, topics: Topics | None = None
) -> None:
    """Save a recording as the authors' CSV files, one for each stream.

    Parameters
    ----------
    recording : Recording
        What to save.
    folder : path-like
        The folder to create; it may exist if it is empty.
    topics : Topics, optional
        Determines the file names; the default is the authors' table.

    Raises
    ------
    InputError
        If the folder is not empty, or a stream is unknown.

    Notes
    -----
    Written with enough digits to be read back bit for bit.

    Examples
    --------
    >>> airpuck.write_csv(recording, "csv/")
    >>> airpuck.read_recording("csv/")["pose"].columns
    ('x_m', 'y_m', 'yaw_rad')
    """
    names = (topics or Topics()).by_stream
    for stream in recording.streams:
        if stream not in names:
            raise InputError(
                "is not a stream that CSV files can hold", file=recording.source, field=stream
            )
    with new_folder(folder) as temporary:
        temporary.mkdir()
        for name, stream in recording.streams.items():
            table = _as_table(name, stream)
            file = temporary / _file_name(names[name])
            with file.open("w", encoding="utf-8", newline="") as output:
                writer = csv.writer(output, lineterminator="\n")
                writer.writerow(table)
                writer.writerows(zip(*table.values(), strict=True))


def _as_table(name: str, stream: Stream) -> dict[str, Sequence[object]]:
    """Arrange a stream's columns as the authors do."""
    n = len(stream)
    level = [0.0] * n
    table: dict[str, Sequence[object]] = {_RECEIVED: stream.received_ns.tolist()}
    # The authors' references carry no header, but references with their own stamps need one.
    if name != "reference" or not np.array_equal(stream.stamp_ns, stream.received_ns):
        seconds, nanoseconds = np.divmod(stream.stamp_ns, SECOND_NS)
        table[_FRAME] = ["body" if name in COMMANDS else ""] * n
        table[_NANOSECONDS] = nanoseconds.tolist()
        table[_SECONDS] = seconds.tolist()
    columns = stream.columns if name in COMMANDS else next(iter(PATHS[name].values()))
    if name in POSES:
        yaw = stream.values[:, 2]
        w, z = np.cos(yaw / 2).tolist(), np.sin(yaw / 2).tolist()
        table |= {"pose.orientation.roll": level, "pose.orientation.pitch": level}
        table |= {_YAW: yaw.tolist(), **dict(zip(_QUATERNION, (w, level, level, z), strict=True))}
        columns = (*columns[:2], _YAW)
    # tolist gives Python floats, which csv writes so that they are read back bit for bit.
    table.update(zip(columns, stream.values.T.tolist(), strict=True))
    if name in POSES:
        table["pose.position.z"] = level
    return table
