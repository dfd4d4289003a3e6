"""Solver of the predictive law's quadratic program (`airpuck.control.horizon.Stages`).

It has two parts: `form` lays the problem out, a pure function that is compiled with what comes
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

#: Cost of a squared change of a command, apart from its effect. The linearisation holds only near
#: the plan: without this cost, plans of a craft that turns fast jump between two ways to brake.
_DAMPING = 0.5


@dataclass(frozen=True, eq=False)
class Answer:
    """A solution."""

    #: Change of the plan.
    change: Float[np.ndarray, "B n"]
    #: Resulting changes of x, y, γ and their rates at the ends of the steps.
    moved: Float[np.ndarray, "N 6"]
    #: Active limits: of the commands, block by block; then of the states, step by step.
    binding: Bool[np.ndarray, " r"]
    #: Whether a limit of the states is exceeded.
    exceeded: bool


class Sizes:
    """Sizes and weights of the program."""

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
        """Return everything except the solver's memory: the key of a compiled `form`."""
        return {k: v for k, v in vars(self).items() if k not in ("_model", "_solver", "_astray")}


#: How DAQP treats a limit.
_HARD, _SOFT = 0, 8
#: DAQP's exit flags for a solution within all limits, and for one beyond soft limits.
_OPTIMAL, _SOFTENED = 1, 2


class Condensed(Sizes):
    """DAQP on the commands alone, started from the last active set."""

    def __init__(self, vehicle: Vehicle, blocks: Blocks, regulator: Regulator, count: int) -> None:
        super().__init__(vehicle, blocks, regulator)
        import daqp

        n, rows = self.n, count * len(blocks.owner)
        #: Maps all commands to the commands of a step.
        self._each = np.zeros((len(blocks.owner), n, self.m))
        for k, block in enumerate(blocks.owner):
            self._each[k, :, block * n : (block + 1) * n] = np.eye(n)
        self._senses = np.repeat([_HARD, _SOFT], [self.m, rows]).astype(np.intc)
        # Any feasible numbers will do here: DAQP allocates its memory for their sizes.
        empty = np.eye(self.m), np.zeros(self.m), np.zeros((rows, self.m))
        one = np.ones(self.m + rows)
        self._model = daqp.Model()
        self._model.setup(*empty, one, -one, self._senses)
        self._model.settings = {"iter_limit": self.most}
        self._astray = False
        # A violation s costs w s + w s²/2. DAQP's own setting for all rows applies to scaled rows.
        linear, curved = self.penalty * one, one / self.penalty
        self._model.soft_weights(rho_l=curved, rho_u=curved, w_l=linear, w_u=linear)

    def form(self, xp: Any, s: Stages) -> tuple[Any, ...]:
        """Eliminate the states: return Hessian, gradient, rows, bounds and the states."""
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
        """Solve from the last active set; start cold if the last attempt failed."""
        hessian, gradient, rows, lower, upper, pose = formed
        if not math.isfinite(hessian.sum() + gradient.sum() + rows.sum()):
            return None
        given = {"H": hessian, "f": gradient, "A": rows, "bupper": upper, "blower": lower}
        # The active set of a very different problem can make DAQP cycle. After a cold start that
        # ran out of iterations, however, its active set is worth continuing from. There is one
        # attempt per period, so the time stays bounded.
        start = {"sense": self._senses} if self._astray else {}
        if self._model.update(**given, **start) >= 0:
            x, _, flag, info = self._model.solve()
            if flag in (_OPTIMAL, _SOFTENED):
                self._astray = False
                binding, exceeded = info["lam"] != 0, flag == _SOFTENED
                return Answer(x.reshape(-1, self.n), pose @ x, binding, exceeded)
        self._astray = not self._astray
        return None
