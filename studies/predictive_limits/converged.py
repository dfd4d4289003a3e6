"""Nonlinear predictive control solved to convergence: the reference for the predictive law.

Physics, cost, horizon and motor limits come from `airpuck.control.mpc`, traced into CasADi.
Here each step has a separate command, and an interior-point method solves to a tolerance. Rails are
left out, so tables must be wide.
"""

from __future__ import annotations

import time
from typing import Any

import casadi as ca
import numpy as np

from airpuck.compute.arrays import with_symbols
from airpuck.control.law import Law, Moment, Step
from airpuck.control.lqr import cost_to_go, point_mass
from airpuck.control.predictive import PredictiveSettings
from airpuck.control.reference import preview
from airpuck.model.model_file import Model
from airpuck.physics.rigid_body import Dynamics, acceleration, step, wrapped

#: Commands of the first guess.
_FIRST = 0.3


def accelerations(dynamics: Dynamics, state: Any) -> Any:
    """Return the accelerations of states (6 + n, B): x, y, yaw."""
    return np.stack(acceleration(np, dynamics, state[2:6], state[6:]))


class Problem:
    """The nonlinear problem of a craft, built once.

    Parameters
    ----------
    model : Model
        The craft.
    settings : PredictiveSettings
        Cost and horizon.
    dynamics : Dynamics, optional
        Dynamics of the prediction; by default the model's.
    solver : str
        ``fatrop`` or ``ipopt``.
    tolerance : float
        Tolerance of the solver.
    compiled : bool
        Whether the system's C compiler compiles the derivatives, which takes a minute.
    """

    def __init__(
        self,
        model: Model,
        settings: PredictiveSettings,
        *,
        dynamics: Dynamics | None = None,
        solver: str = "fatrop",
        tolerance: float = 1e-3,
        compiled: bool = False,
    ) -> None:
        vehicle, self.n = model.vehicle, model.vehicle.n_propellers
        self.count = round(settings.horizon_s / settings.step_s)
        self.times = settings.step_s * np.arange(1, self.count + 1)
        self.range = vehicle.command_min, vehicle.command_max
        problem = _posed(model, settings, dynamics or model.dynamics)
        options: dict[str, Any] = {"print_time": False, "error_on_fail": False}
        options[solver] = {"print_level": 0, "tol": tolerance, "mu_init": 1e-2}
        if solver == "ipopt":
            options["ipopt"]["sb"] = "yes"
        else:
            # One equality for each state and step: that is how it knows the stages.
            gaps = [True] * problem["g"].numel()
            options |= {"structure_detection": "auto", "equality": gaps}
        if compiled:
            options |= {"jit": True, "compiler": "shell", "jit_options": {"flags": ["-O1"]}}
        self._solver = ca.nlpsol("converged", solver, problem, options)

    def solve(
        self, start: np.ndarray, wanted: np.ndarray, pushed: np.ndarray, guess: np.ndarray | None
    ) -> tuple[np.ndarray, bool]:
        """Return states and commands, one after the other, and whether they are a solution."""
        n, size, count = self.n, len(start), self.count
        if guess is None:
            guess = np.append(np.tile(np.append(start, np.full(n, _FIRST)), count), start)
        bounds = []
        for side, limit in zip((-np.inf, np.inf), self.range, strict=True):
            free, command = np.full(size, side), np.full(n, limit)
            bounds.append([start, command, *[free, command] * (count - 1), free])
        low, high = map(np.concatenate, bounds)
        given = np.concatenate([wanted.ravel(), pushed])
        found = self._solver(x0=guess, p=given, lbx=low, ubx=high, lbg=0, ubg=0)
        return found["x"].full().ravel(), bool(self._solver.stats()["success"])


class Converged(Law):
    """Flies the solution of the nonlinear problem; its state is the latest plan, the next guess."""

    def __init__(self, problem: Problem) -> None:
        self._problem = problem
        #: For each step: its time [s], and whether the solver converged.
        self.spent: list[float] = []
        self.converged: list[bool] = []

    def step(self, state: np.ndarray | None, moment: Moment) -> tuple[Step, np.ndarray | None]:
        """Return the first command of the best plan."""
        estimate, _ = moment.foresee()
        ahead = moment.delay + self._problem.times
        wanted = preview(moment.reference, moment.now, ahead).states
        start = np.concatenate([estimate.state, estimate.motor_speed])
        # Whole turns do not count.
        left = start[2] - wanted[0, 2]
        wanted = wanted + (np.arange(6) == 2) * (left - wrapped(np, left))
        began = time.perf_counter()
        plan, solved = self._problem.solve(start, wanted, estimate.disturbance, state)
        self.spent.append(time.perf_counter() - began)
        self.converged.append(solved)
        command = plan[len(start) : len(start) + self._problem.n].clip(*self._problem.range)
        return Step(command, "optimal", np.zeros(3), estimate), plan if solved else state


def _posed(model: Model, settings: PredictiveSettings, dynamics: Dynamics) -> dict[str, Any]:
    """Pose the problem, step by step: states and commands."""
    n, h, w = model.vehicle.n_propellers, settings.step_s, settings.weights
    count, size, least = round(settings.horizon_s / h), 6 + n, model.vehicle.command_min
    z, u = ca.SX.sym("z", size), ca.SX.sym("u", n)
    moved = with_symbols(lambda z, u: step(np, dynamics, z, u, h), z, u)
    following = ca.Function("f", [z, u], [moved])
    felt = ca.Function("a", [z], [with_symbols(lambda z: accelerations(dynamics, z), z)])
    parts = np.diag(w.errors * h), np.diag(w.efforts * h)
    terminal = cost_to_go(*point_mass(h), *parts)
    states = [ca.SX.sym("z", size) for _ in range(count + 1)]
    chosen = [ca.SX.sym("u", n) for _ in range(count)]
    wanted, pushed = ca.SX.sym("w", 6, count), ca.SX.sym("d", 3)
    push = ca.vertcat(h * h / 2 * pushed, h * pushed, np.zeros(n))
    cost, gaps = 0, []
    for k, (before, command, after) in enumerate(zip(states, chosen, states[1:], strict=False)):
        gaps.append(after - following(before, command) - push)
        error, excess = after[:6] - wanted[:, k], felt(after) + pushed
        weight = terminal if k == count - 1 else parts[0]
        cost += ca.bilin(weight, error) + ca.bilin(parts[1], excess)
        cost += w.command * h * ca.sumsqr(command - least)
    points = [part for pair in zip(states, chosen, strict=False) for part in pair]
    return {
        "x": ca.vertcat(*points, states[-1]),
        "p": ca.vertcat(ca.vec(wanted), pushed),
        "f": cost,
        "g": ca.vertcat(*gaps),
    }
