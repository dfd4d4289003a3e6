"""The predictive law's quadratic program for PIQP's multistage backend, to compare with DAQP."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import piqp
from jaxtyping import Float
from scipy.sparse import csc_matrix

from airpuck.control.horizon import Answer, Blocks, Sizes, Stages
from airpuck.control.predictive import PredictiveSettings
from airpuck.craft.vehicle import Vehicle

#: A bound that nothing reaches [m, m/s, rad/s]: PIQP needs one on either side of every row.
_FAR = 1e6


class _Pattern:
    """A sparse matrix with fixed positions and changing values."""

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
        return csc_matrix((values[self._order], self._rows, self._starts), shape=self._shape)


class Multistage(Sizes):
    """PIQP with all states as variables, whose multistage backend goes through them in turn.

    It starts cold each time, so its time does not depend on the plan.
    """

    _ACTIVE = 1e-6

    def __init__(
        self, vehicle: Vehicle, blocks: Blocks, settings: PredictiveSettings, count: int
    ) -> None:
        super().__init__(vehicle, blocks, settings)
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
        if self._solver is None:
            self._solver = piqp.SparseSolver()
            self._solver.settings.kkt_solver = piqp.sparse_multistage
            self._solver.settings.max_iter = self.most
            self._solver.setup(*problem)
        else:
            self._solver.update(*problem)
        solved = self._solver.solve() == piqp.PIQP_SOLVED
        return np.array(self._solver.result.x) if solved else None
