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


@dataclass(frozen=True, eq=False)
class Answer:
    """A solution."""

    #: Of the plan.
    change: Float[np.ndarray, "B n"]
    #: Which limits it is at: of the commands, block by block; then of the states, step by step.
    binding: Bool[np.ndarray, " r"]
    #: Whether a limit of the states is exceeded.
    exceeded: bool


class _Common:
    """Sizes and weights that both solvers use."""

    def __init__(self, vehicle: Vehicle, blocks: Blocks, regulator: Regulator) -> None:
        w, n = regulator.weights, vehicle.n_propellers
        self.blocks, self.n, self.m = blocks, n, n * len(blocks.lengths)
        self.most = regulator.iterations
        self.penalty = regulator.limits.penalty
        #: Weights of accelerations and commands.
        efforts = np.array([w.acceleration, w.acceleration, w.angular_acceleration])
        self.effort = efforts * blocks.step
        self.used = np.repeat(w.command * blocks.step * np.array(blocks.lengths), n)
        self.least, self.greatest = vehicle.command_min, vehicle.command_max


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
        soft = np.repeat([0, 8], [self.m, rows]).astype(np.intc)
        # Any feasible numbers will do here: the memory is set up for their sizes.
        low, high = np.full(self.m + rows, -1.0), np.ones(self.m + rows)
        self._model = daqp.Model()
        self._model.setup(
            np.eye(self.m), np.zeros(self.m), np.zeros((rows, self.m)), high, low, soft
        )
        self._model.settings = {
            "iter_limit": self.most,
            "w_soft": self.penalty,
            "rho_soft": 1 / self.penalty,
        }

    def form(self, xp: Any, s: Stages) -> tuple[Any, ...]:
        """Leave the states out: Hessian, gradient, rows, lower and upper bounds."""
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
        hessian = product @ xp.concatenate(rows[3:]) + xp.diag(self.used)
        plan = xp.ravel(s.plan)
        gradient = product[:, : len(left)] @ left + self.used * (plan - self.least)
        limited = (s.limited @ pose).reshape(-1, m)
        lower = xp.concatenate([self.least - plan, xp.ravel(s.lower)])
        upper = xp.concatenate([self.greatest - plan, xp.ravel(s.upper)])
        return hessian, gradient, limited, lower, upper

    def solve(self, formed: Sequence[Float[np.ndarray, "..."]]) -> Answer | None:
        """Solve from the last active set."""
        hessian, gradient, rows, lower, upper = formed
        model = self._model
        if not math.isfinite(hessian.sum() + gradient.sum() + rows.sum()):
            return None
        if model.update(H=hessian, f=gradient, A=rows, bupper=upper, blower=lower) < 0:
            return None
        x, _, flag, info = model.solve()
        if flag not in (_OPTIMAL, _SOFTENED):
            return None
        return Answer(x.reshape(-1, self.n), info["lam"] != 0, flag == _SOFTENED)


SOLVERS = {"daqp": Condensed}
