"""Exports of motion capture programs: OptiTrack's Motive (CSV) and Qualisys' QTM (6D, TSV).

Both begin with lines about the take; their columns are named in rows below. Units and axes in such
a file become the defaults of the mapping.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from airpuck.boundary.errors import InputError
from airpuck.recording.csv_table import CsvTable, Rows, table_below
from airpuck.recording.files import listing
from airpuck.recording.mapping import Orientation

_MOTIVE = "Format Version"
_QUALISYS = ("NO_OF_FRAMES", "FILE_VERSION")
_LENGTHS = {"Meters": "m", "Centimeters": "cm", "Millimeters": "mm"}
_FRAME, _TIME = "Frame", "Time"
_POSITION = ("X", "Y", "Z")
#: QTM writes a rotation matrix column by column.
_ROTATION = tuple(f"Rot[{row + 3 * column}]" for row in range(3) for column in range(3))


def is_export(path: Path) -> bool:
    """Return whether a file begins like an export."""
    with path.open("rb") as file:
        start = file.read(64).decode("utf-8-sig", errors="replace").lstrip('"')
    return start.startswith((_MOTIVE, *_QUALISYS))


def read_export(rows: Rows, body: str) -> tuple[CsvTable, dict[str, Any]] | None:
    """Return a rigid body's columns and the mapping's defaults; None for other files."""
    first = rows.cells[0][0].strip()
    if first == _MOTIVE:
        return _motive(rows, body)
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
    chosen = _choose([names[index] for index in of_bodies], body, rows.path)
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
    chosen = _choose(bodies, body, rows.path)
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


def _header(rows: Rows) -> int:
    """Find the row that names the columns, beginning with frame number and time."""
    for index, row in enumerate(rows.cells):
        if len(row) > 1 and row[0].strip() == _FRAME and row[1].strip().startswith(_TIME):
            return index
    raise InputError(
        "has no row Frame, Time, …; is it cut short, or was the export without times?",
        file=rows.path,
    )


def _choose(bodies: Sequence[str], body: str, path: Path) -> str:
    """Return the rigid body to read: the only one, or the one named in the mapping."""
    names = list(dict.fromkeys(bodies))
    if body in names:
        return body
    if len(names) == 1 and not body:
        return names[0]
    raise InputError(
        f"contains the rigid bodies {listing(names)}; choose one in the mapping, as in "
        f'pose = {{body = "{names[0]}"}}',
        file=path,
        field="pose.body" if body else None,
    )


def _check_places(places: dict[str, int], needed: Sequence[str], path: Path) -> None:
    missing = [name for name in needed if name not in places]
    if missing:
        raise InputError(
            f"has no column {', '.join(missing)} of this rigid body; export position and rotation",
            file=path,
        )
