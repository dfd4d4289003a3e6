"""Upper bounds on the integral of thrust along a weight, over all paths of yaw and yaw rate.

A dynamic program on a grid of yaws and yaw rates. Each of its values is an upper bound;
docs/planning.md has the proof, with every term that is added to round values up.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from jaxtyping import Complex, Float, Int

from airpuck.model.model_file import Model
from airpuck.physics.effects import weighted_range
from airpuck.physics.rigid_body import wrapped
from airpuck.planning.request import (
    Request,
    added_accelerations,
    largest_moment,
    motor_range,
    pushes,
    strongest_thrust,
    thrust_range,
)

#: Curvature of the penalty on other yaws at the start, relative to the strongest push times ∫|w|.
#: The bounds of three plans are highest between 1 and 4.
_PENALTY = 2.0
#: A value below everything reachable, and below any sum of values.
_IMPOSSIBLE = -1e30
#: Number of lags after which motors may have any speed.
_SETTLED = 8.0
#: Number of parts of a step over which thrusts are summed.
_PARTS = 32
#: Number of float32 rounding errors in each step, of 2⁻²⁴ each: four for a turn, two for a push,
#: and a reserve.
_ROUNDINGS = 10 * 2.0**-24
#: Number of steps after which the rounding of yaw rates is re-randomised, so that its error stops
#: accumulating.
_REDRAWN = 16
#: A motor turns the craft if its lever exceeds this fraction of the longest lever.
_TURNS = 1e-9
#: Fewest intervals between the columns of yaw rate.
_FEWEST_COLUMNS = 8
#: Floors that avoid a division by zero for a craft that cannot turn: of an angular acceleration
#: [rad/s²] or its change of the yaw rate in a step [rad/s], and of the reachable yaw rates [rad/s].
LEAST_MOMENT, _LEAST_REACH = 1e-9, 1e-6
#: A gain below this fraction of `_IMPOSSIBLE` marks a moment out of reach.
_SMALLEST_SHARE = 1e-15


@dataclass(frozen=True, eq=False)
class Weight:
    """A continuous, piecewise linear weight w(t) = α + β t + Σ κⱼ (t - tⱼ)⁺, as complex numbers."""

    alpha: complex
    beta: complex
    kink_times: Float[np.ndarray, " J"] = field(default_factory=lambda: np.zeros(0))
    kinks: Complex[np.ndarray, " J"] = field(default_factory=lambda: np.zeros(0, complex))
    #: Value of another radian of yaw at the start: the slope of the penalty on other initial yaws.
    yaw_price: float = 0.0

    @classmethod
    def fitted(
        cls,
        times: Float[np.ndarray, " K"],
        values: Complex[np.ndarray, " K"],
        kink_times: Float[np.ndarray, " J"],
        yaw_price: float = 0.0,
    ) -> Weight:
        """Fit a weight to values by least squares."""
        basis = [np.ones_like(times), times, *(np.maximum(times - t, 0.0) for t in kink_times)]
        fit = np.linalg.lstsq(np.array(basis, dtype=complex).T, values, rcond=None)[0]
        return cls(complex(fit[0]), complex(fit[1]), kink_times, fit[2:], yaw_price)

    def compressed(self, share: float) -> Weight:
        """Return the weight for a flight that takes a fraction of the time."""
        return replace(
            self,
            beta=self.beta / share,
            kink_times=self.kink_times * share,
            kinks=self.kinks / share,
        )

    def __call__(self, times: Float[np.ndarray, " K"]) -> Complex[np.ndarray, " K"]:
        """Evaluate the weight."""
        since = np.maximum(times - self.kink_times[:, None], 0.0)
        return self.alpha + self.beta * times + self.kinks @ since

    def slope(self, times: Float[np.ndarray, " K"]) -> Complex[np.ndarray, " K"]:
        """Evaluate its derivative just before a time."""
        return self.beta + self.kinks @ (times > self.kink_times[:, None])


@dataclass(frozen=True)
class Fineness:
    """Resolution of time, yaw rate and yaw; any gives a bound, a finer one gives a higher bound."""

    steps: int
    #: Number of columns of yaw rate that the largest moment crosses in a step, and largest number
    #: of columns.
    moments: int
    columns: int
    yaws: int


class YawProgram:
    """Bounds ∫ w·a for flights that reach the goal's yaw and yaw rate after each step, or coast.

    Yaw turns by the mean yaw rate of a step. Between one mean and the next, push and moment are
    averages around the end of a step. Both are exact for any thrusts in between.

    Attributes
    ----------
    step : float
        Step between the times at which flights may end [s].
    weight : Weight
        Weight with its kinks at ends of steps.
    worth : float
        The strongest push times ∫ |w|: the bound of a craft that need not turn.
    most : array, shape (steps, T)
        The bound at the end of each step later than `since`, for flights that have coasted for
        each of the coasting times.
    """

    def __init__(
        self,
        request: Request,
        weight: Weight,
        horizon: float,
        fineness: Fineness,
        coasts: Float[np.ndarray, " T"],
        since: float = 0.0,
    ) -> None:
        self._request, self._model = request, request.model
        self.step = horizon / fineness.steps
        # Kinks move to the nearest ends of steps.
        kinks = self.step * np.round(weight.kink_times / self.step)
        self.weight = replace(weight, kink_times=kinks)
        self._count = fineness.steps
        self._values = self.weight(self.step * np.arange(self._count + 1))
        self._size = np.abs(self._values)
        self._added = added_accelerations(request.model, request.limits)
        self._largest = largest_moment(request.model, request.limits)
        self._spins = self._columns(horizon, fineness)
        anchor = request.goal.state[2]
        anchor = float(request.start[2] if np.isnan(anchor) else anchor)
        self._yaws = anchor + 2 * np.pi * np.arange(fineness.yaws) / fineness.yaws
        self._boxes = self._thrusts()
        low, high = self._boxes[0][:, -1:], self._boxes[1][:, -1:]
        self._strongest = float(strongest_thrust(self._model, low, high)[0])
        self.worth = float(self.step * self._size.sum()) * (self._strongest + self._added[0])
        self.most = self._run(coasts, since)

    def _columns(self, horizon: float, fineness: Fineness) -> Float[np.ndarray, " S"]:
        """Lay columns over all reachable yaw rates; the extremes are columns."""
        begin, limit = float(self._request.start[5]), self._request.limits.spin
        reach = max(self._largest * horizon, _LEAST_REACH)
        low, high = max(-limit, begin - reach), min(limit, begin + reach)
        wanted = (high - low) * fineness.moments / max(self._largest * self.step, LEAST_MOMENT)
        count = int(np.clip(np.ceil(wanted), _FEWEST_COLUMNS, fineness.columns))
        return np.linspace(low, high, count + 1)

    def _thrusts(self) -> tuple[Float[np.ndarray, "n K"], Float[np.ndarray, "n K"]]:
        """Return bounds of the motors' mean thrusts around the ends of steps.

        Ranges grow with time, so the end of each part of a step is valid for all of it. Zero thrust
        is always included.
        """
        model, step = self._model, self.step
        settled = _SETTLED * float(model.dynamics.motor_time_constant)
        times = step * np.arange(1, (self._count + 1) * _PARTS + 1) / _PARTS
        times = np.where(times > settled, np.inf, times)
        few = min(int(np.isfinite(times).sum()) + 1, len(times))
        speeds = motor_range(model, self._request.start[6:], times[:few])
        ranges = thrust_range(model, speeds, self._request.limits)
        # Weights of a triangle over two steps, half of it at the start.
        rising = (np.arange(_PARTS) + 0.5) / _PARTS**2
        boxes = []
        for force, least in zip(ranges, (np.minimum, np.maximum), strict=True):
            force = np.pad(least(force, 0.0), ((0, 0), (0, len(times) - few)), mode="edge")
            parts = force.reshape(len(force), self._count + 1, _PARTS)
            after, before = parts @ rising[::-1], parts @ rising
            mean = after.copy()
            mean[:, 1:] = (after[:, 1:] + before[:, :-1]) / 2
            boxes.append(2 * mean)
        return boxes[0], boxes[1]

    def _run(self, coasts: Float[np.ndarray, " T"], since: float) -> Float[np.ndarray, "K T"]:
        """Step forwards in time: turn, read off the value at the goal, push."""
        step, unit = self.step, self._spins[1] - self._spins[0]
        turn = _Turn(self._spins * step, len(self._yaws))
        added = self._between_nodes()
        side = int(np.ceil(self._largest * step / unit)) + 2
        changes = np.arange(-side, side + 1)
        worth, steepest = self._begin()
        bends = [steepest]
        most = np.full((self._count, len(coasts)), _IMPOSSIBLE)
        for k in range(1, self._count + 1):
            worth = turn(worth) + added[k - 1, :, None]
            if k * step > since:
                most[k - 1] = self._goal_worth(worth, k, coasts)
            if k < self._count:
                gains = self._gains(k, self._yaws, changes * unit / step, k % _REDRAWN == 0)
                bends.append(_steepest(gains, self._yaws) * self._size[k] * step)
                push = (step * self._size[k] * gains.T).astype(np.float32)
                worth = _pushed(worth, push, changes)
        return most + self._roundings(np.array(bends), unit, coasts)[:, None]

    def _penalty(self) -> tuple[Float[np.ndarray, " Y"], float]:
        """Return the cost of other initial yaws, at each yaw of the grid, and its curvature."""
        curvature = _PENALTY * self.worth + abs(self.weight.yaw_price)
        away = wrapped(np, self._yaws - self._request.start[2])
        turns = away + 2 * np.pi * np.array([-1.0, 0.0, 1.0])[:, None]
        cost = -self.weight.yaw_price * turns - curvature / 2 * turns**2
        return cost.max(axis=0), curvature

    def _begin(self) -> tuple[Float[np.ndarray, "S Y"], float]:
        """Return the value after the first half of a push, and the slope of its gain."""
        moments = (self._spins - self._request.start[5]) * 2 / self.step
        gains = self._gains(0, self._yaws, moments)
        first = self._size[0] * self.step / 2
        worth = self._penalty()[0] + first * gains.T
        return worth.astype(np.float32), _steepest(gains, self._yaws) * first

    def _between_nodes(self) -> Float[np.ndarray, "K S"]:
        """Return how far chords between the ends of steps may underestimate w turned by the yaw."""
        step, spins, largest = self.step, self._spins, self._largest
        size = np.maximum(self._size[1:], self._size[:-1])[:, None]
        slope = (np.abs(np.diff(self._values)) / step)[:, None]
        bent = size * (spins**2 + largest) + 2 * slope * np.abs(spins)
        missed = self._strongest * step**3 / 12 * bent
        if self._model.dynamics.frame == "world":
            # Bound the acceleration r ω² due to an offset; the rest is in `certificate`.
            offset = float(np.hypot(*self._model.dynamics.center_of_mass))
            missed = missed + step * offset * size * (spins**2 + (largest * step) ** 2 / 12)
        return missed.astype(np.float32)

    def _roundings(
        self, bends: Float[np.ndarray, " K"], unit: float, coasts: Float[np.ndarray, " T"]
    ) -> Float[np.ndarray, " K"]:
        """Return the possible cost of rounding to the grid, for flights of each length."""
        passed = np.arange(self._count + 1)
        spacing = self._yaws[1] - self._yaws[0]
        shift = self.step * unit
        variance = (passed + 1) * spacing**2 / 4 + _REDRAWN * passed * shift**2 / 4
        # The final yaw is first rounded to one of two neighbouring coasting times.
        coasted = np.diff(coasts).max(initial=0.0) * np.nan_to_num(self._request.goal.state[5])
        variance += coasted**2 / 4
        curved = self.step * self._size * self._strongest / 2
        lost = np.convolve(curved, variance)[1 : self._count + 1]
        lost += np.convolve(bends / 4, np.minimum(passed, _REDRAWN) * shift)[1 : self._count + 1]
        lost += self._penalty()[1] / 2 * variance[1:]
        largest = 2 * (self.worth + abs(self.weight.yaw_price))
        return lost + _ROUNDINGS * passed[1:] * largest

    def _gains(
        self,
        k: int,
        yaws: Float[np.ndarray, " Y"],
        moments: Float[np.ndarray, " M"],
        redrawn: bool = False,
    ) -> Float[np.ndarray, "Y M"]:
        """Return the push along the weight at the end of a step, for evenly spaced moments."""
        low, high = (force[:, k] for force in self._boxes)
        angles = yaws - float(np.angle(self._values[k]))
        return frontier(self._model, angles, low, high, moments, self._added, redrawn)

    def _goal_worth(
        self, worth: Float[np.ndarray, "S Y"], k: int, coasts: Float[np.ndarray, " T"]
    ) -> Float[np.ndarray, " T"]:
        """Read off the value of flights that end now, after the second half of a push."""
        goal, half = self._request.goal.state, self._size[k] * self.step / 2
        count, spacing = len(self._yaws), self._yaws[1] - self._yaws[0]
        turned = coasts * goal[5] / spacing
        if np.isnan(goal[2]):
            rows = np.arange(count)
        else:  # the first yaw of the grid is the goal's yaw
            far = self._request.limits.spin * coasts[-1] / spacing * np.array([-1, 1])
            far = far if np.isnan(goal[5]) else np.array([turned.min(), turned.max()])
            rows = np.arange(int(np.floor(far[0])), int(np.ceil(far[1])) + 2)
        yaws, ending = self._yaws[rows % count], worth[:, rows % count].T
        if np.isnan(goal[5]):
            # Any moment is allowed, so each motor does what pushes most.
            push = pushes(self._model, yaws - float(np.angle(self._values[k])))
            best = weighted_range(push, *(force[:, k] for force in self._boxes))[1] + self._added[0]
            return np.full(len(coasts), (ending.max(axis=1) + half * best).max())
        moments = (goal[5] - self._spins) * 2 / self.step
        # Columns are in ascending order, these moments in descending order.
        ended = ending + half * self._gains(k, yaws, moments[::-1])[:, ::-1]
        if np.isnan(goal[2]):
            return np.full(len(coasts), ended.max())
        near = np.floor(turned).astype(int) - rows[0]
        share = (turned - np.floor(turned))[:, None]
        return ((1 - share) * ended[near] + share * ended[near + 1]).max(axis=1)


class _Turn:
    """Turns the craft by an angle for each column of yaw rate, interpolating linearly."""

    def __init__(self, angles: Float[np.ndarray, " S"], yaws: int) -> None:
        back = -angles / (2 * np.pi) * yaws
        whole = np.floor(back).astype(int)
        self._share = (back - whole).astype(np.float32)[:, None]
        columns = (np.arange(yaws) + whole[:, None]) % yaws
        first = yaws * np.arange(len(angles))[:, None]
        self._near, self._next = first + columns, first + (columns + 1) % yaws

    def __call__(self, worth: Float[np.ndarray, "S Y"]) -> Float[np.ndarray, "S Y"]:
        """Return the value after the turn."""
        near, share = worth.take(self._near), self._share
        return near + share * (worth.take(self._next) - near)


def _pushed(
    worth: Float[np.ndarray, "S Y"], gain: Float[np.ndarray, "B Y"], changes: Int[np.ndarray, " B"]
) -> Float[np.ndarray, "S Y"]:
    """Let the motors push and turn: the best over all moments."""
    best = np.full_like(worth, _IMPOSSIBLE)
    count = len(worth)
    for push, change in zip(gain, changes, strict=True):
        if push[0] < _IMPOSSIBLE * _SMALLEST_SHARE or abs(change) >= count:
            continue
        to, of = (
            slice(max(change, 0), count + min(change, 0)),
            slice(max(-change, 0), count - max(change, 0)),
        )
        np.maximum(best[to], worth[of] + push, out=best[to])
    return best


def _steepest(gains: Float[np.ndarray, "Y M"], yaws: Float[np.ndarray, " Y"]) -> float:
    """Return how much the difference of neighbouring moments' gains can change with the yaw."""
    differences = np.diff(gains[:, gains[0] > _IMPOSSIBLE], axis=1)
    changes: Any = differences - np.roll(differences, 1, axis=0)
    return float(np.abs(changes).max(initial=0.0)) / float(yaws[1] - yaws[0])


def frontier(
    model: Model,
    angles: Float[np.ndarray, " Y"],
    low: Float[np.ndarray, " n"],
    high: Float[np.ndarray, " n"],
    moments: Float[np.ndarray, " M"],
    added: tuple[float, float],
    redrawn: bool = False,
) -> Float[np.ndarray, "Y M"]:
    """Bound the push at each angle to its direction and each moment, with one linear program each.

    The dual has one unknown μ: min over μ of max over F of (push + μ turn)·F - μ moment. The slope
    of the maximum jumps where one term changes sign, from the lowest moment to the highest, so its
    minimum lies at the jump across the moment. `added` bounds accelerations other than thrust. The
    chords between evenly spaced moments lie above the values in between; moments beyond the first
    infeasible moment are unreachable.
    """
    turn, push = np.asarray(model.dynamics.configuration)[2], pushes(model, angles)
    # Any prices give a bound; prices of motors that barely turn the craft are only rounding errors.
    turns = np.abs(turn) > _TURNS * np.abs(turn).max()
    prices = np.where(turns, -push / np.where(turns, turn, 1.0), 0.0)
    prices = np.append(prices, np.zeros((len(angles), 1)), axis=1)
    order = np.argsort(prices, axis=1)
    prices = np.take_along_axis(prices, order, axis=1)
    terms = (push[:, None, :] + prices[:, :, None] * turn).reshape(-1, len(turn))
    ceiling = weighted_range(terms, low, high)[1].reshape(prices.shape) + np.abs(prices) * added[1]
    least, most = weighted_range(turn, low, high)
    jumps = np.append(np.abs(turn) * (high - low), 2 * added[1])[order[:, :-1]]
    spacing = moments[1] - moments[0]
    place = np.ceil((least - added[1] + np.cumsum(jumps, axis=1) - moments[0]) / spacing)
    place = np.clip(place, 0, len(moments)).astype(int)
    counts = np.diff(place, axis=1, prepend=0, append=len(moments)).ravel()
    shape = len(angles), len(moments)
    slopes = -np.repeat(prices, counts).reshape(shape)
    table = np.repeat(ceiling, counts).reshape(shape) + slopes * moments
    # Tangents at the ends of a chord meet above all values in between.
    chord = np.diff(table, axis=1) / spacing
    above, below = np.maximum(slopes[:, :-1] - chord, 0.0), np.maximum(chord - slopes[:, 1:], 0.0)
    excess = above * below * spacing / np.maximum(above + below, np.finfo(float).tiny)
    sides = np.pad(excess, ((0, 0), (1, 1)))
    table += np.maximum(sides[:, 1:], sides[:, :-1]) + added[0]
    far = (2 if redrawn else 1) * spacing
    reached = (moments > least - added[1] - far) & (moments < most + added[1] + far)
    if redrawn:
        # The same holds for chords of this length that begin and end anywhere.
        wide = np.pad(slopes, ((0, 0), (2, 2)), mode="edge")
        bends = np.maximum(wide[:, :-3] - wide[:, 3:], 0.0)
        table = table + np.maximum(bends[:, 1:], bends[:, :-1]) * spacing / 4
    return np.where(reached, table, _IMPOSSIBLE)
