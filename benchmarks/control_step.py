"""Time of one control step: poses into the filter, prediction, law.

    OPENBLAS_NUM_THREADS=1 taskset -c 0 python benchmarks/control_step.py --steps 100000

The controller flies the nominal plant through set points, so requests are as in flight. With
--processor the script measures processor time, so other programs do not count.
"""

from __future__ import annotations

import argparse
import gc
import time
from collections import Counter, deque

import numpy as np

from airpuck.compute.process import low_latency
from airpuck.control.laws import LAWS
from airpuck.control.reference import SetPoints
from airpuck.control.tracking import TrackingController
from airpuck.control.tuning import ESTIMATORS, default_tuning
from airpuck.model.model_file import Model, read_model
from airpuck.physics.rigid_body import step

FRAME, PERIOD = 1 / 240, 1 / 100


class Craft:
    """The nominal plant: commands begin to act a transport delay after they were sent."""

    def __init__(self, model: Model) -> None:
        idle = np.full(model.vehicle.n_propellers, model.vehicle.command_min)
        self.model, self.time = model, 0.0
        self.state = np.concatenate([np.zeros(6), idle])
        self._acting, self._pending = idle, deque[tuple[float, np.ndarray]]()

    def sent(self, time: float, command: np.ndarray) -> None:
        """Accept a command in transit."""
        self._pending.append((time + self.model.transport_delay, command))

    def fly(self, until: float) -> None:
        """Advance to a time."""
        while self._pending and self._pending[0][0] <= until:
            begins, command = self._pending.popleft()
            self._step(begins)
            self._acting = command
        self._step(until)

    def _step(self, until: float) -> None:
        self.state = step(np, self.model.dynamics, self.state, self._acting, until - self.time)
        self.time = until


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=20_000)
    parser.add_argument("--model", default="paper:M4")
    parser.add_argument(
        "--solver", default="daqp", choices=("daqp", "piqp"), help="of the allocation"
    )
    parser.add_argument("--law", default="lqr", choices=LAWS)
    parser.add_argument("--estimator", default="kalman", choices=ESTIMATORS)
    parser.add_argument("--processor", action="store_true", help="measure processor time")
    options = parser.parse_args()
    clock = time.process_time_ns if options.processor else time.perf_counter_ns

    low_latency()
    tuning = default_tuning().with_estimator(options.estimator)
    tuning = tuning.with_law("lqr", solver=options.solver).with_law(options.law)
    model = read_model(options.model)
    poses = [(0.0, 0.0, 0.0), (0.4, 0.2, 1.5), (-0.2, -0.3, -1.0)]
    times = np.arange(0, options.steps / 100 + 2, 2.0)
    reference = SetPoints(times, [poses[k % 3] for k in range(len(times))])
    controller = TrackingController(model, reference, tuning)
    craft, statuses = Craft(model), Counter()
    rng = np.random.default_rng(0)
    noise = rng.normal(size=(options.steps * 3, 3)) * [5e-5, 5e-5, 6e-4]
    spent = {"poses": [], "step": [], "total": []}
    frame = 0
    gc.disable()  # as a real-time process does
    for k in range(options.steps):
        now = (k + 1) * PERIOD
        measured = []
        while frame * FRAME <= now:
            craft.fly(frame * FRAME)
            measured.append((frame * FRAME, craft.state[:3] + noise[frame]))
            frame += 1
        started = clock()
        for stamp, pose in measured:
            controller.pose(stamp, pose)
        between = clock()
        result = controller.step(now)
        controller.sent(now, result.command)
        ended = clock()
        spent["poses"].append(between - started)
        spent["step"].append(ended - between)
        spent["total"].append(ended - started)
        statuses[result.status] += 1
        craft.sent(now, result.command)
    named = options.model, options.law, options.solver, options.estimator
    print(f"{options.steps} steps, {', '.join(named)}")
    print(", ".join(f"{status} {count}" for status, count in statuses.most_common()))
    for name, values in spent.items():
        micro = np.array(values) / 1e3
        p50, p99 = np.percentile(micro, [50, 99])
        print(f"{name:6s} p50 {p50:7.1f} µs   p99 {p99:7.1f} µs   max {micro.max():8.1f} µs")


if __name__ == "__main__":
    main()
