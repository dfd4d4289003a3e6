"""The authors' CSV files: one for each topic, columns by name.

A file is named after its topic (``/drone/control`` is in ``drone_control.csv``), a column after its
field in the message, and ``log_time_ns`` is the recorder's clock.
"""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int64

from airpuck.boundary.errors import InputError
from airpuck.recording.files import listing, new_folder, one_line, sha256
from airpuck.recording.message import PATHS, columns_of
from airpuck.recording.stream import COLUMNS, Recording, Stream, Topics

_SECOND = 10**9
_RECEIVED = "log_time_ns"
_SECONDS, _NANOSECONDS = "header.stamp.sec", "header.stamp.nanosec"
_FRAME = "header.frame_id"
_YAW = "pose.orientation.yaw"
_QUATERNION = tuple(f"pose.orientation.{axis}" for axis in "wxyz")
#: int64 nanoseconds end in the year 2262.
_LATEST_SECOND = 2**63 // _SECOND - 1


def is_csv_folder(path: Path) -> bool:
    """Say whether a folder holds the CSV files of a recording."""
    return bool(_poses(path) or _commands(path))


def _poses(folder: Path) -> list[Path]:
    return sorted(file for file in folder.glob("*pose*.csv") if file.is_file())


def _commands(folder: Path) -> list[Path]:
    found = (file for file in folder.glob("*control*.csv") if "state_ref" not in file.name)
    return sorted(file for file in found if file.is_file())


def read_csv_folder(folder: Path, topics: Topics) -> Recording:
    """Read a folder with the authors' CSV files."""
    streams: dict[str, Stream] = {}
    hashes: dict[str, str] = {}
    warnings: list[str] = []
    found = {"pose": _poses(folder), "command": _commands(folder)}
    for stream, topic in topics.by_stream.items():
        path = folder / _file_name(topic)
        if not path.is_file():
            candidates = found.get(stream, [])
            if len(candidates) > 1:
                names = listing(file.name for file in candidates)
                raise InputError(
                    f"holds several files that may be the {stream} ({names}); keep one", file=folder
                )
            if candidates:
                path = candidates[0]
            elif topics.required(stream):
                raise InputError(
                    f"has no {stream} file ({_file_name(topic)} or the like)", file=folder
                )
            else:
                continue
        table = _read_table(path)
        streams[stream] = _stream(stream, table)
        hashes[path.name] = sha256(path)
        warnings += table.warnings
    return Recording(streams, str(folder), hashes, tuple(warnings))


def _file_name(topic: str) -> str:
    """Return the name that the authors' conversion gives a topic's file."""
    return f"{topic.strip('/').replace('/', '_')}.csv"


@dataclass(frozen=True)
class _Table:
    """A CSV file as text."""

    path: Path
    columns: Mapping[str, tuple[str, ...]]
    lines: Sequence[int]
    warnings: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.lines)

    def floats(self, name: str) -> Float[np.ndarray, " N"]:
        """Return a column of numbers; NaN and infinity are numbers that were logged."""
        texts = self._texts(name)
        try:
            return np.array(list(map(float, texts)), dtype=np.float64)
        except ValueError:
            raise self._not_a(float, "number", name, texts) from None

    def integers(self, name: str) -> Int64[np.ndarray, " N"]:
        """Return a column of whole numbers, exactly."""
        texts = self._texts(name)
        try:
            return np.array(list(map(int, texts)), dtype=np.int64)
        except ValueError:
            raise self._not_a(int, "whole number", name, texts) from None
        except OverflowError:
            raise InputError(
                "holds a number beyond 64 bits; times are in nanoseconds",
                file=self.path,
                field=name,
            ) from None

    def _texts(self, name: str) -> tuple[str, ...]:
        if name in self.columns:
            return self.columns[name]
        raise InputError(
            f"there is no such column (there are {listing(self.columns)})",
            file=self.path,
            field=name,
        )

    def _not_a(self, kind: type, noun: str, name: str, texts: Sequence[str]) -> InputError:
        for line, text in zip(self.lines, texts, strict=True):
            try:
                kind(text)
            except ValueError:
                return InputError(
                    f"line {line}: {one_line(repr(text))} is not a {noun}",
                    file=self.path,
                    field=one_line(name),
                )
        raise AssertionError("every text is a number after all")


def _read_table(path: Path) -> _Table:
    """Split a CSV file into columns of text."""
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"is not a text file ({error.reason})", file=path) from error
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror})", file=path) from error
    reader = csv.reader(io.StringIO(text))
    header: list[str] = []
    rows: list[list[str]] = []
    lines: list[int] = []
    try:
        for row in reader:
            if not row:
                continue
            if header:
                rows.append(row)
                lines.append(reader.line_num)
            else:
                header = [name.strip() for name in row]
    except csv.Error as error:
        raise InputError(f"line {reader.line_num}: {error}", file=path) from error
    if not header:
        raise InputError("is empty", file=path)
    twice = [name for name in header if header.count(name) > 1]
    if twice:
        raise InputError(
            "there are two columns of this name", file=path, field=one_line(twice[0]) or None
        )
    warnings: tuple[str, ...] = ()
    # A recorder that was killed leaves half a line at the end.
    if rows and len(rows[-1]) < len(header) and not text.endswith("\n"):
        rows.pop()
        line = lines.pop()
        warnings = (f"{path.name} is cut short: its last line ({line}) is not whole and left out",)
    for row, line in zip(rows, lines, strict=True):
        if len(row) != len(header):
            raise InputError(
                f"line {line} has {len(row)} fields, the header has {len(header)}", file=path
            )
    columns = zip(*rows, strict=True) if rows else ((),) * len(header)
    return _Table(path, dict(zip(header, columns, strict=True)), lines, warnings)


def _stream(stream: str, table: _Table) -> Stream:
    """Pick a stream's columns."""
    stamp, received = _times(table)
    if stream == "command":
        columns = _motors(table)
        names = columns
    else:
        columns, names = COLUMNS[stream], _names(stream, table)
    values = [table.floats(name) for name in names]
    return Stream(stamp, received, columns_of(stream, values), columns)


def _names(stream: str, table: _Table) -> tuple[str, ...]:
    """Return the CSV columns that hold a stream, by the first message type that they fit."""
    types = list(PATHS[stream].values())
    if stream == "pose":
        x, y, *_ = types[0]
        # The authors' conversion added the yaw; a plain one leaves the quaternion alone.
        quaternion = set(_QUATERNION).issubset(table.columns) and _YAW not in table.columns
        types = [types[0]] if quaternion else [(x, y, _YAW)]
    return next((names for names in types if set(names).issubset(table.columns)), types[0])


def _motors(table: _Table) -> tuple[str, ...]:
    """Return the command's columns: those called motor..., else all that are no times or frames."""
    motors = [name for name in table.columns if name.startswith("motor")]
    others = [
        name for name in table.columns if name != _RECEIVED and not name.startswith("header.")
    ]
    if not others:
        raise InputError(
            f"has no column of a motor (it has {listing(table.columns)})", file=table.path
        )
    return tuple(motors or others)


def _times(table: _Table) -> tuple[Int64[np.ndarray, " N"], Int64[np.ndarray, " N"]]:
    """Return header stamps and recorder times; either stands in where the other is missing."""
    if _RECEIVED in table.columns and _SECONDS not in table.columns:
        received = table.integers(_RECEIVED)
        return received, received
    seconds, nanoseconds = table.integers(_SECONDS), table.integers(_NANOSECONDS)
    if len(seconds) and np.abs(seconds).max() > _LATEST_SECOND:
        raise InputError(
            "holds seconds beyond the year 2262; are they nanoseconds?",
            file=table.path,
            field=_SECONDS,
        )
    stamp = seconds * _SECOND + nanoseconds
    return stamp, table.integers(_RECEIVED) if _RECEIVED in table.columns else stamp


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
    table: dict[str, Sequence[object]] = {_RECEIVED: stream.received_ns.tolist()}
    # The authors' references carry no header; one whose stamps differ needs it to keep them.
    if name != "reference" or not np.array_equal(stream.stamp_ns, stream.received_ns):
        seconds, nanoseconds = np.divmod(stream.stamp_ns, _SECOND)
        table[_FRAME] = ["body" if name == "command" else ""] * n
        table[_NANOSECONDS] = nanoseconds.tolist()
        table[_SECONDS] = seconds.tolist()
    if name == "command":
        columns = stream.columns
    elif name == "pose":
        x, y, *_ = next(iter(PATHS["pose"].values()))
        columns = (x, y, _YAW)
        table.update(_orientation(stream.values[:, 2]))
    else:
        columns = next(iter(PATHS[name].values()))
    # tolist gives Python floats, which csv writes so that they read back bit-equal.
    table.update(zip(columns, stream.values.T.tolist(), strict=True))
    if name == "pose":
        table["pose.position.z"] = [0.0] * n
    return table


def _orientation(yaw: Float[np.ndarray, " N"]) -> dict[str, Sequence[object]]:
    """Return the columns of a level craft's orientation."""
    level = [0.0] * len(yaw)
    w, z = np.cos(yaw / 2).tolist(), np.sin(yaw / 2).tolist()
    angles = {"pose.orientation.roll": level, "pose.orientation.pitch": level, _YAW: yaw.tolist()}
    return {**angles, **dict(zip(_QUATERNION, (w, level, level, z), strict=True))}
