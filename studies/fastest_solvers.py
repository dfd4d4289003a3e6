"""IPOPT against fatrop on the program of a plan, in one run.

    python studies/fastest_solvers.py --pairs 8

In fatrop, each stage has only its own variables. So the duration becomes a constant state, and the
previous command another state. Both solvers get this formulation; IPOPT also gets the package's own
layout. All searches begin with a straight guess, on 40 intervals.
"""

from __future__ import annotations

import argparse
import time

import casadi as ca
import numpy as np
from fastest import pair

import airpuck
from airpuck.craft.table import Table
from airpuck.planning import transcription
from airpuck.planning.request import checked_request
from airpuck.planning.search import starts
from airpuck.planning.settings import Limits

INTERVALS = 40
#: Tolerance on either side of a given final state.
_ROOM = 1e-5


class Staged:
    """The same program with stages that share no variable."""

    def __init__(self, model: airpuck.Model, solver: str) -> None:
        n = self.n = model.vehicle.n_propellers
        advance, _ = transcription._step_functions(model)
        size = 6 + n
        x = [ca.SX.sym(f"x{k}", size + 1 + n) for k in range(INTERVALS + 1)]
        u = [ca.SX.sym(f"u{k}", n) for k in range(INTERVALS)]
        cost, gaps = x[-1][size], []
        for k in range(INTERVALS):
            z, duration, before = x[k][:size], x[k][size], x[k][size + 1 :]
            moved = advance(z, u[k], duration / INTERVALS)
            gaps.append(x[k + 1] - ca.vertcat(moved, duration, u[k]))
            cost += transcription._SMOOTHING / (INTERVALS - 1) * ca.sumsqr(u[k] - before)
        points = [part for both in zip(x, u, strict=False) for part in both]
        problem = {"x": ca.vertcat(*points, x[-1]), "f": cost, "g": ca.vertcat(*gaps)}
        options = dict(transcription._OPTIONS)
        if solver == "fatrop":
            del options["ipopt"]
            options |= {"structure_detection": "auto", "equality": [True] * problem["g"].numel()}
            options["fatrop"] = {"print_level": 0, "tol": 1e-7, "max_iter": 300}
        self._solver = ca.nlpsol("plan", solver, problem, options)

    def solve(self, request, guess, yaw) -> tuple[float, bool]:
        """Return the duration, and whether it converged."""
        program = transcription.program_for(request.model, INTERVALS, 1, 0)
        lower, upper = program._bounds(request, yaw, guess.durations)
        start = program._packed(guess.states, guess.commands, guess.durations)
        columns = [self._laid_out(program, values) for values in (lower, upper, start)]
        low, high, first = columns
        last = (low == high) & (np.arange(len(low)) >= len(low) - (7 + 2 * self.n))
        low, high = low - _ROOM * last, high + _ROOM * last
        found = self._solver(x0=first, lbx=low, ubx=high, lbg=0, ubg=0)
        duration = float(found["x"][-1 - self.n])
        return duration, bool(self._solver.stats()["success"])

    def _laid_out(self, program, values) -> np.ndarray:
        """Give every stage the duration and the previous command, which is free at the start."""
        states, commands, durations = program._unpacked(values)
        before = np.vstack([commands[:1], commands])
        whole = np.column_stack([states, np.full(len(states), durations[0]), before])
        stages = np.concatenate([whole[:-1], commands], axis=1)
        return np.concatenate([stages.ravel(), whole[-1]])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--pairs", type=int, default=8)
    given = parser.parse_args()
    model, random = airpuck.read_model("paper:M3"), np.random.default_rng(0)
    program = transcription.program_for(model, INTERVALS, 1, 0)
    staged = {solver: Staged(model, solver) for solver in ("ipopt", "fatrop")}
    spent: dict[str, list[tuple[float, bool, float]]] = {}
    for k in range(given.pairs):
        start, goal = pair(model, random, k % 2 == 1, k % 4 == 3)
        try:
            request = checked_request(model, start, goal, (), Table(), (), Limits())
        except airpuck.InputError:
            continue
        _, guess, yaw = next(starts(request, INTERVALS))
        begun = time.process_time()
        found = program.solve(request, guess, yaw)
        row = time.process_time() - begun, found.converged, float(found.path.durations.sum())
        spent.setdefault("IPOPT, the package's layout", []).append(row)
        for solver, other in staged.items():
            begun = time.process_time()
            duration, converged = other.solve(request, guess, yaw)
            row = time.process_time() - begun, converged, duration
            spent.setdefault(f"{solver}, stage by stage", []).append(row)
    best = np.min([[t if ok else np.inf for _, ok, t in rows] for rows in spent.values()], axis=0)
    for name, rows in spent.items():
        took, converged, durations = map(np.array, zip(*rows, strict=True))
        same = converged & (durations < 1.001 * best)
        low, high = np.quantile(took, [0.5, 0.95])
        print(
            f"{name}: p50 {low:.3f} s, p95 {high:.3f} s; {converged.sum()} of {len(rows)} "
            f"converged, {same.sum()} to the best of them"
        )


if __name__ == "__main__":
    from one_line import run

    run(main)
