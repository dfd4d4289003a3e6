"""Predictive control: limits of motors, rails and time inside the prediction.

Each step linearises the physics along the previous plan, shifted in time, and solves one quadratic
program for a better plan: the real-time iteration of Diehl, Bock and Schlöder (SIAM Journal on
Control and Optimization 43, 2005). See docs/control.md, "Predictive control".
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import lru_cache, partial
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from airpuck.boundary.errors import InputError
from airpuck.control.allocation import all_finite
from airpuck.control.horizon import Ahead, Blocks, Condensed, Stages, stages
from airpuck.control.law import Law, LawOptions, Moment, Prediction, Status, Step, staged
from airpuck.control.limits import Fence, HalfPlane, KeepOut
from airpuck.control.lqr import LQR, cost_to_go, point_mass
from airpuck.control.predictive import PredictiveSettings
from airpuck.control.reference import Arrival, Reference, SetPoint, preview
from airpuck.control.tuning import Tuning
from airpuck.craft.table import Table
from airpuck.model.model_file import Model

#: Commands of the first plan: in the middle of the thrust curves, where they are steep.
_FIRST = 0.3
#: Time for which a plan continues without an answer from the solver [s].
FLOWN_ON = 0.1
#: Largest number of decision variables; many more take longer than a period.
_MOST_COMMANDS = 200
#: Shortest time to an arrival that is used [s].
_SOON = 0.02
#: No limit, in place of a disc or a half plane.
_NO_ROW = (0.0, 0.0, 0.0, 0.0, -math.inf)


class Ongoing(NamedTuple):
    """The state of the predictive law between steps."""

    #: Commands of the latest plan, block by block, and the time from which they hold [s].
    plan: Float[np.ndarray, "blocks n"]
    since: float
    #: Time at which the solver last succeeded [s].
    answered: float
    #: Yaw still to turn, in the chosen direction of rotation [rad].
    way: Float[np.ndarray, ""]


class MPC(Law):
    """Computes the commands over the next horizon that track best within all limits.

    If the solver fails, the plan of the previous step continues for 0.1 s. After that, or without a
    plan, an `LQR` steers.

    Parameters
    ----------
    model : Model
        The craft; its thrust curves must rise.
    tuning : Tuning
        `PredictiveSettings`, and the LQR's settings.
    options : LawOptions, optional
        Options, including the table whose rails the law avoids, and the initial limits;
        the gain is for the LQR.

    Raises
    ------
    InputError
        If a thrust curve falls somewhere, if the weights give no regulator, or if there are too
        many decision variables to solve in time.

    Examples
    --------
    >>> law = airpuck.MPC(model, airpuck.default_tuning().with_law("mpc"))
    >>> controller = airpuck.TrackingController(model, airpuck.SetPoint(0.1, 0.0, 0.0), law=law)
    """

    SHOWN, Settings = "title times_s=_times fence", PredictiveSettings
    title, c_modules = "predictive control", ("mpc", "qp", "slopes")
    obeys_limits = True

    def __init__(self, model: Model, tuning: Tuning, options: LawOptions | None = None) -> None:
        options = options or LawOptions()
        #: Steers when there is no plan.
        self.fallback = LQR(model, tuning, options)
        settings, vehicle = tuning.of(PredictiveSettings), model.vehicle
        limits = settings.limits
        self._blocks = blocks = Blocks.of(settings)
        self._times = blocks.times
        decided = vehicle.n_propellers * len(blocks.lengths)
        if decided > _MOST_COMMANDS:
            raise InputError(
                f"{vehicle.n_propellers} propellers and {len(blocks.lengths)} blocks are {decided} "
                f"commands; at most {_MOST_COMMANDS} can be decided in time: use a larger block, a "
                "longer step or a shorter horizon",
                field="law.mpc.block",
            )
        count = len(self._times)
        #: Area of the craft's centre; a fence of the moment replaces it.
        self.fence = _fence(limits.fence_m, options.table, vehicle.radius_m + limits.margin_m)
        self._keep_out = [KeepOut(*disc) for disc in limits.keep_out_m]
        of_rates = {"speed": limits.speed_m_s, "spin": limits.spin_rad_s}
        self._kinds = ["rail", "rail", *(name for name, most in of_rates.items() if most)]
        self._solver = lru_cache(maxsize=8)(partial(Condensed, vehicle, blocks, settings))
        posed = stages(model, blocks, settings, options.reject_disturbance)
        #: The latest limits, and their arrays.
        self._laid_out = tuple(options.limits), self._limits(options.limits)
        fence, rows, hard = self._laid_out[1]
        self.stage = _stage(posed, self._solver(hard).form)
        errors, self._efforts = settings.weights.errors * blocks.step, settings.weights.efforts
        self._weights = np.tile(errors, (count, 1))
        parts = np.diag(errors), np.diag(self._efforts * blocks.step)
        self._terminal = cost_to_go(*point_mass(blocks.step), *parts)
        self._range = vehicle.command_min, vehicle.command_max
        first = np.full((len(blocks.lengths), vehicle.n_propellers), _FIRST)
        self._first = first.clip(*self._range)
        self.inputs, _ = self.posed(self.init(), SetPoint(0.0, 0.0, 0.0), 0.0, 0.0, fence, rows)
        self._fall_back = staged(self.fallback, model, options.compiled)

    def __setattr__(self, name: str, value: Any) -> None:
        if name == "keep_out" or (name == "fence" and name in vars(self)):
            problem = "is set by controller.limits now: [airpuck.Fence(…), airpuck.KeepOut(…), …]"
            raise InputError(problem, field=name)
        super().__setattr__(name, value)

    def _limits(
        self, given: Sequence[Any]
    ) -> tuple[Float[np.ndarray, "2 2"], Float[np.ndarray, "K 5"], tuple[bool, ...]]:
        """Return the fence, the rows of other limits, and which limits are hard.

        The number of rows is a power of two, so that few programs serve any number of limits.
        """
        fences = [limit for limit in given if isinstance(limit, Fence)]
        others = self._keep_out + [one for one in given if isinstance(one, KeepOut | HalfPlane)]
        missing = (1 << (len(others) - 1).bit_length()) - len(others) if others else 0
        rows = [one.row for one in others] + [_NO_ROW] * missing
        corners = [(f.low_x, f.low_y, f.high_x, f.high_y) for f in fences]
        corners = np.array(corners or [self.fence.ravel()])
        hard = (any(fence.hard for fence in fences),) * 2 + (False,) * (len(self._kinds) - 2)
        hard += tuple(one.hard for one in others) + (False,) * missing
        fence = np.array([corners[:, :2].max(0), corners[:, 2:].min(0)])
        return fence, np.array(rows).reshape(-1, 5), hard

    def init(self) -> Ongoing:
        """Begin with commands that are constant from time 0 on.

        Returns
        -------
        Ongoing
            The state before the first step.
        """
        return Ongoing(self._first, 0.0, -math.inf, np.zeros(()))

    def posed(
        self,
        state: Ongoing,
        reference: Reference,
        now: float,
        delay: float,
        fence: Float[np.ndarray, "2 2"],
        rows: Float[np.ndarray, "K 5"],
    ) -> tuple[tuple[np.ndarray, ...], Ongoing]:
        """Return the stage's inputs and the shifted plan; see `Law.step`."""
        if not 0 <= now - state.since <= self._times[-1]:
            state = self.init()
        elif now > state.since:
            plan = self._blocks.shifted(state.plan, now - state.since).clip(*self._range)
            state = state._replace(plan=plan)
        ahead = self._ahead(reference, now, delay)
        inputs = state.way, state.plan, *ahead, fence, rows
        return inputs, state._replace(since=now)

    def _ahead(self, reference: Reference, now: float, delay: float) -> Ahead:
        """Return targets and weights at the ends of the steps."""
        wanted = preview(reference, now, delay + self._times)
        weights, terminal = self._weights, self._terminal
        if wanted.arrival is not None:
            weights, terminal = self._to_arrive(wanted.arrival, delay)
        return Ahead(wanted.states, wanted.accelerations, weights, terminal)

    def _to_arrive(
        self, arrival: Arrival, delay: float
    ) -> tuple[Float[np.ndarray, "N 6"], Float[np.ndarray, "6 6"]]:
        """Return weights that count only the arrival."""
        # An error equal to the given precision costs as much as 1 m/s² or rad/s² for a second.
        sharp = np.tile(self._efforts, 2) / arrival.precision**2
        times, left = self._times, max(arrival.remaining - delay, _SOON)
        weights = np.zeros_like(self._weights)
        if left > times[-1]:
            return weights, _way_left(left - times[-1], self._efforts, sharp)
        # Split the weight between the two nearest ends of steps.
        after = int(np.searchsorted(times, left))
        share = 1 - (times[after] - left) / self._blocks.step
        weights[after] = share * sharp
        if after:
            weights[after - 1] = (1 - share) * sharp
        return weights, np.diag(weights[-1])

    def step(self, state: Ongoing, moment: Moment) -> tuple[Step, Ongoing]:
        """Solve the program and return the first command of the better plan.

        Parameters
        ----------
        state : Ongoing
            State from `init` or the previous step.
        moment : Moment
            As in `Law.step`.

        Returns
        -------
        step : Step
            The command.
        state : Ongoing
            State for the next step.
        """
        if (given := tuple(moment.limits)) != self._laid_out[0]:
            self._laid_out = given, self._limits(given)
        fence, rows, hard = self._laid_out[1]
        inputs, state = self.posed(state, *moment[:3], fence, rows)
        estimate, results = moment.foresee(*inputs)
        *formed, states, request, way = results
        answer = self._solver(hard).solve(formed)
        if answer is not None and all_finite(answer.change.ravel()):
            plan = (state.plan + answer.change).clip(*self._range)
            status: Status = "softened" if answer.exceeded else "optimal"
            active = self._active(answer.binding, plan.size, rows)
            ahead = Prediction(self._times, states[:, :6] + answer.moved, active)
            step = Step(plan[0].copy(), status, request, estimate, ahead)
            return step, Ongoing(plan, state.since, state.since, np.asarray(way))
        if state.since - state.answered <= FLOWN_ON:
            return Step(state.plan[0].copy(), "iteration limit", request, estimate), state
        known = moment._replace(foresee=partial(self._fall_back, estimate))
        step, _ = self.fallback.step(None, known)
        return replace(step, status="fallback") if step.flies else step, self.init()

    def _active(
        self, binding: Bool[np.ndarray, " r"], motors: int, rows: Float[np.ndarray, "K 5"]
    ) -> tuple[str, ...]:
        """Name the limits that are active somewhere in the plan; motors come first."""
        names = self._kinds + ["half plane" if row[2:4].any() else "disc" for row in rows]
        active = np.any(binding[motors:].reshape(-1, len(names)), axis=0)
        kinds = ["motor"] * bool(binding[:motors].any())
        kinds += [names[k] for k in np.flatnonzero(active)]
        return tuple(dict.fromkeys(kinds))


def _stage(
    posed: Callable[..., Stages], form: Callable[..., tuple[Any, ...]]
) -> Callable[..., tuple[Any, ...]]:
    """Combine two functions: one poses the problem, the other lays it out for a solver.

    A function instead of a method, so that another law of the same craft reuses the compiled
    program.
    """

    def stage(xp: Any, *given: Any) -> tuple[Any, ...]:
        problem = posed(xp, *given)
        return *form(xp, problem), problem.states, problem.accelerations[0], problem.way

    return stage


def _fence(
    given: tuple[float, float, float, float] | None, table: Table, radius: float
) -> Float[np.ndarray, "2 2"]:
    """Return the corners of the craft centre's area; the table's centre if that is empty."""
    x, y = table.reach(radius)
    corners = np.array(given or (-x, -y, x, y)).reshape(2, 2)
    middle = corners.mean(axis=0)
    return np.array([np.minimum(corners[0], middle), np.maximum(corners[1], middle)])


def _way_left(
    left: float, efforts: Float[np.ndarray, " 3"], sharp: Float[np.ndarray, " 6"]
) -> Float[np.ndarray, "6 6"]:
    """Return the weight of an error at a time before an arrival: its lowest possible cost.

    The cost is the effort r ∫a² plus the remaining error at the arrival, weighted by S =
    diag(sharp). In the time T, accelerations move a double integrator by amounts with the Gramian W
    = [T³/3, T²/2; T²/2, T]. If it would arrive with an error e, the lowest cost is eᵀ √S (1 + √S W
    √S / r)⁻¹ √S e.
    """
    root = np.sqrt(sharp.reshape(2, 3).T)
    moved = np.array([[left**3 / 3, left**2 / 2], [left**2 / 2, left]]) / efforts[:, None, None]
    paid = np.linalg.inv(np.eye(2) + root[:, :, None] * moved * root[:, None])
    drift = np.array([[1.0, left], [0.0, 1.0]])
    each = drift.T @ (root[:, :, None] * paid * root[:, None]) @ drift
    weight = np.zeros((6, 6))
    for axis in range(3):
        weight[axis::3, axis::3] = each[axis]
    return weight
