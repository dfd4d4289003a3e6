"""Tables of docs/results.md that take less than a minute: write them, or check them.

    AIRPUCK_DATA=... python studies/tables.py          # write docs/tables, which the page includes
    AIRPUCK_DATA=... python studies/tables.py --check  # print numbers that no longer hold; exit 1

Processors and versions of libraries differ in the last digits, so a check allows half of one per
cent.
"""

from __future__ import annotations

import re
import sys
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import airpuck

FOLDER = Path(__file__).parents[1] / "docs" / "tables"
RUNGS = ("M0", "M1", "M2", "M3", "M4")
#: Table 2 of the paper: x, y [mm], yaw [rad].
PRINTED = (
    "16.2 15.7 0.501", "15.1 15.0 0.495", "12.9 11.4 0.391", "10.8 9.8 0.387", "10.8 9.6 0.387",
)  # fmt: skip
#: Largest relative change of a number that still holds.
TOLERANCE = 5e-3
_NUMBER = re.compile(r"\d+\.?\d*")


def errors(found: Mapping[str, float]) -> str:
    """Write errors of x, y and yaw."""
    return f"{1e3 * found['x_m']:.2f} {1e3 * found['y_m']:.2f} {found['yaw_rad']:.4f}"


def intervals(found: Mapping[str, Any]) -> str:
    """Write errors from every start with their intervals."""
    scales = {"x_m": (1e3, 1), "y_m": (1e3, 1), "yaw_rad": (1, 3)}
    cells = []
    for name, (scale, digits) in scales.items():
        numbers = (found["rmse"][name], *found["interval_95"][name])
        value, low, high = (f"{scale * number:.{digits}f}" for number in numbers)
        cells.append(f"{value} ({low} to {high})")
    return " ".join(cells)


def tables(reproduced: Mapping[str, Any]) -> dict[str, str]:
    """Return the tables by their file names."""
    published, fitted, fits = (reproduced[key] for key in ("published", "fitted", "fits"))

    def row(title: str, cell: Callable[[str], str]) -> str:
        return f"| {title} | " + " | ".join(map(cell, RUNGS)) + " |"

    head = ["| | " + " | ".join(RUNGS) + " |", "|---" * (len(RUNGS) + 1) + "|"]
    table_2 = [
        *head,
        row("printed in the paper", lambda m: PRINTED[RUNGS.index(m)]),
        row("published parameters, evaluated here", lambda m: errors(published[m]["rmse"])),
        row("own fits (Levenberg–Marquardt)", lambda m: errors(fitted[m]["rmse"])),
        row("own fits, median of the absolute error", lambda m: errors(fitted[m]["median_abs"])),
        row("iterations", lambda m: str(fits[m]["iterations"])),
    ]
    every_start = [
        *head,
        row("published", lambda m: intervals(published[m]["every_start"])),
        row("own fits", lambda m: intervals(fitted[m]["every_start"])),
    ]
    texts = {"table_2.md": table_2, "table_2_intervals.md": every_start}
    return {name: "\n".join(lines) + "\n" for name, lines in texts.items()}


def changed(before: str, now: str) -> list[str]:
    """Return the cells whose numbers moved by more than the tolerance."""
    if _NUMBER.sub("", before) != _NUMBER.sub("", now):
        return ["the table has other rows or columns"]
    pairs = zip(_NUMBER.findall(before), _NUMBER.findall(now), strict=True)
    moved = lambda a, b: abs(float(a) - float(b)) > TOLERANCE * abs(float(a))  # noqa: E731
    return [f"{a} is now {b}" for a, b in pairs if moved(a, b)]


def main() -> int:
    """Write or check all tables."""
    with tempfile.TemporaryDirectory() as folder:
        found = tables(airpuck.reproduce(None, folder).to_json())
    if "--check" not in sys.argv[1:]:
        FOLDER.mkdir(exist_ok=True)
        for name, text in found.items():
            (FOLDER / name).write_text(text, encoding="utf-8")
        return 0
    stale = 0
    for name, text in found.items():
        moved = changed((FOLDER / name).read_text(encoding="utf-8"), text)
        stale += len(moved)
        print(f"{name}: {'; '.join(moved) or 'holds'}")
    return int(stale > 0)


if __name__ == "__main__":
    sys.exit(main())
