"""Growth of cost with windows, horizon, parameters, recordings, propellers and craft: a figure.

    AIRPUCK_DATA=... python -m benchmarks.scaling -o docs/images/scaling.png

The upper row is one Gauss-Newton step (median). The lower row is the CPU time of `identify`
on longer and longer bags, the wall time of a second of flight of many craft at once, in closed
loop, and the CPU time of campaigns of more and more flights, each with a fit. Dashed: peak memory.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from airpuck.report.style import write_figure

from .process import AIRPUCK, Run, run, workload

#: Size, cost [s] and peak memory of the process [MiB].
Measured = tuple[float, float, float]

SPEC = """
kind = "recovery"
seeds = {count}
[base]
duration_s = 10.0
"""


@dataclass(frozen=True)
class Axis:
    """What grows, its values, and how one of them is measured."""

    label: str
    values: tuple[float, ...]
    measure: Callable[[float, int], Measured]
    #: Whether it is constant at first, so that only its upper end tells how it grows.
    wide: bool = False


def of_workload(name: str, option: str, size: str | None = None, *more: object):
    """Return the measurement of a workload, with the figure that is its size (None: the value)."""

    def measure(value: float, runs: int) -> Measured:
        done = workload(name, "--runs", runs, option, value, *more)
        found = done.figures
        return float(found[size] if size else value), found["wall_s"], done.peak_mib

    return measure


def identified(minutes: float, _: int) -> Measured:
    """Identify a bag of some minutes in a process."""
    with tempfile.TemporaryDirectory() as folder:
        bag = Path(folder) / "bag"
        workload("bag", "--seconds", 60 * minutes, "--output", bag)
        done = run((*AIRPUCK, "identify", bag, "--model", "M3", "-o", Path(folder) / "m.toml"))
    return minutes, done.cpu_s, done.peak_mib


def campaign(flights: float, _: int, run: Callable[..., Run] = run) -> Measured:
    """Fly and fit many times, in Dask's processes."""
    with tempfile.TemporaryDirectory() as folder:
        spec = Path(folder) / "spec.toml"
        spec.write_text(SPEC.format(count=int(flights)), "utf-8")
        command = (*AIRPUCK, "campaign", spec, "-o", Path(folder) / "out", "--workers", 1)
        done = run(command)
    return flights, done.cpu_s, done.peak_mib


STEPS = (
    Axis(
        "windows",
        (0.0625, 0.125, 0.25, 0.5, 1.0),
        of_workload("step", "--share", "windows"),
    ),
    Axis("steps to predict", (12, 25, 50, 100, 200), of_workload("step", "--horizon")),
    Axis(
        "free parameters",
        (1, 2, 3, 5, 7, 9),
        of_workload("step", "--degree", "parameters"),
    ),
    # For several recordings, every seventh window.
    Axis("recordings of 84 s", (1, 2, 4, 8), of_workload("step", "--copies", None, "--stride", 7)),
    Axis("propellers", (3, 4, 6, 8, 12, 16), of_workload("propellers", "--propellers")),
)
WHOLE = (
    Axis("minutes of one bag, identify", (1, 2, 5, 10, 20, 60), identified),
    Axis(
        "craft in the twin, 1 s",
        (1, 10, 100, 1000, 10_000, 100_000),
        of_workload("crowd", "--craft"),
        wide=True,
    ),
    Axis("flights of 10 s in a campaign", (1, 10, 100, 1000), campaign, wide=True),
)


def measured(axis: Axis, runs: int, first: int) -> list[Measured]:
    """Measure the first sizes."""
    found = []
    for value in axis.values[:first]:
        found.append(axis.measure(value, runs))
        size, cost, peak = found[-1]
        print(f"{axis.label:30s} {size:8g} {cost:10.3f} s {peak:7.0f} MiB", flush=True)
    return found


def exponent(sizes: np.ndarray, costs: np.ndarray) -> float:
    """Return p of the least-squares line log t = p log n + c."""
    return float(np.polyfit(np.log(sizes), np.log(costs), 1)[0])


def draw(panel: plt.Axes, axis: Axis, found: list[Measured], *, memory: bool) -> float:
    """Draw cost against size; return the exponent."""
    sizes, costs, peaks = np.array(found).T
    upper = sizes >= sizes[-1] / 100 if axis.wide else sizes > 0
    grows = exponent(sizes[upper], costs[upper])
    panel.loglog(sizes, costs, "o-")
    panel.loglog(sizes, costs[-1] * sizes / sizes[-1], ":", color="0.5", label="linear")
    panel.set(xlabel=axis.label, title=f"∝ n^{grows:.2f}")
    panel.grid(alpha=0.3)
    if memory:
        panel.set_ylim(costs[0] / 3, costs[-1] * 2)
        beside = panel.twinx()
        beside.semilogx(sizes, peaks / 1024, "s--", color="C1", markersize=3)
        beside.set_ylim(bottom=0)
        beside.set_ylabel("peak memory [GiB]", color="C1")
        beside.minorticks_off()
    panel.set_xticks(
        sizes, [f"{size / 1000:.3g}k" if size >= 10_000 else f"{size:g}" for size in sizes]
    )
    panel.minorticks_off()
    return grows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path, default=Path("out/scaling.png"))
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--first", type=int, default=9, help="number of sizes")
    options = parser.parse_args()
    figure = plt.figure(figsize=(11, 6), layout="constrained")
    rows = figure.subfigures(2, 1)
    exponents = {}
    for row, axes, costs in zip(
        rows, (STEPS, WHOLE), ("one Gauss-Newton step [s]", "time [s]"), strict=True
    ):
        panels = row.subplots(1, len(axes), sharey=axes is STEPS)
        for panel, axis in zip(panels, axes, strict=True):
            found = measured(axis, options.runs, options.first)
            exponents[axis.label] = draw(panel, axis, found, memory=axes is WHOLE)
        panels[0].set_ylabel(costs)
        panels[0].legend()
    options.output.parent.mkdir(parents=True, exist_ok=True)
    write_figure(figure, options.output)
    print(json.dumps({"exponents": exponents}))


if __name__ == "__main__":
    main()
