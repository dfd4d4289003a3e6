"""Exports of motion capture programs: Motive (CSV), Qualisys' QTM (6D, TSV), Vicon (CSV).

All begin with lines about the take; their columns are named in rows below. Units and axes in such
a file become the defaults of the mapping.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from airpuck.boundary.errors import InputError
from airpuck.recording.csv_table import CsvTable, Rows, beginning, table_below
from airpuck.recording.files import chosen_body
from airpuck.recording.mapping import Orientation

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


def read_export(rows: Rows, body: str) -> tuple[CsvTable, dict[str, Any]] | None:
    """Return a rigid body's columns and the mapping's defaults; None for other files."""
    first = rows.cells[0][0].strip()
    if first == _MOTIVE:
        return _motive(rows, body)
    if first in VICON and not any(map(str.strip, rows.cells[0][1:])):
        return _vicon(rows, body)
    return _qualisys(rows, body) if first in _QUALISYS else None


def _motive(rows: Rows, body: str) -> tuple[CsvTable, dict[str, Any]]:
    """Read a Motive export: rows of types, names, kinds (Rotation, Position) and axes."""
    cells = rows.cells
    about = dict(zip(cells[0][::2], cells[0][1::2], strict=False))
    header = _header(rows)
    above = cells[1:header]
    types = next((index for index, row in enumerate(above) if "Rigid Body" in row), None)
    if types is None or len(above) < types + 3:
        raise InputError("contains no rigid body; export rigid bodies, too", file=rows.path)
    names, kinds, axes = above[types + 1], above[-1], cells[header]
    width = min(len(above[types]), len(names), len(kinds), len(axes))
    of_bodies = [index for index in range(width) if above[types][index].strip() == "Rigid Body"]
    chosen = chosen_body([names[index] for index in of_bodies], body, rows.path)
    places = {
        f"{kinds[index]} {axes[index]}".strip(): index
        for index in of_bodies
        if names[index] == chosen
    }
    order = about.get("Rotation Type", "").strip()
    if "Rotation W" in places:
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
    position = tuple(f"Position {axis}" for axis in _POSITION)
    _check_places(places, (*position, *orientation.columns), rows.path)
    table = table_below(rows, header, {**places, _TIME: 1})
    return table, {
        "time": _TIME,
        "position": position,
        "orientation": orientation,
        "units": (_LENGTHS[unit], "deg"),
        "axes": ("x", "-z", "y"),
    }


def _qualisys(rows: Rows, body: str) -> tuple[CsvTable, dict[str, Any]]:
    """Read a 6D export of QTM: sixteen columns for each body, in mm and degrees."""
    header = _header(rows)
    named = [name.strip() for name in rows.cells[header]]
    bodies = [name.removesuffix(" X") for name in named if name.endswith(" X")]
    if not bodies:
        raise InputError("contains no rigid body; export 6D data", file=rows.path)
    chosen = chosen_body(bodies, body, rows.path)
    start = named.index(f"{chosen} X")
    stop = next((k for k in range(start + 1, len(named)) if named[k].endswith(" X")), len(named))
    places = {"X": start} | {named[index]: index for index in range(start + 1, stop)}
    _check_places(places, (*_POSITION, *_ROTATION), rows.path)
    table = table_below(rows, header, {**places, _TIME: 1})
    return table, {
        "time": _TIME,
        "position": _POSITION,
        "orientation": Orientation("matrix", _ROTATION),
        "units": ("mm", "deg"),
    }


def _vicon(rows: Rows, body: str) -> tuple[CsvTable, dict[str, Any]]:
    """Read a Vicon export: a title, the rate, rows of bodies, names and units, then frames.

    Other parts, such as trajectories of markers, may follow after an empty line.
    """
    header = _header(rows, _SUBFRAME)
    try:
        rate = float(rows.cells[1][0])
    except ValueError:
        rate = 0.0
    if header < 3 or not 0 < rate < math.inf:
        raise InputError("is a Vicon export without its rate in line 2", file=rows.path)
    names = [name.strip() for name in rows.cells[header]]
    titles = list(rows.cells[header - 1])
    for place in range(1, len(titles)):  # a title stands above the first of its columns
        titles[place] = titles[place].strip() or titles[place - 1]
    # "Global Angle puck:puck" is the object and its root segment.
    bodies = [title.rpartition(" ")[2].rpartition(":")[2] for title in titles]
    chosen = chosen_body(filter(None, bodies[2:]), body, rows.path)
    places = {
        name: place
        for place, (name, of) in enumerate(zip(names, bodies, strict=False))
        if of == chosen
    }
    kind = "quaternion" if "RW" in places else "vector"
    rotation = _VICON_ROTATIONS[kind]
    _check_places(places, (*_VICON_POSITION, *rotation), rows.path)
    below = dict(enumerate(rows.cells[header + 1] if header + 1 < len(rows.cells) else ()))
    length, angle = (below.get(places[name], "").strip() for name in ("TX", "RX"))
    if length not in _VICON_UNITS:
        raise InputError("is a Vicon export without the units of its columns", file=rows.path)
    counted = {_FRAME: 0, _SUBFRAME: 1} | places
    end = next(
        (k for k in range(header + 2, len(rows.cells)) if not rows.cells[k][0].strip().isdigit()),
        len(rows.cells),
    )
    kept = replace(
        rows,
        cells=rows.cells[:end],
        lines=rows.lines[:end],
        ends=rows.ends or end < len(rows.cells),
    )
    table = table_below(kept, header + 1, counted)
    frames = table.numbers(_FRAME, int)
    columns = {**table.columns, _TIME: list(map(repr, ((frames - 1) / rate).tolist()))}
    return replace(table, columns=columns), {
        "time": _TIME,
        "position": _VICON_POSITION,
        "orientation": Orientation(kind, rotation),
        "units": (length, "deg" if angle == "deg" else "rad"),
    }


def _header(rows: Rows, second: str = _TIME) -> int:
    """Find the row that names the columns, beginning with frame number and time."""
    for index, row in enumerate(rows.cells):
        if len(row) > 1 and row[0].strip() == _FRAME and row[1].strip().startswith(second):
            return index
    raise InputError(
        f"has no row Frame, {second}, …; is it cut short, or was the export without times?",
        file=rows.path,
    )


def _check_places(places: dict[str, int], needed: Sequence[str], path: Path) -> None:
    missing = [name for name in needed if name not in places]
    if missing:
        raise InputError(
            f"has no column {', '.join(missing)} of this rigid body; export position and rotation",
            file=path,
        )
