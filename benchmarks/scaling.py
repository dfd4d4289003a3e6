"""Growth of cost with windows, horizon, parameters and recordings: a figure, and exponents.

AIRPUCK_DATA=... python -m benchmarks.scaling -o docs/images/scaling.png
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from airpuck.report.style import write_png

from .process import workload

#: Swept quantity: option of the workload, its values, figure with the size (None: the value).
AXES = {
    "windows": ("--share", (0.0625, 0.125, 0.25, 0.5, 1.0), "windows"),
    "horizon": ("--horizon", (12, 25, 50, 100, 200), None),
    "parameters": ("--degree", (1, 2, 3, 5, 7, 9), "parameters"),
    "recordings": ("--copies", (1, 2, 4, 8), None),
}
LABELS = {
    "windows": "windows",
    "horizon": "steps to predict",
    "parameters": "free parameters",
    "recordings": "recordings of 84 s",
}


def measured(axis: str, runs: int) -> tuple[list[float], list[float], list[float]]:
    """Return sizes, times of a Gauss-Newton step [s], and peak memory of the process [MiB]."""
    option, values, figure = AXES[axis]
    # For several recordings, use every seventh window.
    stride = 7 if axis == "recordings" else 1
    sizes, times, peaks = [], [], []
    for value in values:
        done = workload("step", "--stride", stride, "--runs", runs, option, value)
        sizes.append(float(done.figures[figure] if figure else value))
        times.append(done.figures["wall_s"])
        peaks.append(done.peak_mib)
        print(
            f"{axis:10s} {sizes[-1]:8g} {1e3 * times[-1]:9.1f} ms {peaks[-1]:7.0f} MiB", flush=True
        )
    return sizes, times, peaks


def exponent(sizes: list[float], times: list[float]) -> float:
    """Return p of the least-squares line log t = p log n + c."""
    return float(np.polyfit(np.log(sizes), np.log(times), 1)[0])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path, default=Path("out/scaling.png"))
    parser.add_argument("--runs", type=int, default=5)
    options = parser.parse_args()
    found = {axis: measured(axis, options.runs) for axis in AXES}
    exponents = {axis: exponent(sizes, times) for axis, (sizes, times, _) in found.items()}
    figure, panels = plt.subplots(1, 4, figsize=(11, 3), sharey=True, layout="constrained")
    for panel, (axis, (sizes, times, _)) in zip(panels, found.items(), strict=True):
        panel.loglog(sizes, times, "o-")
        line = times[-1] * np.array(sizes) / sizes[-1]
        panel.loglog(sizes, line, ":", color="0.5", label="linear")
        panel.set(xlabel=LABELS[axis], title=f"∝ n^{exponents[axis]:.2f}")
        panel.set_xticks(sizes, [f"{size:g}" for size in sizes])
        panel.minorticks_off()
        panel.grid(alpha=0.3)
    panels[0].set_ylabel("one Gauss-Newton step [s]")
    panels[0].legend()
    options.output.parent.mkdir(parents=True, exist_ok=True)
    write_png(figure, options.output)
    print(json.dumps({"exponents": exponents}))


if __name__ == "__main__":
    main()
