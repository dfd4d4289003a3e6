"""Thrust allocation on random states and requests: feasibility, agreement, time.

    OPENBLAS_NUM_THREADS=1 python benchmarks/allocation.py --count 1000000

Both solvers decide whether the hard problem (eq. force_qp) is feasible. If it is, their answers are
compared; otherwise a sample is compared with the bounded least squares of scipy.
"""

from __future__ import annotations

import argparse
import time

import numpy as np
from scipy.optimize import lsq_linear

from airpuck.control.allocation import problem
from airpuck.control.lqr import motor_lag
from airpuck.model.model_file import read_model
from airpuck.physics.rigid_body import acceleration_map
from airpuck.physics.thrust import thrust
from tests.apparatus.allocators import Allocator

#: One infeasible request out of this number is checked with scipy.
CHECKED = 2000


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=1_000_000)
    parser.add_argument("--model", default="paper:M4")
    options = parser.parse_args()
    model = read_model(options.model)
    dynamics, vehicle, n = model.dynamics, model.vehicle, model.vehicle.n_propellers
    arm = float(np.sqrt(model.parameters.inertia / vehicle.mass_kg))
    lag, drive = motor_lag(float(dynamics.motor_time_constant), 0.01)
    daqp, piqp = (Allocator(n, arm, solver=name) for name in ("daqp", "piqp"))
    rng = np.random.default_rng(0)
    apart = outside = distance = 0.0
    outcomes: dict[str, int] = {}
    disagreements = nearest = 0
    spent = np.zeros(2)
    for _ in range(options.count):
        speed = rng.uniform(vehicle.command_min, 1, n)
        matrix, offset = acceleration_map(
            np, dynamics, rng.uniform(-np.pi, np.pi), rng.normal() * 8
        )
        request = rng.normal(size=3) * [3.0, 3.0, 40.0]
        low, high = (
            thrust(dynamics.thrust, lag * speed + drive * u) for u in (vehicle.command_min, 1.0)
        )
        first, second = (one.allocate(request, matrix, offset, low, high) for one in (daqp, piqp))
        # A controller's compiled program writes the problem; only the time to solve it counts here.
        posed = problem(np, arm, daqp.slack_weight, request, matrix, offset, low, high)
        begun = time.perf_counter()
        daqp.solve(*posed)
        between = time.perf_counter()
        piqp.solve(*posed)
        spent += [between - begun, time.perf_counter() - between]
        outcomes[first.outcome] = outcomes.get(first.outcome, 0) + 1
        outside = max(
            outside, float(np.max(low - first.thrust)), float(np.max(first.thrust - high))
        )
        if (first.outcome == "nearest") != (second.outcome == "nearest"):
            disagreements += 1
        elif first.outcome != "nearest":
            apart = max(apart, float(np.abs(first.thrust - second.thrust).max()))
        else:
            nearest += 1
            if nearest % CHECKED == 1:
                rows = np.array([1.0, 1.0, arm])
                columns = np.column_stack(
                    [matrix, -np.array([*request[:2], 0.0]), -np.array([0.0, 0.0, request[2]])]
                )
                best = lsq_linear(
                    rows[:, None] * columns,
                    -rows * offset,
                    (np.append(low, [0, 0]), np.append(high, [1, 1])),
                    method="bvls",
                    tol=1e-14,
                )
                ours = np.append(first.thrust, [first.linear_scale, first.angular_scale])
                length = np.linalg.norm(rows * (columns @ ours + offset))
                distance = max(distance, float(length - np.sqrt(2 * best.cost)))
    print(f"{options.count} random states and requests, {options.model}")
    for outcome, count in sorted(outcomes.items()):
        print(f"{outcome:8s} {100 * count / options.count:6.2f} %")
    print(f"feasibility judged differently: {disagreements}")
    print(f"largest difference of thrusts where feasible: {apart:.1e} N")
    print(f"largest excess over the bounds: {max(outside, 0.0):.1e} N")
    print(f"nearest: distance above scipy's at most {distance:.1e} m/s²")
    print(
        "mean time to solve: daqp {:.1f} µs, piqp {:.1f} µs".format(*(1e6 * spent / options.count))
    )


if __name__ == "__main__":
    main()
