"""The shortest flight as a nonlinear program: direct multiple shooting in CasADi, solved by IPOPT.

The step from node to node is `airpuck.physics.rigid_body.step`, traced with CasADi's symbols.
"""

from __future__ import annotations

from contextlib import redirect_stderr
from dataclasses import dataclass
from functools import lru_cache
from io import StringIO
from typing import Any

import numpy as np
from jaxtyping import Float

from airpuck.boundary.errors import installed
from airpuck.boundary.signals import check_stopped
from airpuck.compute.arrays import with_symbols
from airpuck.model.model_file import Model
from airpuck.physics.rigid_body import step
from airpuck.planning.request import Request

#: x, y, γ and their rates.
_MOTION = 6
#: Upper bound of a leg's duration: this multiple of its guess plus this time [s].
_LONGEST, _LONGER = 6.0, 1.0
#: Shortest duration of a leg [s].
_SHORTEST = 1e-3
_MOST_ITERATIONS = 120
#: Number of simulated states per interval from which a path is resampled.
_BETWEEN = 8
#: Runge-Kutta steps between two nodes: a plan of a second then ends within a millimetre.
_SUBSTEPS = 2

#: Options of IPOPT: no output, limited iterations.
_OPTIONS = {
    "print_time": False,
    "error_on_fail": False,
    "ipopt": {
        "print_level": 0,
        "sb": "yes",
        "max_iter": _MOST_ITERATIONS,
        "tol": 1e-7,
        # Takes half the iterations of any other choice, from cold and from neighbouring plans.
        "mu_strategy": "adaptive",
        "adaptive_mu_globalization": "never-monotone-mode",
    },
}
#: Compiled programs that a process keeps.
_PROGRAMS = 16


@dataclass(frozen=True, eq=False)
class Path:
    """A flight in the program's form: nodes, and commands held between them."""

    #: Duration of each leg [s].
    durations: Float[np.ndarray, " legs"]
    #: States at the nodes, and commands; the end of a leg is the start of the next.
    states: Float[np.ndarray, "nodes s"]
    commands: Float[np.ndarray, "intervals n"]

    @property
    def times(self) -> Float[np.ndarray, " nodes"]:
        """Times of the nodes [s]."""
        intervals = len(self.commands) // len(self.durations)
        return np.concatenate([[0.0], np.cumsum(np.repeat(self.durations / intervals, intervals))])

    def simulated(
        self, model: Model, times: Float[np.ndarray, " nodes"], parts: int
    ) -> tuple[Float[np.ndarray, " M"], Float[np.ndarray, "M s"]]:
        """Return times and states simulated from the start, with intervals divided into parts."""
        periods = np.repeat(np.diff(times) / parts, parts)
        flown = model.simulate(self.states[0], np.repeat(self.commands, parts, axis=0), periods)
        return np.concatenate([[0.0], np.cumsum(periods)]), np.vstack([self.states[:1], flown])

    def resampled(self, intervals: int, model: Model | None = None) -> Path:
        """Return the path with another number of intervals in each leg.

        With a model, states between the nodes are simulated: from interpolated ones the solver may
        move to another, slower flight. A guess cannot be simulated.
        """
        legs = len(self.durations)
        if intervals * legs == len(self.commands):
            return self
        before = self.times
        ends = np.concatenate([[0.0], np.cumsum(self.durations)])
        times = np.concatenate(
            [np.linspace(ends[i], ends[i + 1], intervals + 1)[:-1] for i in range(legs)]
            + [ends[-1:]]
        )
        known = (before, self.states)
        if model is not None:
            known = self.simulated(model, before, _BETWEEN)
        states = np.array([np.interp(times, known[0], column) for column in known[1].T]).T
        middle = (times[1:] + times[:-1]) / 2
        held = np.clip(np.searchsorted(before, middle) - 1, 0, len(self.commands) - 1)
        return Path(self.durations, states, self.commands[held])


@dataclass(frozen=True, eq=False)
class Solved:
    """The solver's result for one start."""

    path: Path
    converged: bool
    #: Its words.
    status: str
    iterations: int
    #: Multipliers of the dynamics constraints: the value of a state, up to sign [s per unit].
    prices: Float[np.ndarray, "intervals s"]
    #: Multipliers of the position bounds at the nodes: nonzero where the path touches a rail.
    touching: Float[np.ndarray, "nodes 2"]

    @property
    def time(self) -> float:
        """Duration of the flight [s]."""
        return float(self.path.durations.sum())


class Transcription:
    """The program for a model and a number of intervals, way points and discs; see `program_for`.

    The variables are state and command of each node in turn, then the final state and the durations
    of the legs. All limits, start and goal are bounds, so a program is built once. Each interval
    has the same cost and constraints. They are differentiated once, with respect to one interval's
    variables, and a constant matrix places the results among all variables.
    """

    def __init__(self, model: Model, intervals: int, legs: int, discs: int) -> None:
        casadi = _casadi()
        self.intervals, self.legs = intervals, legs
        self.n = model.vehicle.n_propellers
        self.size = _MOTION + self.n
        total = intervals * legs
        w, settings, cost, rows = _interval(model, discs)
        by_cost, by_rows = casadi.SX.sym("by_cost"), casadi.SX.sym("by_rows", *rows.shape)
        curvature = casadi.hessian(by_cost * cost + casadi.dot(by_rows, rows), w)[0]
        values = casadi.Function("values", [w, settings], [cost, rows])
        slopes = casadi.Function("slopes", [w, settings], [casadi.jacobian(rows, w)])
        curves = casadi.Function("curves", [w, settings, by_cost, by_rows], [curvature])

        placed, idle = self._placed(model.vehicle.command_min)
        x = casadi.MX.sym("x", placed.shape[1])
        p = casadi.MX.sym("p", *settings.shape)
        lam_f, lam_g = casadi.MX.sym("lam_f"), casadi.MX.sym("lam_g", rows.numel() * total)
        points = casadi.reshape(placed @ x + idle, w.numel(), total)
        # What motors do afterwards is not a change between intervals.
        used = np.ones((settings.numel(), total))
        used[-1] = np.append(np.ones(total - 1), 0) / max(total - 1, 1)
        each = points, casadi.repmat(p, 1, total) * casadi.DM(used)
        costs, constraints = values.map(total)(*each)
        g = casadi.vec(constraints)
        multipliers = casadi.repmat(lam_f, 1, total), casadi.reshape(lam_g, -1, total)

        def along(blocks: Any) -> Any:
            return casadi.diagcat(*casadi.horzsplit(blocks, w.numel())) @ placed

        jacobian = along(slopes.map(total)(*each))
        hessian = casadi.triu(placed.T @ along(curves.map(total)(*each, *multipliers)))
        derivatives = {
            "jac_g": casadi.Function("jac_g", [x, p], [g, jacobian]),
            "hess_lag": casadi.Function("hess_lag", [x, p, lam_f, lam_g], [hessian]),
        }
        problem = {"x": x, "f": casadi.sum2(costs), "g": g, "p": p}
        self.solver = casadi.nlpsol("plan", "ipopt", problem, _OPTIONS | derivatives)

    def _placed(self, idle: float) -> tuple[Any, Any]:
        """Return matrix and offset from all variables to those of each interval.

        An interval has state and command, those at its end, and its duration. Motors idle after the
        last one.
        """
        total, node = self.intervals * self.legs, self.size + self.n
        interval = np.arange(total)[:, None]
        leg = total * node + self.size + interval // self.intervals
        column = np.concatenate([interval * node + np.arange(2 * node), leg], axis=1)
        share = np.ones(column.shape)
        share[:, -1] = 1 / self.intervals
        after = np.zeros(column.shape, dtype=bool)
        after[-1, node + self.size : -1] = True
        row, size = np.flatnonzero(~after), (column.size, int(leg[-1, 0]) + 1)
        matrix = _casadi().DM.triplet(row, column[~after], share[~after], *size)
        return matrix, idle * after.ravel()

    def solve(self, request: Request, guess: Path, final_yaw: float, tidiness: float) -> Solved:
        """Solve from a guess, for a goal with this yaw.

        The weight [s] of the commands' mean squared change between intervals smooths whatever does
        not affect the duration.
        """
        lower, upper = self._bounds(request, final_yaw, guess.durations)
        clear = np.ones(2 * len(request.keep_out))
        steps, spin = np.zeros(self.size), request.limits.spin
        total = self.intervals * self.legs
        with redirect_stderr(StringIO()):  # CasADi warns of Ctrl-C
            found = self.solver(
                x0=self._packed(guess.states, guess.commands, guess.durations),
                lbx=lower,
                ubx=upper,
                lbg=np.tile([*steps, *clear, -spin], total),
                ubg=np.tile([*steps, *(np.inf * clear), spin], total),
                p=[*request.keep_out.ravel(), request.limits.smoothing, tidiness],
            )
        check_stopped()  # IPOPT ends as if it had found no plan
        stats = self.solver.stats()
        states, commands, durations = self._unpacked(found["x"].full()[:, 0])
        prices = found["lam_g"].full().reshape(total, -1)[:, : self.size]
        touching = self._unpacked(found["lam_x"].full()[:, 0])[0][:, :2]
        return Solved(
            Path(durations, states, commands),
            bool(stats["success"]),
            str(stats["return_status"]),
            int(stats["iter_count"]),
            prices,
            touching,
        )

    def _bounds(
        self, request: Request, final_yaw: float, guess: Float[np.ndarray, " legs"]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the bounds of all variables."""
        total, limits = self.intervals * self.legs, request.limits
        vehicle, free = request.model.vehicle, np.inf
        motion = [*request.reach, free, limits.speed, limits.speed, limits.spin]
        upper = np.tile([*motion, *np.ones(self.n)], (total + 1, 1))
        lower = np.tile([*(-np.array(motion)), *np.zeros(self.n)], (total + 1, 1))
        goal = request.goal.state
        if not np.isnan(goal[2]):
            goal[2] = final_yaw
        fixed = np.concatenate([~np.isnan(goal), np.zeros(self.n, dtype=bool)])
        lower[-1, fixed] = upper[-1, fixed] = goal[~np.isnan(goal)]
        for leg, point in enumerate(request.via, start=1):
            lower[leg * self.intervals, :2] = upper[leg * self.intervals, :2] = point
        lower[0] = upper[0] = request.start
        least = np.full((total, self.n), vehicle.command_min)
        most = np.tile(request.highest_command, (total, 1))
        shortest, longest = np.full(self.legs, _SHORTEST), _LONGEST * guess + _LONGER
        return self._packed(lower, least, shortest), self._packed(upper, most, longest)

    def _packed(self, states: Any, commands: Any, durations: Any) -> np.ndarray:
        """Lay out the variables."""
        nodes = np.concatenate([states[:-1], commands], axis=1)
        return np.concatenate([nodes.ravel(), states[-1], durations])

    def _unpacked(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return states, commands and durations."""
        x, durations = x[: -self.legs], x[-self.legs :]
        nodes = x[: -self.size].reshape(-1, self.size + self.n)
        states = np.concatenate([nodes[:, : self.size], x[None, -self.size :]])
        return states, nodes[:, self.size :], durations


@lru_cache(maxsize=_PROGRAMS)
def program_for(model: Model, intervals: int, legs: int, discs: int) -> Transcription:
    """Return the program, built on first use in this process."""
    return Transcription(model, intervals, legs, discs)


def _interval(model: Model, discs: int) -> tuple[Any, Any, Any, Any]:
    """Return variables, settings, cost and constraints of one interval, in symbols.

    Constraints are the step, the distances from the discs at half the interval and at its end, and
    the yaw rate between; settings are discs, smoothing and tidiness.
    """
    casadi = _casadi()
    sym, n = casadi.SX.sym, model.vehicle.n_propellers
    z, u, h = sym("z", _MOTION + n), sym("u", n), sym("h")
    after, following = sym("after", _MOTION + n), sym("following", n)
    places, smoothing, tidiness = sym("discs", 3, discs), sym("smoothing"), sym("tidiness")

    def advance(state: Any, command: Any, duration: Any) -> Any:
        half = step(np, model.dynamics, state, command, duration[0] / _SUBSTEPS)
        end = step(np, model.dynamics, half, command, duration[0] / _SUBSTEPS)
        return np.concatenate([end, half[5:6]])

    end = with_symbols(advance, z, u, h)
    # The midpoint of the cubic through both positions with both velocities.
    middle = (z[:2] + after[:2]) / 2 + h / 8 * (z[3:5] - after[3:5])
    away = [point - places[:2, d] for d in range(discs) for point in (middle, after[:2])]
    clear = [casadi.sumsqr(way) / places[2, k // 2] ** 2 for k, way in enumerate(away)]
    change = casadi.sumsqr(following - u)
    return (
        casadi.vertcat(z, u, after, following, h),
        casadi.vertcat(casadi.vec(places), smoothing, tidiness),
        h + (tidiness + smoothing / h) * change,
        casadi.vertcat(after - end[:-1], *clear, end[-1]),
    )


def _casadi() -> Any:
    """Return CasADi; raise InputError with instructions if it is not installed."""
    with installed("planning needs CasADi: pip install 'airpuck[plan]'"):
        import casadi

    return casadi
