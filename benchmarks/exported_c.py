"""Time of one control step of the exported controller, beside Python's.

    python -m benchmarks.exported_c

Both get the same poses and commands. A step is three poses at most, the step and the report of what
was sent, all through ctypes for C. Processor time counts, so other programs do not.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

import numpy as np
from tests.apparatus.compiled_controllers import CompiledController, Table, library

import airpuck
from airpuck.control.reference import SetPoint
from airpuck.control.tracking import TrackingController
from airpuck.control.tuning import default_tuning


def spent(pilot: TrackingController | CompiledController, steps: int) -> np.ndarray:
    """Return the processor time of each step of a flight [µs]."""
    table, found = Table(pilot.model, pilot.tuning.period_s, 0), []
    pilot.reference = SetPoint(0.3, 0.1, 1.0)
    command = np.zeros(pilot.model.vehicle.n_propellers)
    targets = pilot.targets(0.0) if isinstance(pilot, CompiledController) else None
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
        found.append(time.process_time_ns() - started)
        table.fly(command)
    return np.array(found) / 1e3


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=2000)
    parser.add_argument("--model", default="paper:M4")
    options = parser.parse_args()
    model = airpuck.read_model(options.model)
    for regulator in ("lqr", "mpc"):
        tuning = default_tuning().with_regulator(regulator)
        with tempfile.TemporaryDirectory() as folder:
            shared = library(model, Path(folder), "-O3", tuning=tuning)
            python = TrackingController(model, SetPoint(0.0, 0.0, 0.0), tuning)
            c = CompiledController(shared, model, tuning)
            times = [np.median(spent(pilot, options.steps)) for pilot in (python, c)]
        ratio = times[0] / times[1]
        print(f"{regulator}: Python {times[0]:.1f} µs, C {times[1]:.1f} µs, ratio {ratio:.1f}")


if __name__ == "__main__":
    main()
