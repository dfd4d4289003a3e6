"""Solvers of the predictive law's quadratic program (`airpuck.control.horizon.Stages`).

Each has two parts: `form` lays the problem out, a pure function that is compiled with what comes
before it; `solve` answers with the change of the plan and whether a limit had to be exceeded, or
with None. Limits are soft, with an exact penalty: what they exceed costs in proportion.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from airpuck.compute.arrays import scan
from airpuck.control.horizon import Blocks, Stages
from airpuck.control.tuning import Regulator
from airpuck.craft.vehicle import Vehicle

#: What the squared change of a command costs, beside its effect. The linearisation holds near the
#: plan only: without this, plans of a craft that turns fast jump between two ways to brake.
_DAMPING = 0.5


@dataclass(frozen=True, eq=False)
class Answer:
    """A solution."""

    #: Of the plan.
    change: Float[np.ndarray, "B n"]
    #: What that changes of x, y, γ and their rates, at the ends of the steps.
    moved: Float[np.ndarray, "N 6"]
    #: Which limits it is at: of the commands, block by block; then of the states, step by step.
    binding: Bool[np.ndarray, " r"]
    #: Whether a limit of the states is exceeded.
    exceeded: bool


class _Common:
    """Sizes and weights that both solvers use."""

    def __init__(self, vehicle: Vehicle, blocks: Blocks, regulator: Regulator) -> None:
        w, n = regulator.weights, vehicle.n_propellers
        self.n, self.m = n, n * len(blocks.lengths)
        self.most = regulator.iterations
        self.penalty = regulator.limits.penalty
        #: Weights of accelerations, of commands, and of their changes.
        self.effort = w.efforts * blocks.step
        self.used = np.repeat(w.command * blocks.step * np.array(blocks.lengths), n)
        self.changed = self.used + _DAMPING
        self.least, self.greatest = vehicle.command_min, vehicle.command_max

    def __getstate__(self) -> dict[str, Any]:
        """Return all but the solver's memory: what a compiled `form` is known by."""
        return {k: v for k, v in vars(self).items() if k not in ("_model", "_solver", "_astray")}


#: A bound that nothing reaches [m, m/s, rad/s]: PIQP wants one on either side of every row.
_FAR = 1e6
#: How DAQP takes a limit.
_HARD, _SOFT = 0, 8
#: What DAQP says of a solution within all limits, and beyond soft ones.
_OPTIMAL, _SOFTENED = 1, 2


class Condensed(_Common):
    """DAQP on the commands alone; it goes on from the last active set."""

    def __init__(self, vehicle: Vehicle, blocks: Blocks, regulator: Regulator, count: int) -> None:
        super().__init__(vehicle, blocks, regulator)
        import daqp

        n, rows = self.n, count * len(blocks.owner)
        #: From all commands to those of a step.
        self._each = np.zeros((len(blocks.owner), n, self.m))
        for k, block in enumerate(blocks.owner):
            self._each[k, :, block * n : (block + 1) * n] = np.eye(n)
        self._senses = np.repeat([_HARD, _SOFT], [self.m, rows]).astype(np.intc)
        # Any feasible numbers will do here: the memory is set up for their sizes.
        empty = np.eye(self.m), np.zeros(self.m), np.zeros((rows, self.m))
        one = np.ones(self.m + rows)
        self._model = daqp.Model()
        self._model.setup(*empty, one, -one, self._senses)
        self._model.settings = {"iter_limit": self.most}
        self._astray = False
        # To exceed by s costs w s + w s²/2. The settings of all at once are for scaled rows.
        linear, curved = self.penalty * one, one / self.penalty
        self._model.soft_weights(rho_l=curved, rho_u=curved, w_l=linear, w_u=linear)

    def form(self, xp: Any, s: Stages) -> tuple[Any, ...]:
        """Leave the states out: Hessian, gradient, rows, lower and upper bounds, and the states."""
        m = self.m

        def onward(moved: Any, given: tuple[Any, Any]) -> tuple[Any, Any]:
            slope, chosen = given
            into = xp.concatenate([moved[2:], chosen])
            kept = xp.concatenate([moved[:2], xp.zeros((moved.shape[0] - 2, m))])
            following = kept + slope @ into
            return following, following

        start = xp.zeros((s.states.shape[1], m))
        _, moved = scan(xp, onward, start, (s.onward, xp.asarray(self._each)))
        pose, pushes = moved[:, :6], s.felt @ moved[:, 2:]
        weighted = xp.concatenate(
            [s.weights[:-1, :, None] * pose[:-1], (s.terminal @ pose[-1])[None]]
        )
        effort, speeds = self.effort[:, None] * pushes, moved[:, 6:]
        bent = s.bend[:, :, None] * speeds
        rows = [part.reshape(-1, m) for part in (weighted, effort, bent, pose, pushes, speeds)]
        left = xp.concatenate([xp.ravel(s.error), xp.ravel(s.excess)])
        product = xp.concatenate(rows[:3]).T
        hessian = product @ xp.concatenate(rows[3:]) + xp.diag(self.changed)
        plan = xp.ravel(s.plan)
        gradient = product[:, : len(left)] @ left + self.used * (plan - self.least)
        limited = (s.limited @ pose).reshape(-1, m)
        lower = xp.concatenate([self.least - plan, xp.ravel(s.lower)])
        upper = xp.concatenate([self.greatest - plan, xp.ravel(s.upper)])
        return hessian, gradient, limited, lower, upper, pose

    def solve(self, formed: Sequence[Float[np.ndarray, "..."]]) -> Answer | None:
        """Solve from the last active set; anew after one that led nowhere."""
        hessian, gradient, rows, lower, upper, pose = formed
        if not math.isfinite(hessian.sum() + gradient.sum() + rows.sum()):
            return None
        given = {"H": hessian, "f": gradient, "A": rows, "bupper": upper, "blower": lower}
        # The active set of a very different problem can send it round in circles; but one that was
        # found anew and not to the end is worth going on with. One attempt a period: it is to end.
        start = {"sense": self._senses} if self._astray else {}
        if self._model.update(**given, **start) >= 0:
            x, _, flag, info = self._model.solve()
            if flag in (_OPTIMAL, _SOFTENED):
                self._astray = False
                binding, exceeded = info["lam"] != 0, flag == _SOFTENED
                return Answer(x.reshape(-1, self.n), pose @ x, binding, exceeded)
        self._astray = not self._astray
        return None


class _Pattern:
    """A sparse matrix whose entries change and whose places do not."""

    def __init__(self, shape: tuple[int, int], *places: tuple[Any, Any]) -> None:
        rows, columns = (
            np.concatenate([np.broadcast_arrays(*place)[i].ravel() for place in places])
            for i in (0, 1)
        )
        self._order = np.lexsort((rows, columns))
        self._rows = rows[self._order].astype(np.int32)
        counts = np.bincount(columns, minlength=shape[1])
        self._starts = np.concatenate([[0], np.cumsum(counts)]).astype(np.int32)
        self._shape = shape

    def filled(self, values: Float[np.ndarray, " k"]) -> Any:
        """Return the matrix with values in the order of the places; zeros are kept."""
        from scipy.sparse import csc_matrix

        return csc_matrix((values[self._order], self._rows, self._starts), shape=self._shape)


class Multistage(_Common):
    """PIQP with all states as variables, whose multistage backend goes through them in turn.

    It begins anew each time, and so needs the same time whatever the plan.
    """

    _ACTIVE = 1e-6

    def __init__(self, vehicle: Vehicle, blocks: Blocks, regulator: Regulator, count: int) -> None:
        super().__init__(vehicle, blocks, regulator)
        self._size = 6 + self.n
        lengths = np.array(blocks.lengths)
        # In turn: the commands of a block, then state and slacks of each of its steps.
        held, each = np.arange(len(lengths)), self._size + count
        before = np.concatenate([[0], np.cumsum(lengths)[:-1]])
        self._u = (held * self.n + before * each)[:, None] + np.arange(self.n)
        k = np.arange(len(blocks.owner))
        first = (blocks.owner + 1) * self.n + k * each
        self._z = first[:, None] + np.arange(self._size)
        self._s = first[:, None] + self._size + np.arange(count)
        total = self.m + each * len(k)
        z, u, s = self._z, self._u[blocks.owner], self._s
        self._cost = _Pattern(
            (total, total), (z[:, :, None], z[:, None, :]), (self._u, self._u), (s, s)
        )
        row = np.arange(z.size).reshape(z.shape)
        self._motion = _Pattern(
            (z.size, total),
            (row, z),
            (row[1:, :, None], z[:-1, None, :]),
            (row[:, :, None], u[:, None, :]),
        )
        row = np.arange(s.size).reshape(s.shape)
        self._limits = _Pattern(
            (2 * s.size, total),
            (row[:, :, None], z[:, None, :6]),
            (row, s),
            (row[:, :, None] + s.size, z[:, None, :6]),
            (row + s.size, s),
        )
        self._solver = None

    def form(self, xp: Any, s: Stages) -> tuple[Any, ...]:
        """Lay out costs, transitions and limits, stage by stage."""
        steps, size, n = len(s.error), self._size, self.n
        ends = xp.concatenate([s.weights[:-1, :, None] * np.eye(6), s.terminal[None]])
        cost = xp.concatenate([ends, xp.zeros((steps, n, 6))], axis=1)
        cost = xp.concatenate([cost, xp.zeros((steps, size, n))], axis=2)
        moving = xp.concatenate([xp.zeros((steps, 3, 2)), s.felt], axis=2)
        bent = xp.concatenate([xp.zeros((steps, 6)), s.bend], axis=1)
        pushed = self.effort[:, None] * moving
        cost = cost + xp.einsum("kij,kil->kjl", moving, pushed) + bent[:, :, None] * np.eye(size)
        slope = xp.einsum("kij,kj->ki", ends, s.error)
        slope = xp.concatenate([slope, xp.zeros((steps, n))], axis=1)
        slope = slope + xp.einsum("kij,ki->kj", pushed, s.excess)
        still = xp.concatenate([xp.eye(2), xp.zeros((size - 2, 2))])
        moved = xp.concatenate(
            [xp.broadcast_to(still, (steps, size, 2)), s.onward[:, :, : size - 2]], axis=2
        )
        plan = xp.ravel(s.plan)
        push = self.used * (plan - self.least)
        return (
            cost,
            slope,
            push,
            moved,
            s.onward[:, :, size - 2 :],
            s.limited,
            s.lower,
            s.upper,
            plan,
        )

    def solve(self, formed: Sequence[Float[np.ndarray, "..."]]) -> Answer | None:
        """Solve from a cold start."""
        cost, slope, push, moved, driven, limited, lower, upper, plan = formed
        if not math.isfinite(cost.sum() + slope.sum() + moved.sum()):
            return None
        ones, penalties = np.ones(lower.size), np.full(lower.size, self.penalty)
        p = self._cost.filled(np.concatenate([cost.ravel(), self.changed, penalties]))
        total = p.shape[0]
        c, least, most = np.zeros(total), np.full(total, -np.inf), np.full(total, np.inf)
        c[self._z], c[self._u], c[self._s] = slope, push.reshape(-1, self.n), self.penalty
        least[self._u] = (self.least - plan).reshape(-1, self.n)
        most[self._u] = (self.greatest - plan).reshape(-1, self.n)
        least[self._s] = 0.0
        still = np.ones(self._z.size)
        a = self._motion.filled(np.concatenate([still, -moved[1:].ravel(), -driven.ravel()]))
        rows = limited.ravel()
        g = self._limits.filled(np.concatenate([rows, -ones, rows, ones]))
        never = np.full(lower.size, _FAR)
        low = np.concatenate([-never, np.maximum(lower.ravel(), -_FAR)])
        high = np.concatenate([np.minimum(upper.ravel(), _FAR), never])
        x = self._answered(p, c, a, np.zeros(self._z.size), g, low, high, least, most)
        if x is None:
            return None
        change, moved = x[self._u], x[self._z[:, :6]]
        now = np.einsum("kci,ki->kc", limited, moved)
        at_rest = np.minimum(x - least, most - x)[self._u] < self._ACTIVE
        beyond = np.minimum(now - lower, upper - now) < self._ACTIVE
        binding = np.concatenate([at_rest.ravel(), beyond.ravel()])
        return Answer(change, moved, binding, bool((x[self._s] > self._ACTIVE).any()))

    def _answered(self, *problem: Any) -> Float[np.ndarray, " k"] | None:
        """Hand the problem to PIQP."""
        import piqp

        if self._solver is None:
            self._solver = piqp.SparseSolver()
            self._solver.settings.kkt_solver = piqp.sparse_multistage
            self._solver.settings.max_iter = self.most
            self._solver.setup(*problem)
        else:
            self._solver.update(*problem)
        solved = self._solver.solve() == piqp.PIQP_SOLVED
        return np.array(self._solver.result.x) if solved else None


SOLVERS = {"daqp": Condensed, "piqp": Multistage}
