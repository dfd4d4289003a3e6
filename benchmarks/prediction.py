"""How well do methods predict a craft's motion? A table that anybody's method can join.

    AIRPUCK_DATA=... python -m benchmarks.prediction --json out.jsonl       # all tasks and methods
    AIRPUCK_DATA=... python -m benchmarks.prediction --tasks rest:h2 --methods arx,scipy-m3-robust

Tasks: the paper's (learn from the training experiment, predict the validation experiment), the last
40 % of each of seven flights from the first 60 %, and another day's flight of the same craft. All
recordings are as their authors prepared them. Every method predicts the pose 0.2 s after every
fourth sample. *Healthy* starts are those whose window touches no fault; a robust fit of M3 to the
test flight finds the faults, for all methods alike. Intervals (95 %) are by blocks of 3 s.

Each line of the result file is one method on one task: `task`, `method`, `parameters` (numbers
learned), `learning_s`, and for the starts `all` and `healthy`: `starts`, `rmse` and `interval_95`
of x [m], y [m], yaw [rad] and the weighted error; `ratio` compares healthy errors with those of the
first method. A line is written as soon as it is measured, and never measured again: start the same
command again to continue. Only the first method then learns anew, as the others' reference.

`--figure FILE.png` draws the file's methods: error against learned numbers and against the time
to learn. `jax-sysid` needs a Python of its own, see `predictors/recurrent.py`.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from studies.held_out import flights

from airpuck import Loss, Preparation, Trajectory, Vehicle, find_faults, identify
from airpuck.data.windows import Windows, make_windows
from airpuck.evaluation.statistical_tests import rmse_interval, rmse_ratio
from airpuck.report.reproduce import TRAINING, VALIDATION

from .predictors import Method, black_box, models, recurrent, simple, subspace

#: Methods by name. A method is a function (trajectory, vehicle) -> Predictor.
METHODS: dict[str, Method] = {
    "airpuck": models.airpuck(None),
    "airpuck-m3": models.airpuck("M3"),
    "airpuck-m3-all": models.airpuck("M3", faults="keep"),
    "airpuck-m5+drag+idle-robust": models.airpuck("M5+drag+idle", robust=True),
    "airpuck-m3+residual": models.airpuck("M3+residual"),
    "scipy-m3": models.scipy(robust=False),
    "scipy-m3-robust": models.scipy(robust=True),
    "network": black_box.accelerations,
    "jax-sysid": recurrent.jax_sysid,
    "arx": simple.arx,
    "subspace": subspace.n4sid,
    "coasting": simple.coasting,
}
#: The published models, for the paper's task alone.
PUBLISHED = {f"published-{name}": models.published(name) for name in ("M0", "M1", "M2", "M3", "M4")}
#: Flights of one craft on two days: the first is learned from.
DAYS = (("2024_03_05-16_40_37_sysid_h4_yellow", "2024_03_14-16_00_32_sysid_h4_yellow"),)
#: Samples of past and prediction, and between starts, at 240 Hz.
PAST, AHEAD, STRIDE = 40, 48, 4
#: After a fault, until motor speeds are known again: three time constants [s].
SETTLING_S = 0.08
#: Weights of x, y [1/m] and yaw [1/rad] in the weighted error, as in the published fits.
WEIGHTS = np.array([1.0, 1.0, 0.1])


@dataclass(frozen=True)
class Task:
    """What to learn from, and what to predict."""

    name: str
    vehicle: Vehicle
    train: Trajectory
    test: Trajectory


def tasks() -> Iterator[Task]:
    """Return all tasks for which there are recordings."""
    found = {name: (vehicle, trajectory) for name, vehicle, trajectory in flights(None)}
    for prefix, pairs in (("paper", ((TRAINING, VALIDATION),)), ("day", DAYS)):
        for first, then in pairs:
            if first in found and then in found:
                name = f"{prefix}:{then.split('sysid_')[1]}"
                yield Task(name, found[first][0], found[first][1], found[then][1])
    for name, (vehicle, flight) in found.items():
        name = f"rest:{name[:10]}-{name.split('sysid_')[1]}"
        yield Task(name, vehicle, flight.slice(0, 0.6), flight.slice(0.6, 1))


def healthy_starts(windows: Windows, task: Task) -> np.ndarray:
    """Mark the windows that touch no fault of the test flight."""
    robust, without = Loss(robust=True), Preparation(faults="exclude")
    fit = identify(task.test, "M3", vehicle=task.vehicle, loss=robust, preparation=without)
    first = windows.time[windows.starts]
    last = windows.time[windows.present + windows.prediction_length]
    touched = np.zeros(len(windows), dtype=bool)
    for fault in find_faults(task.test, fit.model):
        touched |= (first < fault.stop + SETTLING_S) & (last > fault.start)
    return ~touched


def with_weighted(errors: np.ndarray) -> np.ndarray:
    """Add the weighted error as a fourth channel."""
    weighted = np.sqrt(np.sum((WEIGHTS[:, None] * errors) ** 2, axis=0))
    return np.concatenate([errors, weighted[None]])


def summary(errors: np.ndarray, start: np.ndarray) -> dict[str, Any]:
    """Return root mean squares of the four channels, with their intervals."""
    low, high = rmse_interval(errors, start)
    rmse = np.sqrt(np.mean(errors**2, axis=1))
    ends = [low.tolist(), high.tolist()]
    return {"starts": errors.shape[1], "rmse": rmse.tolist(), "interval_95": ends}


def compared(task: Task, methods: dict[str, Method], done: set[str]) -> Iterator[dict[str, Any]]:
    """Let each method learn and predict; the first is what the others are compared with."""
    windows = make_windows([task.test], PAST, AHEAD, STRIDE)
    start = windows.time[windows.present]
    end = windows.state[windows.present + AHEAD, :3].T
    healthy = healthy_starts(windows, task)
    reference = None
    for name, method in methods.items():
        if name in done and reference is not None:
            continue
        began = time.perf_counter()
        predictor = method(task.train, task.vehicle)
        took = time.perf_counter() - began
        errors = with_weighted(predictor.predict(windows) - end)
        row = {"task": task.name, "method": name, "parameters": predictor.parameters}
        row |= {"learning_s": took, "all": summary(errors, start)}
        row |= {"healthy": summary(errors[:, healthy], start[healthy])}
        if reference is None:
            reference = errors[:, healthy]
        else:
            ratio, (low, high), _ = rmse_ratio(reference, errors[:, healthy], start[healthy])
            row["ratio"] = {"rmse": ratio.tolist(), "interval_95": [low.tolist(), high.tolist()]}
        if name not in done:
            yield row


def line(row: dict[str, Any]) -> str:
    """Write a row of the table."""
    x, y, yaw, both = row["healthy"]["rmse"]
    text = f"  {row['method']:28} {1e3 * x:6.2f} {1e3 * y:6.2f} mm {yaw:.4f} rad {1e3 * both:7.2f}"
    if "ratio" in row:
        (low, high), ratio = row["ratio"]["interval_95"], row["ratio"]["rmse"]
        text += f"  x{ratio[3]:6.3f} ({low[3]:.3f} to {high[3]:.3f})"
    return f"{text}   {row['parameters']:5} numbers, {row['learning_s']:.1f} s"


def chosen(names: str | None, methods: dict[str, Method]) -> dict[str, Method]:
    """Keep the named methods."""
    return {name: methods[name] for name in names.split(",")} if names else methods


def draw(rows: list[dict[str, Any]], file: Path) -> None:
    """Draw each method's weighted error over the first method's, the mean over their tasks."""
    known = {(row["task"], row["method"]): row for row in rows}
    first = rows[0]["method"]
    figure, axes = plt.subplots(1, 2, figsize=(10, 4.5), sharey=True, layout="constrained")
    shown = [name for name in METHODS if any(name == method for _, method in known)]
    for number, method in enumerate([*shown, "published-M3"]):
        own = [row for (_, name), row in known.items() if name == method]
        pairs = [(row, known[row["task"], first]) for row in own if (row["task"], first) in known]
        ratios = [row["healthy"]["rmse"][3] / ours["healthy"]["rmse"][3] for row, ours in pairs]
        error = float(np.exp(np.mean(np.log(ratios))))
        style = {"marker": "o" if method.startswith(first) else "s", "color": f"C{number % 10}"}
        label = f"{method} ({len(pairs)} tasks)" if len(pairs) > 1 else f"{method} (1 task)"
        for axis, field, least in zip(axes, ("parameters", "learning_s"), (1, 0.1), strict=True):
            at = max(float(np.median([row[field] for row, _ in pairs])), least)
            axis.loglog(at, error, **style, ls="", ms=9, mec="k", alpha=0.85, label=label)
    axes[0].set(xlabel="learned numbers (none: at 1)", ylabel=f"error / error of {first}")
    axes[1].set(xlabel="time to learn / s (at least 0.1)")
    for axis in axes:
        axis.grid(which="both", alpha=0.3)
        axis.set_yticks([1, 1.5, 2, 3, 5, 10], ["1", "1.5", "2", "3", "5", "10"], minor=False)
        axis.set_yticks([], minor=True)
    axes[1].legend(loc="center left", bbox_to_anchor=(1, 0.5), fontsize=8, frameon=False)
    figure.savefig(file, dpi=160)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--tasks", default="", help="beginnings of their names, between commas")
    parser.add_argument("--methods", help="separated by commas; the first is the reference")
    parser.add_argument(
        "--json", type=Path, help="result file; what is in it is not measured again"
    )
    parser.add_argument("--figure", type=Path, help="only draw what is in the result file")
    options = parser.parse_args()
    finished, rows = set(), []
    if options.json and options.json.exists():
        rows = [json.loads(row) for row in options.json.read_text().splitlines()]
        finished = {(row["task"], row["method"]) for row in rows}
    if options.figure:
        draw(rows, options.figure)
        return
    for task in tasks():
        published = PUBLISHED if task.name.startswith("paper") else {}
        methods = chosen(options.methods, {**METHODS, **published})
        done = {method for name, method in finished if name == task.name}
        if done >= set(methods) or not task.name.startswith(tuple(options.tasks.split(","))):
            continue
        print(task.name, flush=True)
        for row in compared(task, methods, done):
            print(line(row), flush=True)
            if options.json:
                with options.json.open("a") as file:
                    file.write(json.dumps(row) + "\n")


if __name__ == "__main__":
    main()
