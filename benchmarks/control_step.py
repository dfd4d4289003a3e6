"""Time of one control step: poses into the filter, prediction, LQR, allocation, inverse thrust.

    OPENBLAS_NUM_THREADS=1 taskset -c 0 python benchmarks/control_step.py --steps 100000

The controller flies the nominal plant through set points, so that requests are as in flight.
"""

from __future__ import annotations

import argparse
import gc
import time

import numpy as np

from airpuck.control.reference import SetPoints
from airpuck.control.tracking import TrackingController
from airpuck.control.tuning import default_tuning
from airpuck.model.rollout import step
from airpuck.model_file import read_model

POSES_PER_STEP = (2, 3, 2, 3, 2)  # 240 Hz against 100 Hz


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=20_000)
    parser.add_argument("--model", default="paper:M4")
    parser.add_argument("--solver", default="daqp", choices=("daqp", "piqp"))
    options = parser.parse_args()

    tuning = default_tuning()
    allocation = tuning.allocation.model_copy(update={"solver": options.solver})
    tuning = tuning.model_copy(update={"allocation": allocation})
    model = read_model(options.model)
    poses = [(0.0, 0.0, 0.0), (0.4, 0.2, 1.5), (-0.2, -0.3, -1.0)]
    times = np.arange(0, options.steps / 100 + 2, 2.0)
    reference = SetPoints(times, [poses[k % 3] for k in range(len(times))])
    controller = TrackingController(model, reference, tuning)
    n = model.vehicle.n_propellers
    state = np.concatenate([np.zeros(6), np.full(n, model.vehicle.command_min)])
    rng = np.random.default_rng(0)
    noise = rng.normal(size=(options.steps * 3, 3)) * [5e-5, 5e-5, 6e-4]
    in_flight = [np.full(n, model.vehicle.command_min)] * 2
    spent = {"poses": [], "step": [], "total": []}
    frame = 0
    gc.disable()  # as a real-time process does
    for k in range(options.steps):
        now = k / 100
        measured = []
        for _ in range(POSES_PER_STEP[k % 5]):
            measured.append((frame / 240, state[:3] + noise[frame]))
            frame += 1
        started = time.perf_counter_ns()
        for stamp, pose in measured:
            controller.pose(stamp, pose)
        between = time.perf_counter_ns()
        result = controller.step(now + 0.009)
        controller.sent(now + 0.009, result.command)
        ended = time.perf_counter_ns()
        spent["poses"].append(between - started)
        spent["step"].append(ended - between)
        spent["total"].append(ended - started)
        in_flight.append(result.command)
        state = step(np, model.dynamics, state, in_flight.pop(0), 0.01)
    print(f"{options.steps} steps, {options.model}, {options.solver}")
    for name, values in spent.items():
        micro = np.array(values) / 1e3
        p50, p99 = np.percentile(micro, [50, 99])
        print(f"{name:6s} p50 {p50:7.1f} µs   p99 {p99:7.1f} µs   max {micro.max():8.1f} µs")


if __name__ == "__main__":
    main()
