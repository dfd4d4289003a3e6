"""The authors' CSV files: one for each topic, columns by name.

A file is named after its topic (``/drone/control`` is in ``drone_control.csv``), a column after its
field in the message, and ``log_time_ns`` is the recorder's clock.
"""

from __future__ import annotations

import csv
import os
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Int64

from airpuck.boundary.errors import InputError
from airpuck.boundary.limits import csv_rows
from airpuck.recording.files import listing, new_folder, one_line, sha256
from airpuck.recording.message import PATHS, columns_of
from airpuck.recording.stream import COLUMNS, SECOND_NS, Recording, Stream, Topics

_RECEIVED = "log_time_ns"
_SECONDS, _NANOSECONDS = "header.stamp.sec", "header.stamp.nanosec"
_FRAME = "header.frame_id"
_YAW = "pose.orientation.yaw"
_QUATERNION = tuple(f"pose.orientation.{axis}" for axis in "wxyz")
#: int64 nanoseconds end in the year 2262.
_LATEST_SECOND = 2**63 // SECOND_NS - 1


def is_csv_folder(path: Path) -> bool:
    """Return whether a folder holds the CSV files of a recording."""
    return bool(_candidates(path, "pose") or _candidates(path, "command"))


def _candidates(folder: Path, stream: str) -> list[Path]:
    """Find the files that may hold a pose or a command, by their names."""
    pattern = {"pose": "*pose*.csv", "command": "*control*.csv"}.get(stream)
    found = folder.glob(pattern) if pattern else ()
    return sorted(file for file in found if file.is_file() and "state_ref" not in file.name)


def read_csv_folder(folder: Path, topics: Topics) -> Recording:
    """Read a folder with the authors' CSV files."""
    streams: dict[str, Stream] = {}
    hashes: dict[str, str] = {}
    warnings: list[str] = []
    for stream, topic in topics.by_stream.items():
        path = folder / _file_name(topic)
        candidates = [path] if path.is_file() else _candidates(folder, stream)
        if len(candidates) > 1:
            names = listing(file.name for file in candidates)
            raise InputError(
                f"holds several files that may be the {stream} ({names}); keep one", file=folder
            )
        if candidates:
            table = _read_table(candidates[0])
            streams[stream] = _stream(stream, table)
            hashes[table.path.name] = sha256(table.path)
            warnings += table.warnings
        elif topics.required(stream):
            raise InputError(f"has no {stream} file ({path.name} or the like)", file=folder)
    return Recording(streams, str(folder), hashes, tuple(warnings))


def _file_name(topic: str) -> str:
    """Return the name that the authors' conversion gives a topic's file."""
    return f"{topic.strip('/').replace('/', '_')}.csv"


@dataclass(frozen=True)
class _Table:
    """A CSV file as text."""

    path: Path
    columns: dict[str, Sequence[str]]
    #: Number of each row's line.
    lines: list[int]
    warnings: tuple[str, ...]

    def numbers(self, name: str, kind: type[float] | type[int] = float) -> Any:
        """Return a column as float64, or exactly as int64; NaN and infinity may be logged."""
        if name not in self.columns:
            raise InputError(
                f"there is no such column (there are {listing(self.columns)})",
                file=self.path,
                field=name,
            )
        texts, numbers = self.columns[name], []
        try:
            for text in texts:
                numbers.append(kind(text))
            return np.array(numbers, dtype=np.float64 if kind is float else np.int64)
        except ValueError:
            line, text = self.lines[len(numbers)], one_line(repr(texts[len(numbers)]))
            noun = "number" if kind is float else "whole number"
            problem = f"line {line}: {text} is not a {noun}"
        except OverflowError:
            problem = "holds a number beyond 64 bits; times are in nanoseconds"
        raise InputError(problem, file=self.path, field=one_line(name))


def _read_table(path: Path) -> _Table:
    """Split a CSV file into columns of text."""
    numbered = list(csv_rows(path))
    if not numbered:
        raise InputError("is empty", file=path)
    (_, names), *numbered = numbered
    header = [name.strip() for name in names]
    twice = [name for name, count in Counter(header).items() if count > 1]
    if twice:
        raise InputError(
            "there are two columns of this name", file=path, field=one_line(twice[0]) or None
        )
    warnings: tuple[str, ...] = ()
    # A recorder that was killed leaves half a line at the end.
    if numbered and len(numbered[-1][1]) < len(header) and not _ends_a_line(path):
        line, _ = numbered.pop()
        warnings = (f"{path.name} is cut short: its last line ({line}) is not whole and left out",)
    for line, row in numbered:
        if len(row) != len(header):
            raise InputError(
                f"line {line} has {len(row)} fields, the header has {len(header)}", file=path
            )
    columns = zip(*(row for _, row in numbered), strict=True) if numbered else ((),) * len(header)
    lines = [line for line, _ in numbered]
    return _Table(path, dict(zip(header, columns, strict=True)), lines, warnings)


def _ends_a_line(path: Path) -> bool:
    with path.open("rb") as file:
        file.seek(-1, os.SEEK_END)
        return file.read() == b"\n"


def _stream(stream: str, table: _Table) -> Stream:
    """Pick a stream's columns."""
    stamp, received = _times(table)
    names = _motors(table) if stream == "command" else _names(stream, table)
    values = columns_of(stream, [table.numbers(name) for name in names])
    return Stream(stamp, received, values, COLUMNS.get(stream, names))


def _names(stream: str, table: _Table) -> tuple[str, ...]:
    """Return the CSV columns that hold a stream, by the first message type that they fit."""
    types = list(PATHS[stream].values())
    if stream == "pose":
        # The authors' conversion added the yaw; a plain one leaves the quaternion alone.
        quaternion = set(_QUATERNION).issubset(table.columns) and _YAW not in table.columns
        return types[0] if quaternion else (*types[0][:2], _YAW)
    return next((names for names in types if set(names).issubset(table.columns)), types[0])


def _motors(table: _Table) -> tuple[str, ...]:
    """Return the command's columns: those called motor..., else all but times and frames."""
    others = [
        name for name in table.columns if name != _RECEIVED and not name.startswith("header.")
    ]
    if not others:
        raise InputError(
            f"has no column of a motor (it has {listing(table.columns)})", file=table.path
        )
    return tuple([name for name in others if name.startswith("motor")] or others)


def _times(table: _Table) -> tuple[Int64[np.ndarray, " N"], Int64[np.ndarray, " N"]]:
    """Return header stamps and recorder times; either stands in where the other is missing."""
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
        The folder to make.
    topics : Topics, optional
        Give the file names; by default those of the authors' table.

    Raises
    ------
    InputError
        If the folder exists, or a stream is not known.

    Notes
    -----
    Reads back bit-equal: numbers are written with as many digits as that takes.
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
    """Lay a stream out as the authors do."""
    n = len(stream)
    level = [0.0] * n
    table: dict[str, Sequence[object]] = {_RECEIVED: stream.received_ns.tolist()}
    # The authors' references carry no header; one whose stamps differ needs it to keep them.
    if name != "reference" or not np.array_equal(stream.stamp_ns, stream.received_ns):
        seconds, nanoseconds = np.divmod(stream.stamp_ns, SECOND_NS)
        table[_FRAME] = ["body" if name == "command" else ""] * n
        table[_NANOSECONDS] = nanoseconds.tolist()
        table[_SECONDS] = seconds.tolist()
    columns = stream.columns if name == "command" else next(iter(PATHS[name].values()))
    if name == "pose":
        yaw = stream.values[:, 2]
        w, z = np.cos(yaw / 2).tolist(), np.sin(yaw / 2).tolist()
        table |= {"pose.orientation.roll": level, "pose.orientation.pitch": level}
        table |= {_YAW: yaw.tolist(), **dict(zip(_QUATERNION, (w, level, level, z), strict=True))}
        columns = (*columns[:2], _YAW)
    # tolist gives Python floats, which csv writes so that they read back bit-equal.
    table.update(zip(columns, stream.values.T.tolist(), strict=True))
    if name == "pose":
        table["pose.position.z"] = level
    return table
