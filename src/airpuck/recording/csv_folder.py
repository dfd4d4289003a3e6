"""CSV files: one for each stream, or one for poses and commands together.

The authors' files are named after their topics (``/drone/control`` is in ``drone_control.csv``),
their columns after the message fields; ``log_time_ns`` is the recorder's clock. A mapping names the
columns of other files; exports of motion capture programs are recognised.
"""

from __future__ import annotations

import csv
import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int64, Shaped

from airpuck.boundary.errors import InputError
from airpuck.boundary.kinds import nearest
from airpuck.craft.vehicle import unnamed_columns
from airpuck.recording.conversion import SECOND_NS
from airpuck.recording.csv_table import (
    CsvTable,
    check_digits,
    is_list,
    of_body,
    plain_table,
    read_rows,
)
from airpuck.recording.files import listing, new_folder, sha256, shortened
from airpuck.recording.mapping import (
    ENTRY,
    CommandMapping,
    Orientation,
    PoseMapping,
    RecordingMapping,
    Topics,
    completed,
)
from airpuck.recording.message import PATHS, columns_of
from airpuck.recording.motion_capture_export import VICON, is_export, read_export
from airpuck.recording.stream import (
    COLUMNS,
    COMMANDS,
    POSES,
    Recording,
    Stream,
    command_stream,
    left_out,
    pose_stream,
)

#: Suffixes of CSV files.
TABLES = (".csv", ".tsv")
_RECEIVED = "log_time_ns"
_SECONDS, _NANOSECONDS = "header.stamp.sec", "header.stamp.nanosec"
_FRAME = "header.frame_id"
_POSITION = PATHS["pose"]["geometry_msgs/msg/PoseStamped"][:2]
_HEIGHT = "pose.position.z"
_YAW = "pose.orientation.yaw"
_QUATERNION = tuple(f"pose.orientation.{axis}" for axis in "wxyz")
#: int64 nanoseconds end in the year 2262.
_LATEST_SECOND = 2**63 // SECOND_NS - 1
#: Mapping to write if columns are not the authors'.
_TO_WRITE = {
    "pose": 'time = "...", position = ["...", "..."], orientation = "..."',
    "command": 'time = "...", values = ["...", ...]',
    "puck": 'time = "...", position = ["...", "..."]',
}


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
        found = {file for file in folder.iterdir() if file.suffix in TABLES and file.is_file()}
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
            streams[stream], said = _stream(stream, path, mapping)
            hashes[path.name] = sha256(path)
            warnings += said
        except InputError as error:
            file = error.file or path
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
            f"in a file for --mapping: {written} out of {found}. If units are not m, rad and s, "
            'or commands not 0 to 1, add units = ["mm", "deg", "ms"] to pose and scale to command',
            file=single,
        )


def _file_of(
    stream: str,
    folder: Path,
    mapping: RecordingMapping,
    needs: Sequence[str],
    single: Path | None,
) -> Path | None:
    """Find the file of a stream; None if it does not exist and is not needed."""
    named = _named(stream, mapping)
    if single is not None and not named:
        if stream == "command" and is_export(single):
            raise InputError(
                "contains only poses; name the file of the commands in a file for --mapping: "
                f'command = {{file = "...", {_TO_WRITE["command"]}}}',
                file=single,
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
        there = listing(sorted(file.name for file in folder.iterdir() if file.suffix in TABLES))
        problem += (
            f'; name it in a file for --mapping: {stream} = {{file = "...", {_TO_WRITE[stream]}}} '
            f"out of {there}"
        )
    raise InputError(problem, file=folder)


def _file_name(topic: str) -> str:
    """Return the name that the authors' conversion gives a topic's file."""
    return f"{topic.strip('/').replace('/', '_')}.csv"


def _stream(stream: str, path: Path, mapping: RecordingMapping) -> tuple[Stream, tuple[str, ...]]:
    """Read a stream from a file, and describe what was left out."""
    rows = read_rows(path)
    if stream == "pose":
        exported = read_export(rows, mapping.pose.body)
        if exported is None:
            return _poses(plain_table(rows), mapping.pose)
        table, usual = exported
        if mapping.pose.time not in ("", usual["time"]):
            program = rows.cells[0][0].strip()
            program = "Vicon" if program in VICON else "motion capture"
            problem = f"is a {program} export, whose rate gives the times; leave out `time`"
            raise InputError(problem, file=path, field="pose.time")
        own = completed(mapping.pose, usual).model_copy(update={"body": ""})
        return _poses(table, own)
    table = plain_table(rows)
    if stream in COMMANDS:
        return _commands(table, mapping.of_commands(stream))
    if stream in POSES:
        return _poses(table, mapping.of_poses(stream), stream)
    types = list(PATHS[stream].values())
    names = next((names for names in types if set(names).issubset(table.columns)), types[0])
    stamp, received = _times(table)
    values = columns_of(stream, [table.numbers(name) for name in names])
    return Stream(stamp, received, values, COLUMNS[stream]), table.warnings


def _usual_position(table: CsvTable) -> tuple[str, ...]:
    """Return the columns of the position, including the height if every row has one."""
    heights = table.columns.get(_HEIGHT, ())
    return (*_POSITION, _HEIGHT) if heights and all(map(str.strip, heights)) else _POSITION


def _poses(
    table: CsvTable, mapping: PoseMapping, stream: str = "pose"
) -> tuple[Stream, tuple[str, ...]]:
    """Choose the columns of poses: those in the mapping, or the authors'."""
    # The authors' conversion added the yaw; a plain conversion contains only the quaternion.
    plain = set(_QUATERNION).issubset(table.columns) and _YAW not in table.columns
    usual = Orientation("quaternion", _QUATERNION[1:] + _QUATERNION[:1])
    position = mapping.position or _usual_position(table)
    orientation = mapping.orientation or (usual if plain else Orientation("yaw", (_YAW,)))
    if stream == "puck" and mapping.orientation is None and mapping.position:
        orientation = Orientation("none", ())  # A camera sees the puck's position, not its angle.
    names = (*position, *orientation.columns)
    _require(stream, table, names, mapping)
    table = of_body(table, mapping.body, (mapping.time, mapping.interval, *names), stream)
    table, clock = _timed(table, mapping)
    table, blank = table.without_blank(position, orientation.columns)
    time, received = _own_times(table, mapping, clock)
    values = np.stack([table.numbers(name) for name in names], axis=1)
    parts = values[:, : len(position)], values[:, len(position) :]
    made = pose_stream(time, *parts, orientation.kind, mapping, received, orientation.columns)
    check_digits(table, made)
    return made, table.warnings + left_out("poses", blank)


def _commands(table: CsvTable, mapping: CommandMapping) -> tuple[Stream, tuple[str, ...]]:
    """Choose the columns of commands: those in the mapping, or the authors' motors."""
    names = mapping.values
    if not names and set(mapping.propellers).issubset(table.columns):
        names = mapping.propellers
    if not names:
        others = [
            name
            for name in table.columns
            if name not in (_RECEIVED, mapping.time, mapping.interval)
            and not name.startswith("header.")
        ]
        names = tuple([name for name in others if name.startswith("motor")] or others)
    columns = tuple(_column(table, name)[0] for name in names)
    _require("command", table, columns, mapping)
    if not names:
        raise InputError(
            f"has no column of a motor (it has {listing(table.columns)})", file=table.path
        )
    table, clock = _timed(table, mapping)
    table, blank = table.without_blank(columns)
    time, received = _own_times(table, mapping, clock)
    if mapping.bits and len(names) == 1:
        values = table.masks(names[0])[:, None]
    else:
        values = np.column_stack([_numbers(table, name) for name in names])
        if values.shape[1] != len(names) or names != columns:
            names = unnamed_columns(values.shape[1])
    made = command_stream(time, values, names, mapping, received)
    check_digits(table, made)
    return made, table.warnings + left_out("commands", blank)


def _column(table: CsvTable, name: str) -> tuple[str, int | None]:
    """Return the column that a name means, and which entry of its lists."""
    entry = None if name in table.columns else ENTRY.fullmatch(name)
    return (entry[1], int(entry[2])) if entry else (name, None)


def _numbers(table: CsvTable, name: str) -> Float[np.ndarray, "N *k"]:
    """Return a column of numbers, all entries of its lists, or the entry in the name."""
    column, entry = _column(table, name)
    texts = table.columns[column]
    if entry is None and not (texts and is_list(texts[0])):
        return table.numbers(column)
    values = table.lists(column)
    if entry is not None and entry >= values.shape[-1]:
        raise InputError(
            f"its lists have {values.shape[-1]} entries, counted from 0",
            file=table.path,
            field=shortened(name),
        )
    return values if entry is None else values[:, entry]


def _require(
    stream: str, table: CsvTable, names: Sequence[str], mapping: PoseMapping | CommandMapping
) -> None:
    """Raise InputError for missing columns, listing all of them and the mapping to write."""
    times = tuple(name for name in (mapping.time, mapping.interval) if name)
    if not times and _RECEIVED not in table.columns:
        times = (_SECONDS, _NANOSECONDS)
    missing = [name for name in (*times, *names) if name not in table.columns]
    if missing:
        keys = _TO_WRITE.get(stream, _TO_WRITE["pose"])
        # A user who names columns does not expect the authors' stamps.
        unnamed = not (mapping.time or mapping.interval) and set(missing).issubset(
            {_SECONDS, _NANOSECONDS}
        )
        problem = "no column is named for the time" if unnamed else "there is no such column"
        raise InputError(
            f"{problem}; name columns in a file for --mapping: {stream} = "
            f"{{{keys}}} out of {listing(table.columns)}" + nearest(missing[0], table.columns),
            file=table.path,
            field="time" if unnamed else ", ".join(missing),
        )


def _timed(table: CsvTable, mapping: PoseMapping | CommandMapping) -> tuple[CsvTable, str]:
    """Replace a column of intervals by times; return the name of the column of times, too."""
    if not mapping.interval:
        return table, mapping.time
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
    return replace(table, columns={**table.columns, mapping.interval: times}), mapping.interval


def _own_times(
    table: CsvTable, mapping: PoseMapping | CommandMapping, time: str
) -> tuple[Shaped[np.ndarray, " N"], Int64[np.ndarray, " N"] | None]:
    """Return the stamps that the mapping names, and the authors' arrival times if present."""
    if time:
        exact = mapping.size("time") == 1 / SECOND_NS and not mapping.interval
        return table.times(time, exact=exact), None
    stamp, received = _times(table)
    return stamp.astype("datetime64[ns]"), received


def _times(table: CsvTable) -> tuple[Int64[np.ndarray, " N"], Int64[np.ndarray, " N"]]:
    """Return header stamps and recorder times; either replaces the other if it is missing."""
    if _RECEIVED in table.columns and _SECONDS not in table.columns:
        received = table.numbers(_RECEIVED, int)
        return received, received
    seconds, nanoseconds = table.numbers(_SECONDS, int), table.numbers(_NANOSECONDS, int)
    if len(seconds) and np.abs(seconds).max() > _LATEST_SECOND:
        raise InputError(
            "holds seconds beyond the year 2262; are they nanoseconds?",
            file=table.path,
            field=_SECONDS,
        )
    stamp = seconds * SECOND_NS + nanoseconds
    return stamp, table.numbers(_RECEIVED, int) if _RECEIVED in table.columns else stamp


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
