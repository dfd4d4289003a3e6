"""Tables of the documentation that take seconds each: write them, or check them.

    AIRPUCK_DATA=... python studies/tables.py          # write docs/tables, which the page includes
    AIRPUCK_DATA=... python studies/tables.py --check  # print numbers that no longer hold; exit 1

Processors and versions of libraries differ in the last digits. A decimal number holds within half a
per cent or one unit of its last digit, a whole number within half a per cent.
"""

from __future__ import annotations

import re
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from exported_c_cortex import tunings
from predictive_limits.flights import flown, law

import airpuck

FOLDER = Path(__file__).parents[1] / "docs" / "tables"
RUNGS = ("M0", "M1", "M2", "M3", "M4")
#: Table 2 of the paper: x, y [mm], yaw [rad].
PRINTED = (
    "16.2 15.7 0.501", "15.1 15.0 0.495", "12.9 11.4 0.391", "10.8 9.8 0.387", "10.8 9.6 0.387",
)  # fmt: skip
#: Rows, labels, scales and digits of the parameters.
PARAMETERS = (
    ("τ [ms]", "motor_time_constant", 1e3, 1),
    ("I [10⁻³ kg m²]", "inertia", 1e3, 4),
    ("α [mrad]", "angle_offset", 1e3, 1),
    ("r, x [mm]", "center_of_mass x", 1e3, 2),
    ("r, y [mm]", "center_of_mass y", 1e3, 2),
)
#: Moves with their starts and targets [m, m, rad].
MOVES = (
    ("1.8 m, 0.6 m, 3 rad", (-0.9, -0.3, 0.0), (0.9, 0.3, 3.0)),
    ("1.8 m, 3.1 rad", (-0.9, 0.0, 0.0), (0.9, 0.0, 3.1)),
    ("0.8 m across, 3.1 rad", (0.0, -0.4, 0.0), (0.0, 0.4, 3.1)),
    ("0.54 m, 1 rad", (-0.25, -0.1, 0.0), (0.25, 0.1, 1.0)),
)
PRECISIONS = {"single": ("-DAIRPUCK_SINGLE",), "double": ()}
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
    return "<br>".join(cells)


def lines(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Write a table."""
    first, *rest = (("| " + " | ".join(row) + " |").replace("|  |", "| |") for row in (head, *rows))
    return "\n".join([first, "|---" * len(head) + "|", *rest]) + "\n"


def reproduced() -> dict[str, str]:
    """Return the tables of `airpuck reproduce`: errors and parameters."""
    with tempfile.TemporaryDirectory() as folder:
        found = airpuck.reproduce(None, folder).to_json()
    published, fitted, fits = (found[key] for key in ("published", "fitted", "fits"))

    def row(title: str, cell: Callable[[str], str]) -> list[str]:
        return [title, *map(cell, RUNGS)]

    def parameter(title: str, label: str, scale: float, digits: int) -> list[str]:
        def cell(rung: str) -> str:
            known = fits[rung]["values"].get(label)
            if known is None or known["standard_error"] is None:
                return ""
            value, error = scale * known["value"], scale * known["standard_error"]
            return f"{value:.{digits}f} ± {error:.{digits}f}"

        return row(title, cell)

    table_2 = [
        row("printed in the paper", lambda m: PRINTED[RUNGS.index(m)]),
        row("published parameters, evaluated here", lambda m: errors(published[m]["rmse"])),
        row("own fits (Levenberg–Marquardt)", lambda m: errors(fitted[m]["rmse"])),
        row("own fits, median of the absolute error", lambda m: errors(fitted[m]["median_abs"])),
        row("iterations", lambda m: str(fits[m]["iterations"])),
    ]
    every_start = [
        row("published", lambda m: intervals(published[m]["every_start"])),
        row("own fits", lambda m: intervals(fitted[m]["every_start"])),
    ]
    head = ["", *RUNGS]
    return {
        "table_2.md": lines(head, table_2),
        "table_2_intervals.md": lines(head, every_start),
        "parameters.md": lines(head, [parameter(*shown) for shown in PARAMETERS]),
    }


def plans() -> dict[str, str]:
    """Return the shortest times and their bounds: published M3, no reserve."""
    craft, start = airpuck.read_model("paper:M3"), (0, 0, 0)
    goals = {
        "1 m, rest to rest": (1, 0, 0),
        "1.9 m": (1.9, 0, 0),
        "1 m, any yaw and velocity at the end": airpuck.Goal(1, 0, yaw=None, velocity=None),
    }
    found = {title: airpuck.plan(craft, start, goal) for title, goal in goals.items()}
    rows = [[t, f"{p.duration:.3f} s", f"{p.lower_bound:.3f} s"] for t, p in found.items()]
    return {"plans.md": lines(["", "plan", "lower bound"], rows)}


def settling() -> dict[str, str]:
    """Return settling times of LQR and MPC on the twin."""
    rows = []
    for title, start, target in MOVES:
        lqr, mpc = (flown(start, target, law(kind), 3.0) for kind in ("lqr", "mpc"))
        over = [f"{1e3 * flight.overshoot:.1f}" for flight in (lqr, mpc)]
        rows.append([title, f"{lqr.settling:.2f}", f"{mpc.settling:.2f}", *over])
    head = ["move", "LQR s", "predictive s", "LQR overshoot mm", "predictive overshoot mm"]
    return {"settling.md": lines(head, rows)}


def memory() -> dict[str, str]:
    """Return the memory of the controllers in C."""
    rows = []
    for title, tuning in tunings().items():
        with tempfile.TemporaryDirectory() as folder:
            model = airpuck.read_model("paper:M4")
            airpuck.export.write(model, "c", Path(folder), tuning=tuning)
            (Path(folder) / "size.c").write_text(
                '#include "airpuck.h"\n#include <stdio.h>\n'
                'int main(void) { return printf("%zu", sizeof(airpuck)) < 0; }\n'
            )
            sizes = [size_of_state(Path(folder), *options) for options in PRECISIONS.values()]
        rows.append([title, *sizes])
    return {"c_memory.md": lines(["", *(f"{p} precision [B]" for p in PRECISIONS)], rows)}


def size_of_state(folder: Path, *options: str) -> str:
    """Return the size of the controller's state as this machine's compiler lays it out."""
    subprocess.run(["cc", "-std=c99", *options, "size.c", "-o", "size"], cwd=folder, check=True)
    return subprocess.run([folder / "size"], capture_output=True, text=True, check=True).stdout


def changed(before: str, now: str) -> list[str]:
    """Return the numbers that moved by more than the tolerance."""
    if _NUMBER.sub("", before) != _NUMBER.sub("", now):
        return ["the table has other rows or columns"]
    pairs = zip(_NUMBER.findall(before), _NUMBER.findall(now), strict=True)
    return [f"{a} is now {b}" for a, b in pairs if abs(float(a) - float(b)) > tolerance(a)]


def tolerance(number: str) -> float:
    """Return the largest change with which a printed number still holds."""
    decimals = len(number.partition(".")[2])
    last_digit = 1.01 * 10.0**-decimals if decimals else 0.0
    return max(TOLERANCE * abs(float(number)), last_digit)


def main() -> None:
    """Write or check all tables."""
    found = reproduced() | plans() | settling() | memory()
    if "--check" not in sys.argv[1:]:
        FOLDER.mkdir(exist_ok=True)
        for name, text in found.items():
            (FOLDER / name).write_text(text, encoding="utf-8")
        return
    stale = 0
    for name, text in found.items():
        moved = changed((FOLDER / name).read_text(encoding="utf-8"), text)
        stale += len(moved)
        print(f"{name}: {'; '.join(moved) or 'holds'}")
    sys.exit(int(stale > 0))


if __name__ == "__main__":
    from one_line import run

    run(main)
