"""Solvers of the predictive law's quadratic program: time and agreement, on a flight's programs.

    OPENBLAS_NUM_THREADS=1 python -m benchmarks.horizon_solvers --steps 1000

The predictive law flies the nominal plant through set points. Each of its programs goes to three
solvers: DAQP on the commands alone, from the last active set; OSQP (of CasADi's wheel) on the same
program, from the last answer, with a slack for every limit of the craft's motion; and PIQP with all
states. Times are processor times, so other programs on the machine do not count.
"""

from __future__ import annotations

import argparse
import gc
import time
from collections.abc import Sequence

import casadi as ca
import numpy as np

from airpuck.compute.process import low_latency
from airpuck.control.horizon import Blocks, Condensed, stages
from airpuck.control.mpc import MPC
from airpuck.control.predictive import PredictiveSettings
from airpuck.control.reference import SetPoints
from airpuck.control.tracking import TrackingController
from airpuck.control.tuning import default_tuning
from airpuck.model.model_file import read_model
from benchmarks.control_step import FRAME, PERIOD, Craft
from benchmarks.multistage import Multistage

#: Rails.
LIMITED = 2


class Osqp:
    """OSQP (Stellato and others 2020), an operator-splitting method."""

    def __init__(self, motors: int, rows: int, penalty: float, tolerance: float) -> None:
        self._m, self._rows, self._penalty = motors, rows, penalty
        total = motors + rows
        hessian = ca.diagcat(ca.DM.ones(motors, motors), ca.DM.eye(rows))
        slacks, limits = ca.DM.eye(rows), ca.DM.ones(rows, motors)
        limited = ca.blockcat([[limits, slacks], [limits, -slacks]])
        self._shape = {"h": hessian.sparsity(), "a": limited.sparsity()}
        #: Processor time, without the set-up of the matrices [s].
        self.spent: list[float] = []
        settings = {"eps_abs": tolerance, "eps_rel": tolerance, "max_iter": 20_000}
        settings |= {"verbose": False}
        options = {"osqp": settings, "error_on_fail": False, "record_time": True}
        self._solver = ca.conic("osqp", "osqp", self._shape, options)
        self._last = np.zeros(total)

    def solve(self, formed: Sequence[np.ndarray]) -> np.ndarray | None:
        """Return the changes of all commands, if it converged."""
        hessian, gradient, rows, lower, upper, _ = formed
        m, count = self._m, self._rows
        h, slacks = ca.diagcat(hessian, self._penalty * ca.DM.eye(count)), ca.DM.eye(count)
        a, free = ca.blockcat([[rows, slacks], [rows, -slacks]]), np.full(count, np.inf)
        found = self._solver(
            h=ca.project(h, self._shape["h"]),
            g=np.concatenate([gradient, np.full(count, self._penalty)]),
            a=ca.project(a, self._shape["a"]),
            lba=np.concatenate([lower[m:], -free]),
            uba=np.concatenate([free, upper[m:]]),
            lbx=np.concatenate([lower[:m], np.zeros(count)]),
            ubx=np.concatenate([upper[:m], free]),
            x0=self._last,
        )
        stats, self._last = self._solver.stats(), found["x"].full().ravel()
        self.spent.append(stats["t_proc_total"])
        return self._last[:m] if stats["success"] else None


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=1000)
    parser.add_argument("--model", default="paper:M3")
    parser.add_argument("--tolerance", type=float, default=1e-5, help="of OSQP")
    options = parser.parse_args()

    low_latency()
    model, tuning = read_model(options.model), default_tuning().with_law("mpc")
    settings, vehicle = tuning.of(PredictiveSettings), model.vehicle
    blocks = Blocks.of(settings)
    given = vehicle, blocks, settings
    condensed = Condensed(*given, (False,) * LIMITED)
    stagewise = Multistage(*given, LIMITED)
    rows = LIMITED * len(blocks.owner)
    osqp = Osqp(condensed.m, rows, settings.limits.penalty, options.tolerance)
    posed = stages(model, blocks, settings, True)
    poses = [(0.0, 0.0, 0.0), (0.4, 0.2, 1.5), (-0.2, -0.3, -1.0), (0.9, 0.44, 1.0)]
    times = np.arange(0, options.steps / 100 + 2, 1.5)
    reference = SetPoints(times, [poses[k % 4] for k in range(len(times))])
    controller, craft = TrackingController(model, reference, tuning), Craft(model)
    law = controller.law
    assert isinstance(law, MPC)
    rng, frame = np.random.default_rng(0), 0
    spent: dict[str, list[float]] = {"daqp": [], "piqp": [], "osqp": osqp.spent}
    apart: dict[str, list[float]] = {"osqp": [], "piqp": []}
    gc.disable()
    for k in range(options.steps):
        now = (k + 1) * PERIOD
        while frame * FRAME <= now:
            craft.fly(frame * FRAME)
            noise = rng.normal(size=3) * [5e-5, 5e-5, 6e-4]
            controller.pose(frame * FRAME, craft.state[:3] + noise)
            frame += 1
        e = controller.predict(now)
        moment = controller.state, reference, now, model.transport_delay
        inputs, _ = law.posed(*moment, law.fence, np.zeros((0, 5)))
        s = posed(np, e.state, e.motor_speed, e.disturbance, e.effectiveness, *inputs)
        formed, staged = condensed.form(np, s), stagewise.form(np, s)
        begun = time.process_time()
        one = condensed.solve(formed)
        between = time.process_time()
        other = stagewise.solve(staged)
        spent["daqp"].append(between - begun)
        spent["piqp"].append(time.process_time() - between)
        answers = {"piqp": other and other.change.ravel(), "osqp": osqp.solve(formed)}
        for name, change in answers.items():
            known = one is not None and change is not None
            apart[name].append(np.abs(change - one.change.ravel()).max() if known else np.nan)
        step = controller.steer(e, now)
        controller.sent(now, step.command)
        craft.sent(now, step.command)
    for name, values in spent.items():
        p50, p99 = 1e3 * np.percentile(values, [50, 99])
        print(f"{name}: p50 {p50:.3f} ms, p99 {p99:.3f} ms, at most {1e3 * max(values):.2f} ms")
    for name, values in apart.items():
        known = np.array(values)[np.isfinite(values)]
        print(
            f"{name} against daqp: commands differ by {np.median(known):.1e} in the median, "
            f"{known.max():.1e} at most; {len(values) - len(known)} without an answer"
        )


if __name__ == "__main__":
    main()
