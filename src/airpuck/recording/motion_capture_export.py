"""Exports of motion capture programs: Motive (CSV), Qualisys' QTM (6D, TSV), Vicon (CSV).

All begin with lines about the take; their columns are named in rows below. Units and axes in such
a file become the defaults of the mapping.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from airpuck.boundary.errors import InputError
from airpuck.recording.conversion import chosen_body
from airpuck.recording.csv_table import CsvTable, Rows, beginning, table_below
from airpuck.recording.mapping import AXES, Orientation

_MOTIVE = "Format Version"
_QUALISYS = ("NO_OF_FRAMES", "FILE_VERSION")
#: Title of the part of a Vicon export that has rigid bodies.
VICON = ("Objects", "Segments")
_SUBFRAME = "Sub Frame"
#: Columns of a Vicon body: a rotation vector, or a quaternion, and the position.
_VICON_ROTATIONS = {"quaternion": ("RX", "RY", "RZ", "RW"), "vector": ("RX", "RY", "RZ")}
_VICON_POSITION = ("TX", "TY", "TZ")
_VICON_UNITS = ("m", "cm", "mm")
_LENGTHS = {"Meters": "m", "Centimeters": "cm", "Millimeters": "mm"}
_FRAME, _TIME = "Frame", "Time"
_POSITION = ("X", "Y", "Z")
#: QTM writes a rotation matrix column by column.
_ROTATION = tuple(f"Rot[{row + 3 * column}]" for row in range(3) for column in range(3))


def is_export(path: Path) -> bool:
    """Return whether a file begins like an export."""
    start = beginning(path, 64).lstrip('"')
    first = start.partition("\n")[0].strip(' "\r,;\t')
    return start.startswith((_MOTIVE, *_QUALISYS)) or first in VICON


class _Layout(NamedTuple):
    """Where an export has its columns."""

    #: The last row above the numbers.
    header: int
    #: Rigid body of each column, empty if it has none, and the column's name for that body.
    bodies: Sequence[str]
    names: Sequence[str]
    #: Defaults of the mapping.
    usual: dict[str, Any]


def read_export(rows: Rows, body: str) -> tuple[CsvTable, dict[str, Any]] | None:
    """Return a rigid body's columns and the mapping's defaults; None for other files."""
    programs = {_MOTIVE: _motive, **dict.fromkeys(_QUALISYS, _qualisys)}
    first, *others = map(str.strip, rows.cells[0])
    is_vicon = first in VICON and not any(others)
    layout_of = _vicon if is_vicon else programs.get(first)
    if layout_of is None:
        return None
    layout = layout_of(rows)
    chosen = chosen_body(filter(None, layout.bodies), body, rows.path)
    named = enumerate(zip(layout.names, layout.bodies, strict=False))
    places = {name: place for place, (name, of) in named if of == chosen}
    needed = (*layout.usual["position"], *layout.usual["orientation"].columns)
    missing = [name for name in needed if name not in places]
    if missing:
        raise InputError(
            f"has no column {', '.join(missing)} of this rigid body; export position and rotation",
            file=rows.path,
        )
    if is_vicon:
        if layout.usual["units"][0] not in _VICON_UNITS:
            raise InputError("is a Vicon export without the units of its columns", file=rows.path)
        table = _of_frames(rows, layout.header, places)
    else:
        table = table_below(rows, layout.header, {**places, _TIME: 1})
    return table, {"time": _TIME, **layout.usual}


def _motive(rows: Rows) -> _Layout:
    """Describe a Motive export: rows of types, names, kinds (Rotation, Position) and axes."""
    cells = rows.cells
    about = dict(zip(cells[0][::2], cells[0][1::2], strict=False))
    header = _header(rows)
    above = cells[1:header]
    types = next((index for index, row in enumerate(above) if "Rigid Body" in row), None)
    if types is None or len(above) < types + 3:
        raise InputError("contains no rigid body; export rigid bodies, too", file=rows.path)
    columns = list(zip(above[types], above[types + 1], above[-1], cells[header], strict=False))
    bodies = [name if kind.strip() == "Rigid Body" else "" for kind, name, *_ in columns]
    names = [f"{part} {axis}".strip() for *_, part, axis in columns]
    order = about.get("Rotation Type", "").strip()
    if "Rotation W" in names:
        orientation = Orientation("quaternion", tuple(f"Rotation {axis}" for axis in "XYZW"))
    elif sorted(order) == ["X", "Y", "Z"]:
        # Motive's angles are about moving axes, like SciPy's capital letters.
        orientation = Orientation(order, tuple(f"Rotation {axis}" for axis in order))
    else:
        raise InputError("has no rotation type; export quaternions", file=rows.path)
    unit = about.get("Length Units", "").strip()
    if unit not in _LENGTHS:
        problem = f"is {unit or 'missing'}, not one of {', '.join(_LENGTHS)}"
        raise InputError(problem, file=rows.path, field="Length Units")
    usual = {
        "position": tuple(f"Position {axis}" for axis in _POSITION),
        "orientation": orientation,
        "units": (_LENGTHS[unit], "deg"),
        "axes": AXES["Y-up"],
    }
    return _Layout(header, bodies, names, usual)


def _qualisys(rows: Rows) -> _Layout:
    """Describe a 6D export of QTM: sixteen columns for each body, in mm and degrees."""
    header = _header(rows)
    named = [name.strip() for name in rows.cells[header]]
    bodies = _filled(name.removesuffix(" X") if name.endswith(" X") else "" for name in named)
    if not any(bodies):
        raise InputError("contains no rigid body; export 6D data", file=rows.path)
    usual = {
        "position": _POSITION,
        "orientation": Orientation("matrix", _ROTATION),
        "units": ("mm", "deg"),
    }
    return _Layout(header, bodies, ["X" if n.endswith(" X") else n for n in named], usual)


def _vicon(rows: Rows) -> _Layout:
    """Describe a Vicon export: a title, the rate, rows of bodies, names and units, then frames."""
    header = _header(rows, _SUBFRAME)
    names = [name.strip() for name in rows.cells[header]]
    below = rows.cells[header + 1] if header + 1 < len(rows.cells) else ()
    units = dict(zip(names, map(str.strip, below), strict=False))
    # "Global Angle puck:puck" is the object and its root segment.
    titles = _filled(map(str.strip, rows.cells[header - 1][2:]))
    bodies = ["", "", *(title.rpartition(" ")[2].rpartition(":")[2] for title in titles)]
    kind = "quaternion" if "RW" in names else "vector"
    usual = {
        "position": _VICON_POSITION,
        "orientation": Orientation(kind, _VICON_ROTATIONS[kind]),
        "units": (units.get("TX", ""), "deg" if units.get("RX") == "deg" else "rad"),
    }
    return _Layout(header + 1, bodies, names, usual)


def _of_frames(rows: Rows, header: int, places: dict[str, int]) -> CsvTable:
    """Return columns of a Vicon export, and the times that follow from its rate.

    Other parts, such as trajectories of markers, may follow after an empty line.
    """
    try:
        rate = float(rows.cells[1][0])
    except ValueError:
        rate = 0.0
    if header < 4 or not 0 < rate < math.inf:
        raise InputError("is a Vicon export without its rate in line 2", file=rows.path)
    numbered = (row[0].strip().isdigit() for row in rows.cells[header + 1 :])
    end = header + 1 + sum(itertools.takewhile(bool, numbered))
    ends = rows.ends or end < len(rows.cells)
    kept = replace(rows, cells=rows.cells[:end], lines=rows.lines[:end], ends=ends)
    table = table_below(kept, header, {_FRAME: 0, _SUBFRAME: 1} | places)
    frames = table.numbers(_FRAME, int)
    columns = {**table.columns, _TIME: list(map(repr, ((frames - 1) / rate).tolist()))}
    return replace(table, columns=columns)


def _filled(titles: Iterable[str]) -> list[str]:
    """Copy each title to the untitled columns that follow it."""
    return list(itertools.accumulate(titles, lambda before, title: title or before))


def _header(rows: Rows, second: str = _TIME) -> int:
    """Find the row that names the columns, beginning with frame number and time."""
    for index, row in enumerate(rows.cells):
        if len(row) > 1 and row[0].strip() == _FRAME and row[1].strip().startswith(second):
            return index
    raise InputError(
        f"has no row Frame, {second}, …; is it cut short, or was the export without times?",
        file=rows.path,
    )
