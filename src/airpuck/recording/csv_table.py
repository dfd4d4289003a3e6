"""CSV files as columns of text, converted to numbers on request."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import compress
from pathlib import Path
from typing import Any

import numpy as np

from airpuck.boundary.errors import InputError
from airpuck.boundary.limits import ROW_LENGTH, csv_rows
from airpuck.recording.files import listing, shortened

#: Separators of columns.
_SEPARATORS = ",\t;"
#: What exports write in place of a missing number.
_BLANK = ("", "null")


@dataclass(frozen=True)
class Rows:
    """A CSV file split into cells; empty lines are left out."""

    path: Path
    cells: list[list[str]]
    #: Line number of each row.
    lines: list[int]
    #: Whether the last line is complete: a killed recorder leaves half a line.
    ends: bool


@dataclass(frozen=True)
class CsvTable:
    """Columns of a CSV file as text."""

    path: Path
    columns: Mapping[str, Sequence[str]]
    #: Line number of each row.
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
            line, text = self.lines[len(numbers)], shortened(repr(texts[len(numbers)]))
            noun = "number" if kind is float else "whole number"
            comma = "; decimals have a point" if "," in text else ""
            problem = f"line {line}: {text} is not a {noun}{comma}"
        except OverflowError:
            problem = "holds a number beyond 64 bits; times are in nanoseconds"
        raise InputError(problem, file=self.path, field=shortened(name))

    def without_blank(self, names: Sequence[str]) -> tuple[CsvTable, int]:
        """Leave out rows in which all these columns are blank; return their number, too."""
        cells = zip(*(self.columns[name] for name in names), strict=True)
        kept = [any(text.strip().lower() not in _BLANK for text in row) for row in cells]
        if all(kept):
            return self, 0
        columns = {name: list(compress(texts, kept)) for name, texts in self.columns.items()}
        lines = list(compress(self.lines, kept))
        return replace(self, columns=columns, lines=lines), len(kept) - len(lines)


def read_rows(path: Path) -> Rows:
    """Split a CSV file into cells of text."""
    numbered = list(csv_rows(path, _separator(path)))
    if not numbered:
        raise InputError("is empty", file=path)
    with path.open("rb") as file:
        file.seek(-1, os.SEEK_END)
        ends = file.read() == b"\n"
    return Rows(path, [row for _, row in numbered], [line for line, _ in numbered], ends)


def _separator(path: Path) -> str:
    """Return the column separator: the most frequent candidate in the first line."""
    try:
        with path.open("rb") as file:
            first = file.readline(ROW_LENGTH).decode(errors="replace")
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror})", file=path) from error
    return max(_SEPARATORS, key=first.count)


def plain_table(rows: Rows) -> CsvTable:
    """Return the column names in the first row of a file."""
    header = [name.strip() for name in rows.cells[0]]
    if all(map(_is_number, header)):
        raise InputError("has no header: its first line must name the columns", file=rows.path)
    twice = [name for name, count in Counter(header).items() if count > 1]
    if twice:
        raise InputError(
            "there are two columns of this name", file=rows.path, field=shortened(twice[0]) or None
        )
    return table_below(rows, 0, {name: index for index, name in enumerate(header)}, exact=True)


def _is_number(text: str) -> bool:
    """Return whether a cell holds a number."""
    try:
        float(text)
    except ValueError:
        return False
    return True


def table_below(
    rows: Rows, header: int, places: dict[str, int], *, exact: bool = False
) -> CsvTable:
    """Return some columns, by name, of the rows below the header; `exact`: check row lengths."""
    whole = len(rows.cells[header])
    width = whole if exact else max(places.values()) + 1
    cells, lines = rows.cells[header + 1 :], rows.lines[header + 1 :]
    warnings: tuple[str, ...] = ()
    if cells and len(cells[-1]) < whole and not rows.ends:
        cells, lines, line = cells[:-1], lines[:-1], lines[-1]
        warnings = (
            f"{rows.path.name} is cut short: its last line ({line}) is not whole and left out",
        )
    for line, row in zip(lines, cells, strict=True):
        if len(row) < width or (exact and len(row) > width):
            raise InputError(
                f"line {line} has {len(row)} fields, the header has {width}", file=rows.path
            )
    found = {name: [row[index] for row in cells] for name, index in places.items()}
    return CsvTable(rows.path, found, lines, warnings)
