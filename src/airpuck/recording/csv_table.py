"""CSV files as columns of text, converted to numbers on request."""

from __future__ import annotations

import contextlib
import gc
import itertools
import math
import os
import re
import warnings
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import compress
from operator import and_, ne
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from airpuck.boundary.errors import InputError, check_known, listing, shortened
from airpuck.boundary.limits import CELLS, PROPELLERS, csv_rows, refused, text_encoding
from airpuck.recording.conversion import NO_MASK, SECOND_NS, chosen_body, is_mask
from airpuck.recording.mapping import MASK_BITS

#: Separators of columns.
_SEPARATORS = ",\t;"
#: Separators of the entries of a list in a cell, and its delimiters.
_BETWEEN, _AROUND = re.compile(r"\s*[,;]\s*|\s+"), "[]() \t"
#: Switches as programs print them.
_SWITCH = {"true": 1.0, "false": 0.0}
#: Placeholders of programs for missing numbers.
_BLANK = frozenset(("", "null", "none", "nan", "-nan", "na", "n/a", "#n/a"))
#: Names of columns that name rigid bodies, and the largest number of bodies in one table.
_BODY = re.compile(
    r"(?i)(body|object|subject|segment|tracker|marker|child_?frame|\bname|\bid\b|\brb\b|label)"
)
_BODIES = 1000
#: Fraction of rows with the time of the row before from which digits must be missing: half for two
#: bodies. A client that stamps several poses of one body at once gets them at least this often [s].
_REPEATED, _LONGEST_BURST = 0.4, 0.25
#: Times of which all are multiples of this were rounded [ns].
_ROUNDED = 10_000_000
#: Begin of an ISO date.
_DATE = re.compile(r"\s*\d{4}-\d\d-\d\d")
#: Dates and times of day in other notations.
_TIME = re.compile(r"\d\s*[:/]\s*\d")
#: Characters in which the separator of columns is looked for.
_START = 2**16


@dataclass(frozen=True)
class Rows:
    """A CSV file split into cells; empty lines are left out."""

    path: Path
    cells: list[list[str]]
    #: Line number of each row.
    lines: list[int]
    #: Whether the last line is complete. A killed recorder leaves an incomplete line.
    ends: bool
    #: Whether decimals may have a comma, because it does not separate columns.
    commas: bool = False


@dataclass(frozen=True)
class CsvTable:
    """Columns of a CSV file as text."""

    path: Path
    columns: Mapping[str, Sequence[str]]
    #: Line number of each row.
    lines: list[int]
    warnings: tuple[str, ...]
    commas: bool = False

    def numbers(self, name: str, kind: type[float] | type[int] = float) -> Any:
        """Return a column as float64, or exactly as int64; NaN and infinity may be logged."""
        problem = "is not a number" if kind is float else "is not a whole number"
        return self._converted(name, kind, problem)

    def times(self, name: str, *, exact: bool) -> Any:
        """Return a column of times: numbers, exact as int64, or ISO dates as NumPy's."""
        if name in self.columns and _DATE.match("".join(self.columns[name][:1])):
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # NumPy warns of offsets, which it subtracts
                return self._converted(name, _date, "is not an ISO date")
        return self.numbers(name, int if exact else float)

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
        missing = f"there is no such column (there are {listing(self.columns)})"
        check_known(name, self.columns, missing, file=self.path, field=name)
        texts, numbers = self.columns[name], []
        if convert is float and self.commas and "," in "".join(texts):
            texts = [text.replace(",", ".") for text in texts]
        try:
            numbers += map(convert, texts)
            dates = "datetime64[ns]" if convert is _date else np.float64
            return np.array(numbers, dtype=np.int64 if convert is int else dates)
        except ValueError:
            line, text = self.lines[len(numbers)], shortened(repr(texts[len(numbers)]))
            comma = "; decimals need a point" if "," in text and "[" not in text else ""
            date = "; write seconds, or 2025-03-04T10:00:00.004" if _TIME.search(text) else ""
            problem = f"line {line}: {text} {problem}{comma or date}"
        except OverflowError:
            problem = "contains a number beyond 64 bits; times are in nanoseconds"
        raise InputError(problem, file=self.path, field=shortened(name))

    def without_blank(
        self, *groups: Sequence[str], most: Callable[[Sequence[bool]], bool] = any
    ) -> tuple[CsvTable, int]:
        """Leave out rows in which columns of a group are blank; return their number, too.

        All must be blank by default; with `all`, one is enough.
        """
        kept = [True] * len(self.lines)
        for names in filter(None, groups):
            columns = (map(str.lower, map(str.strip, self.columns[name])) for name in names)
            filled = ([text not in _BLANK for text in texts] for texts in columns)
            kept = list(map(and_, kept, map(most, zip(*filled, strict=True))))
        table = self.where(kept)
        if kept and not table.lines:
            names = ", ".join(name for group in groups for name in group)
            raise InputError(f"no row has numbers in all of {names}", file=self.path)
        return table, len(kept) - len(table.lines)

    def where(self, kept: Sequence[bool]) -> CsvTable:
        """Return some of the rows."""
        if all(kept):
            return self
        columns = {name: list(compress(texts, kept)) for name, texts in self.columns.items()}
        return replace(self, columns=columns, lines=list(compress(self.lines, kept)))


def is_list(text: str) -> bool:
    """Return whether a cell contains a list."""
    return text.lstrip().startswith(("[", "("))


def _entries(text: str) -> list[str]:
    """Split a list in a cell; a list that is too long keeps one extra entry."""
    inside = text.strip(_AROUND) if is_list(text) else ""
    return _BETWEEN.split(inside, PROPELLERS) if inside else []


def _date(text: str) -> np.datetime64:
    """Parse an ISO date; without an offset it is UTC."""
    text = text.strip().replace(",", ".").removesuffix("Z").removesuffix("UTC")
    return np.datetime64(text.rstrip(), "ns")


def _mask(text: str) -> float:
    """Return a bit mask; some programs write whole numbers with a point."""
    based = text.strip().lower().startswith(("0x", "0b"))
    value = float(min(int(text, 0), 1 << MASK_BITS)) if based else float(text)
    if not is_mask(value):
        raise ValueError
    return value


@contextlib.contextmanager
def collecting_no_garbage() -> Iterator[None]:
    """Pause the search for garbage: it takes half of the time, and cells form no cycles."""
    collecting = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if collecting:
            gc.enable()


def read_rows(path: Path) -> Rows:
    """Split a CSV file into cells of text."""
    separator = _separator(path)
    numbered = list(csv_rows(path, separator))
    if not numbered:
        raise InputError("is empty", file=path)
    with path.open("rb") as file:
        file.seek(-2 if path.stat().st_size > 1 else 0, os.SEEK_END)
        ends = file.read().rstrip(b"\0").endswith(b"\n")
    cells, lines = [row for _, row in numbered], [line for line, _ in numbered]
    return Rows(path, cells, lines, ends, separator != ",")


def _separator(path: Path) -> str:
    """Return the column separator: the most frequent candidate in the first line with any."""
    lines = beginning(path, _START).splitlines()
    told = [line for line in lines if not line.startswith("#")] or lines
    first = next((line for line in told if any(map(line.count, _SEPARATORS))), "")
    return max(_SEPARATORS, key=first.count)


def beginning(path: Path, most: int) -> str:
    """Return the first characters of a text file."""
    try:
        with path.open(encoding=text_encoding(path), errors="replace") as file:
            return file.read(most)
    except UnicodeError:
        return ""  # `csv_rows` will say so
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror})", file=path) from error


def plain_table(rows: Rows) -> CsvTable:
    """Return the column names in the first row of a file that is no comment."""
    first = 0
    while len(rows.cells) > first + 1 and rows.cells[first][0].startswith("#"):
        if _is_number(rows.cells[first + 1][0]):  # NumPy marks the header as a comment
            rows.cells[first][0] = rows.cells[first][0].removeprefix("#")
            break
        first += 1
    header = [name.strip() for name in rows.cells[first]]
    if all(not name or _is_number(name) for name in header):
        raise InputError("has no header: its first line must name the columns", file=rows.path)
    for place in [place for place, name in enumerate(header) if not name]:
        if any(row[place].strip() for row in rows.cells[first + 1 :] if len(row) > place):
            header[place] = f"column {place + 1}"  # such as the index of a data frame
    twice = [name for name, count in Counter(filter(None, header)).items() if count > 1]
    if twice:
        problem = "there are two columns of this name"
        raise InputError(problem, file=rows.path, field=shortened(twice[0]))
    places = {name: place for place, name in enumerate(header) if name}
    return table_below(rows, first, places, exact=True)


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
    if exact and rows.cells[header] in cells:  # a logger was started again
        kept = [row != rows.cells[header] for row in cells]
        cells, lines = list(compress(cells, kept)), list(compress(lines, kept))
    for line, row in zip(lines, cells, strict=True):
        if len(row) < width or (exact and any(map(str.strip, row[width:]))):
            raise InputError(
                f"line {line} has {len(row)} fields, the header has {width}", file=rows.path
            )
    columns = list(zip(*cells, strict=False)) if cells else [()] * width
    found = {name: columns[index] for name, index in places.items()}
    return CsvTable(rows.path, found, lines, warnings, rows.commas)


def of_body(table: CsvTable, body: str, known: Sequence[str], stream: str) -> CsvTable:
    """Return the rows of one rigid body, in a table with a row for each frame and body.

    The body's name is in a column that is not `known` to hold something else.
    """
    spare = sorted(table.columns.keys() - set(known), key=lambda name: not _BODY.search(name))
    named = [name for name in spare if _BODY.search(name)]
    columns = {
        name: list(map(str.strip, table.columns[name])) for name in (spare if body else named)
    }
    if body:
        texts = next((texts for texts in columns.values() if body in texts), [])
        others = itertools.chain.from_iterable(columns[name] for name in named)
        chosen_body(texts or others, body, table.path, stream)
        return table.where([text == body for text in texts])
    for texts in columns.values():
        found = list(dict.fromkeys(texts))
        changes = sum(map(ne, texts, texts[1:]))
        # Rows of several bodies alternate; other columns count, or change a few times.
        if 1 < len(found) <= min(_BODIES, len(texts) // 2) and changes > 2 * len(found):
            chosen_body(found, body, table.path, stream)
    return table


def check_digits(table: CsvTable, stream: Any) -> None:
    """Raise InputError for times that were written with too few digits, such as ``1.7e9``."""
    steps = np.diff(stream.stamp_ns)
    moved = np.abs(np.diff(stream.values, axis=0)).sum(axis=1)
    repeated = (steps == 0) & (moved != 0)
    repeats = int(repeated.sum())
    if repeats <= _REPEATED * len(steps) or not len(steps):
        return
    # Poses of one body move steadily; interleaved poses of several bodies jump back and forth.
    often = (stream.stamp_ns % _ROUNDED).any()
    often = often and np.median(steps[steps > 0]) < _LONGEST_BURST * SECOND_NS
    each = math.ceil(len(steps) / max(int((steps > 0).sum()), 1))
    again = np.abs(stream.values[each:] - stream.values[:-each]).sum(axis=1)
    if often and each > 1 and np.median(again) >= 0.5 * np.median(moved):
        return
    which = int(np.argmax(repeated))
    where = (
        f"lines {table.lines[which]} and {table.lines[which + 1]}, and {repeats - 1} other pairs"
    )
    raise InputError(
        f"{where} have the same time but different numbers: times have lost digits (write seconds "
        "with six decimals), or rows of several bodies are mixed (one column must name them)",
        file=table.path,
        field="time",
    )
