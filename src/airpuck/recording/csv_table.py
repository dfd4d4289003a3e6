"""CSV files as columns of text, converted to numbers on request."""

from __future__ import annotations

import os
import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import compress
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from airpuck.boundary.errors import InputError
from airpuck.boundary.kinds import nearest
from airpuck.boundary.limits import CELLS, PROPELLERS, ROW_LENGTH, csv_rows, refused
from airpuck.recording.conversion import NO_MASK, is_mask
from airpuck.recording.files import listing, shortened
from airpuck.recording.mapping import MASK_BITS

#: Separators of columns.
_SEPARATORS = ",\t;"
#: Separators of the entries of a list in a cell, and its delimiters.
_BETWEEN, _AROUND = re.compile(r"\s*[,;]\s*|\s+"), "[]() \t"
#: Switches as programs print them.
_SWITCH = {"true": 1.0, "false": 0.0}
#: Placeholders of exports for missing numbers.
_BLANK = ("", "null")


@dataclass(frozen=True)
class Rows:
    """A CSV file split into cells; empty lines are left out."""

    path: Path
    cells: list[list[str]]
    #: Line number of each row.
    lines: list[int]
    #: Whether the last line is complete. A killed recorder leaves an incomplete line.
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
        problem = "is not a number" if kind is float else "is not a whole number"
        return self._converted(name, kind, problem)

    def masks(self, name: str) -> Float[np.ndarray, " N"]:
        """Return bit masks: whole numbers, hexadecimal (``0x1f``) or binary ones (``0b11``)."""
        return self._converted(name, _mask, NO_MASK)

    def lists(self, name: str) -> Float[np.ndarray, "N k"]:
        """Return a column whose cells hold lists of one length, as in ``"[1, 0, 1]"``."""
        texts = self.columns[name]
        width = len(_entries(texts[0])) if texts else 0
        if width * len(texts) > CELLS:
            remedy = "cut it into parts"
            raise refused("contains too many numbers", CELLS, remedy, file=self.path, field=name)

        def row(text: str) -> list[float]:
            entries = _entries(text)
            if len(entries) != width or not 0 < width <= PROPELLERS:
                raise ValueError
            return [float(_SWITCH.get(entry.lower(), entry)) for entry in entries]

        length = f"{width} numbers, as in the first row"
        if not 0 < width <= PROPELLERS:
            length = f"1 to {PROPELLERS} numbers"
        return self._converted(name, row, f"is not a list of {length}")

    def _converted(self, name: str, convert: Callable[[str], Any], problem: str) -> Any:
        """Convert the cells of a column; raise InputError for the first that does not fit."""
        if name not in self.columns:
            raise InputError(
                f"there is no such column (there are {listing(self.columns)})"
                + nearest(name, self.columns),
                file=self.path,
                field=name,
            )
        texts, numbers = self.columns[name], []
        try:
            for text in texts:
                numbers.append(convert(text))
            return np.array(numbers, dtype=np.int64 if convert is int else np.float64)
        except ValueError:
            line, text = self.lines[len(numbers)], shortened(repr(texts[len(numbers)]))
            comma = "; decimals need a point" if "," in text and "[" not in text else ""
            problem = f"line {line}: {text} {problem}{comma}"
        except OverflowError:
            problem = "contains a number beyond 64 bits; times are in nanoseconds"
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


def is_list(text: str) -> bool:
    """Return whether a cell contains a list."""
    return text.lstrip().startswith(("[", "("))


def _entries(text: str) -> list[str]:
    """Split a list in a cell; a list that is too long keeps one extra entry."""
    inside = text.strip(_AROUND) if is_list(text) else ""
    return _BETWEEN.split(inside, PROPELLERS) if inside else []


def _mask(text: str) -> float:
    """Return a bit mask; some programs write whole numbers with a point."""
    based = text.strip().lower().startswith(("0x", "0b"))
    value = float(min(int(text, 0), 1 << MASK_BITS)) if based else float(text)
    if not is_mask(value):
        raise ValueError
    return value


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
    """Return whether a cell contains a number."""
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
            f"{rows.path.name} is cut short: its last line ({line}) is incomplete and left out",
        )
    for line, row in zip(lines, cells, strict=True):
        if len(row) < width or (exact and len(row) > width):
            raise InputError(
                f"line {line} has {len(row)} fields, the header has {width}", file=rows.path
            )
    found = {name: [row[index] for row in cells] for name, index in places.items()}
    return CsvTable(rows.path, found, lines, warnings)
