"""Time of one control step of the exported controller, beside Python's.

    python -m benchmarks.exported_c

Both get the same poses and commands. A step is three poses at most, the step and the report of what
was sent. C is called through ctypes, and again without it: the whole flight is repeated in one
call. Processor time counts, so other programs do not.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

import numpy as np

import airpuck
from airpuck.control.reference import SetPoint
from airpuck.control.tracking import TrackingController
from airpuck.control.tuning import default_tuning
from tests.apparatus.compiled_controllers import CompiledController, Table, library


def spent(pilot: TrackingController | CompiledController, steps: int) -> list[float]:
    """Return the mean processor times of a step in a flight [µs]: as called, and in one call."""
    table, events, spent_ns = Table(pilot.model, pilot.tuning.period_s, 0), [], []
    pilot.reference = SetPoint(0.3, 0.1, 1.0)
    n = pilot.model.vehicle.n_propellers
    command = np.zeros(n)
    targets = pilot.targets(0.0) if isinstance(pilot, CompiledController) else np.zeros(0)
    for _ in range(steps):
        received, now = table.poses(), table.now + table.period
        started = time.process_time_ns()
        for stamp, pose in received:
            pilot.pose(stamp, pose)
        if isinstance(pilot, CompiledController):
            pilot.run(now, targets, command)
        else:
            command = pilot.step(now).command
        pilot.sent(now, command)
        spent_ns.append(time.process_time_ns() - started)
        events += [(0, stamp, *pose, *[0] * (n - 2)) for stamp, pose in received]
        events += [(1, now, *[0] * (n + 1)), (2, now, *command, 0)]
        table.fly(command)
    # The first steps of Python compile.
    found = [float(np.mean(spent_ns[steps // 10 :])) / 1e3]
    if isinstance(pilot, CompiledController):
        flown = np.array(events, dtype=float)
        started = time.process_time_ns()
        repeated = pilot.replay(targets, flown)
        found.append((time.process_time_ns() - started) / repeated / 1e3)
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=2000)
    parser.add_argument("--model", default="paper:M4")
    options = parser.parse_args()
    model = airpuck.read_model(options.model)
    for regulator in ("lqr", "mpc"):
        tuning = default_tuning().with_law(regulator)
        with tempfile.TemporaryDirectory() as folder:
            shared = library(model, Path(folder), "-O3", tuning=tuning)
            python = TrackingController(model, SetPoint(0.0, 0.0, 0.0), tuning)
            c = CompiledController(shared, model, tuning)
            (ours,), (called, inside) = (spent(pilot, options.steps) for pilot in (python, c))
        print(f"{regulator}: Python {ours:.1f} µs, C {called:.1f} µs, ratio {ours / called:.1f}")
        print(f"     without ctypes: C {inside:.1f} µs, ratio {ours / inside:.1f}")


if __name__ == "__main__":
    main()
