"""A time that no control undercuts: weak duality, with the yaw's dynamics solved globally.

For any weight w(t) in the plane, integration by parts turns what a flight must have reached into
what its thrusts must have given, ∫ w·a dt. The most that any thrusts can give, over all paths of
yaw and spin, follows from dynamic programming in these two. A duration at which the most is less
than what is needed is impossible. See docs/planning.md for proofs and for what is left out.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from jaxtyping import Complex, Float

from airpuck.model.model_file import Model
from airpuck.planning.attainable import (
    IMPOSSIBLE,
    YAWS,
    frontier,
    largest_moment,
    motor_range,
    slope_of_table,
    strongest_push,
    thrust_range,
    unaccounted,
)
from airpuck.planning.request import Goal, Limits, Request

#: Steps of time up to the duration of the plan; moments to either side; columns of spin.
_STEPS, _MOMENTS, _COLUMNS = 72, 11, 240
#: Share of the time that is taken off for the discretisation (docs/planning.md).
MARGIN = 0.002
#: Bounds of shorter flights are not claimed: the steps of time are coarse against the motors' lag
#: there, and some random flights were faster [s].
_SHORTEST = 0.2
#: Lags after which motors may have any speed.
_SETTLED = 8.0
#: Parts of a step over which thrusts are averaged.
_PARTS = 8
#: Share of a plan's duration at which refutations begin; weights that may raise the bound, and that
#: may close gaps below it.
_FIRST, _IMPROVEMENTS, _MOST_TRIES = 0.98, 2, 14
#: Durations for which a leg between way points is tried, as shares of the plan's, which has turns.
_SHARES_OF_LEG = np.linspace(1.0, 0.4, 11)


@dataclass(frozen=True, eq=False)
class Weight:
    """A continuous, piecewise linear weight w(t) = α + β t + Σ κⱼ (t - tⱼ)⁺, as complex numbers."""

    alpha: complex
    beta: complex
    kink_times: Float[np.ndarray, " J"]
    kinks: Complex[np.ndarray, " J"]
    #: What a difference of yaw, and of spin, from the start's may be worth.
    yaw_price: float
    spin_price: float

    @classmethod
    def fitted(
        cls,
        times: Float[np.ndarray, " K"],
        values: Complex[np.ndarray, " K"],
        kink_times: Float[np.ndarray, " J"],
        prices: tuple[float, float],
    ) -> Weight:
        """Fit a weight to values, by least squares."""
        basis = [np.ones_like(times), times, *(np.maximum(times - t, 0.0) for t in kink_times)]
        fit = np.linalg.lstsq(np.array(basis, dtype=complex).T, values, rcond=None)[0]
        return cls(complex(fit[0]), complex(fit[1]), kink_times, fit[2:], *prices)

    def compressed(self, share: float) -> Weight:
        """Return the weight of a flight that takes this share of the time."""
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
        """Evaluate its derivative, just before a time."""
        return self.beta + self.kinks @ (times > self.kink_times[:, None])


def lower_bound(request: Request, weight: Weight, duration: float) -> float:
    """Find a time that no control of these motors can undercut.

    Parameters
    ----------
    request : Request
        What is asked for; its reserve is not kept here, and way points and discs are not seen.
    weight : Weight
        Of accelerations over time; any gives a true bound, the costates of a good plan a high one.
    duration : float
        Of a plan that meets the request [s].

    Returns
    -------
    float
        A duration [s] below which every one is refuted; zero where none was, or less than 0.2 s.
    """
    times = duration * np.arange(1, _STEPS + 1) / _STEPS
    step = duration / _STEPS
    refuted = np.zeros(_STEPS, dtype=bool)
    share, top = _FIRST, 0.0
    for number in range(_MOST_TRIES):
        tried = weight.compressed(share)
        missing = _needed(request, tried, times) - _most(request, tried, step)
        refuted |= missing > 0
        # The end of the run of refuted times in which the weight's own duration lies.
        own = min(round(share * _STEPS), _STEPS) - 1
        while own >= 0 and missing[own] <= 0:
            own -= 1
        while own + 1 < _STEPS and missing[own + 1] > 0:
            own += 1
        end = times[own] if own >= 0 else 0.0
        if 0 <= own < _STEPS - 1:
            end += step * missing[own] / (missing[own] - missing[own + 1])
        better, top = end > 1.0005 * top, max(top, end)
        below = np.flatnonzero(~refuted[: int(top / step)])
        if better and number < _IMPROVEMENTS:
            share = max(top / duration, 0.3)
        elif len(below):
            share = (below[-1] + 1) / _STEPS
        else:
            break
    below = np.flatnonzero(~refuted[: int(top / step)])
    if len(below):
        top = times[below[0] - 1] if below[0] else 0.0
    return float(top) * (1 - MARGIN) if top >= _SHORTEST else 0.0


def lower_bound_through(request: Request, durations: Float[np.ndarray, " legs"]) -> float:
    """Find a time that no control undercuts that passes way points in order.

    The larger of two: of a flight that need not pass them; and of the first leg, with any velocity
    at its end, together with the last, flown backwards from the goal.
    """
    direct = replace(request, via=request.via[:0])
    goal = request.goal.state
    total = float(durations.sum())
    whole = lower_bound(direct, _straight(direct, goal[:2], total, rest=True), total)
    point = request.via[0]
    onward = replace(direct, goal=Goal(float(point[0]), float(point[1]), velocity=None))
    time = float(durations[0])
    first, last = _of_leg(onward, point, time), 0.0
    if not np.isnan(goal).any():
        # Backwards in time velocities turn round, accelerations do not; motors may do anything.
        n, point, time = len(request.start) - 6, request.via[-1], float(durations[-1])
        motors = np.full(n, request.model.vehicle.command_max)
        state = np.concatenate([goal[:3], -goal[3:], motors])
        place = Goal(float(point[0]), float(point[1]), velocity=None)
        backwards = replace(direct, start=state, goal=place)
        last = _of_leg(backwards, point, time)
    return max(whole, first + last)


def _of_leg(request: Request, to: Float[np.ndarray, " 2"], duration: float) -> float:
    """Find a time for a leg that may end at any velocity; that of a plan may be much longer."""
    for time in duration * _SHARES_OF_LEG:
        found = lower_bound(request, _straight(request, to, time), time)
        if found > 0:
            return found
    return 0.0


def unavoidable_rail(request: Request) -> str | None:
    """Return the axis along which the craft hits a rail whatever it does; None if that is not sure.

    At time t it is where it drifts to, less ∫ (t - s) times what thrusts give against the motion;
    `_most` bounds the integral for this yaw and spin at the start.
    """
    anywhere = replace(request, goal=Goal(0.0, 0.0, velocity=None), via=request.via[:0])
    for axis, normal in enumerate((1.0, 1j)):
        speed = float(request.start[3 + axis])
        outwards = float(np.sign(speed))
        room = request.reach[axis] - outwards * float(request.start[axis])
        if not (outwards and np.isfinite(room)):
            continue
        strongest = float(strongest_push(request, np.array([np.inf]))[0])
        for share in (1.0, 1.2, 1.5):
            time = share * abs(speed) / strongest
            against, none = -outwards * normal, np.zeros(0)
            prices = strongest * time**2, strongest * time**2
            weight = Weight(against * time, -against, none, none.astype(complex), *prices)
            most = float(_most(anywhere, weight, time / _STEPS)[-1])
            tilted = abs(slope_of_table(request.model)) * time**2 / 2
            offset = 2 * float(np.hypot(*request.model.dynamics.center_of_mass))
            offset *= 1 + request.limits.spin * time
            if abs(speed) * time - most - tilted - offset > room:
                return "xy"[axis]
    return None


def _straight(
    request: Request, to: Float[np.ndarray, " 2"], duration: float, *, rest: bool = False
) -> Weight:
    """Return the weight of a straight flight, which brakes half way or not at all."""
    way = complex(*(to - request.start[:2]))
    along = way / abs(way) if way else 0j
    stop = duration / 2 if rest else duration
    strongest = float(strongest_push(request, np.array([np.inf]))[0])
    worth = strongest * duration**2 / 2
    none = np.zeros(0)
    return Weight(along * stop, -along, none, none.astype(complex), worth, 0.1 * worth)


def _needed(
    request: Request, weight: Weight, times: Float[np.ndarray, " K"]
) -> Float[np.ndarray, " K"]:
    """Return what ∫ w·a over thrusts must at least be, for the goal to be reached at each time.

    ∫ w·a = [w·v] - ∫ w'·v, where a piecewise constant w' leaves positions at the ends and at the
    kinks, of which the rails bound the latter.
    """
    model, limits = request.model, request.limits
    position, speed, _, _ = _center_of_mass(model, request.start[:6])
    goal, goal_speed, place_error, speed_error = _center_of_mass(
        model, request.goal.state, limits.spin
    )
    end: Any = weight(times)
    slope: Any = weight.slope(times)
    start, first = weight(np.zeros(1))[0], weight.beta
    needed = _dot(first, position) - _dot(start, speed) - _dot(slope, goal)
    needed = needed - np.abs(slope) * place_error - np.abs(end) * speed_error
    if np.isnan(goal_speed):
        needed = needed - limits.speed * (np.abs(end.real) + np.abs(end.imag))
    else:
        needed = needed + _dot(end, goal_speed)
    offset = float(np.hypot(*model.dynamics.center_of_mass))
    passed = times > weight.kink_times[:, None]
    for kink, after in zip(weight.kinks, passed, strict=True):
        room = abs(kink.real) * request.reach[0] + abs(kink.imag) * request.reach[1]
        needed = needed - after * (room + abs(kink) * offset)
    # A tilted table pushes, too.
    tilt = slope_of_table(model)
    if tilt:
        fine = np.linspace(0, times[-1], 2001)
        pushed = _dot(weight(fine), tilt)
        total = np.concatenate([[0.0], np.cumsum((pushed[1:] + pushed[:-1]) / 2 * np.diff(fine))])
        needed = needed - np.interp(times, fine, total)
    return needed


def _center_of_mass(
    model: Model, state: Float[np.ndarray, " 6"], spin_limit: float = 0.0
) -> tuple[complex, complex, float, float]:
    """Return position and velocity of the centre of mass, and how far off they may be."""
    position, speed = complex(state[0], state[1]), complex(state[3], state[4])
    if model.dynamics.frame == "world":
        return position, speed, 0.0, 0.0  # `unaccounted` counts the offset there
    offset = complex(*(float(v) for v in model.dynamics.center_of_mass))
    if np.isnan(state[2]):
        spin = spin_limit if np.isnan(state[5]) else abs(state[5])
        return position, speed, abs(offset), abs(offset) * spin
    turned = offset * np.exp(1j * state[2])
    if np.isnan(state[5]):
        return position + turned, speed, 0.0, abs(offset) * spin_limit
    return position + turned, speed + 1j * state[5] * turned, 0.0, 0.0


def _dot(a: Any, b: Any) -> Any:
    """Return the scalar product of vectors that are complex numbers."""
    return np.real(np.conj(a) * b)


def _most(request: Request, weight: Weight, step: float) -> Float[np.ndarray, " K"]:
    """Bound ∫ w·a from above, for flights that end at the goal's yaw and spin after each step.

    Dynamic programming, forwards in time: yaw turns by half a step, the motors push and change the
    spin, yaw turns by the other half. Moments are multiples of what moves the spin by a column, so
    the spin is never interpolated; the yaw is, from above (`_turned`).
    """
    model, limits = request.model, request.limits
    strongest = largest_moment(model, limits) + unaccounted(model, limits)[1]
    column = max(strongest * step / _MOMENTS, 2 * limits.spin / _COLUMNS)
    begin_yaw, begin_spin = float(request.start[2]), float(request.start[5])
    lowest = -int((begin_spin + limits.spin) / column)
    spins = begin_spin + column * np.arange(lowest, int((limits.spin - begin_spin) / column) + 1)
    changes = np.arange(-int(strongest * step / column) - 1, int(strongest * step / column) + 2)
    tables = _tables(model, limits, tuple(request.start[6:]), step, column, len(changes) // 2)

    nodes = step * np.arange(_STEPS + 1)
    values, middle = weight(nodes), weight(nodes[:-1] + step / 2)
    size = (np.abs(values[1:]) + np.abs(values[:-1])) / 2
    size = np.where(_dot(values[1:], values[:-1]) < 0, np.maximum(size, np.abs(middle)), size)

    grid = 2 * np.pi * np.arange(YAWS) / YAWS
    away = np.abs(np.angle(np.exp(1j * (grid - step / 2 * begin_spin))))
    worth = -(
        weight.yaw_price * away[:, None] + weight.spin_price * np.abs(spins - begin_spin)
    ).astype(np.float32)
    turn = _Turn(spins * step)
    goal, found = _goal_value(request, spins, step), np.zeros(_STEPS)
    for k in range(_STEPS):
        if k:
            worth = turn(worth)
        direction = float(np.angle(middle[k])) - begin_yaw
        table = _seen_from(tables[min(k, len(tables) - 1)], direction)
        worth = _pushed(worth, (step * size[k] * table).astype(np.float32), changes)
        found[k] = goal(worth)
    return found


def _pushed(
    worth: Float[np.ndarray, "yaws S"], gain: Float[np.ndarray, "yaws B"], changes: np.ndarray
) -> Float[np.ndarray, "yaws S"]:
    """Let the motors push and turn: the best of all moments."""
    best = np.full_like(worth, IMPOSSIBLE)
    count = worth.shape[1]
    for j, change in enumerate(changes):
        to, of = (
            slice(max(change, 0), count + min(change, 0)),
            slice(max(-change, 0), count - max(change, 0)),
        )
        np.maximum(best[:, to], worth[:, of] + gain[:, j : j + 1], out=best[:, to])
    return best


class _Turn:
    """Turns the craft by an angle for each column of spin."""

    def __init__(self, angles: Float[np.ndarray, " S"]) -> None:
        back = -angles / (2 * np.pi) * YAWS
        whole = np.floor(back).astype(int)
        self._share = (back - whole).astype(np.float32)
        rows = (np.arange(YAWS)[:, None] + whole) % YAWS
        columns = np.arange(len(angles))
        self._near = rows * len(angles) + columns
        self._next = (rows + 1) % YAWS * len(angles) + columns

    def __call__(self, worth: Float[np.ndarray, "yaws S"]) -> Float[np.ndarray, "yaws S"]:
        """Interpolate from above: linearly, plus the parabola where the function is concave."""
        bent = np.roll(worth, -1, axis=0) + np.roll(worth, 1, axis=0) - 2 * worth
        bent = np.minimum(bent, 0.0, out=bent)
        share = self._share
        below = np.minimum(bent.take(self._near), bent.take(self._next))
        linear = (1 - share) * worth.take(self._near) + share * worth.take(self._next)
        return linear - (0.5 * share * (1 - share)) * below


def _goal_value(request: Request, spins: Float[np.ndarray, " S"], step: float) -> Any:
    """Return the function that reads the worth of the goal off a table, after half a turn."""
    state = request.goal.state
    columns = np.arange(len(spins))
    if not np.isnan(state[5]):
        near = int(np.clip(np.searchsorted(spins, state[5]), 1, len(spins) - 1))
        columns = np.array([near - 1, near])

    def value(worth: Float[np.ndarray, "yaws S"]) -> float:
        if np.isnan(state[2]):
            return float(worth[:, columns].max())
        back = (state[2] - request.start[2] - step / 2 * spins[columns]) / (2 * np.pi) * YAWS
        near = np.floor(back).astype(int)
        low, high = worth[near % YAWS, columns], worth[(near + 1) % YAWS, columns]
        # The larger of the neighbours in spin: from above.
        return float((low + (back - near) * (high - low)).max())

    return value


def _seen_from(table: Float[np.ndarray, "yaws B"], direction: float) -> Float[np.ndarray, "yaws B"]:
    """Turn a table of pushes to the direction in which the weight points."""
    back = -direction / (2 * np.pi) * YAWS
    whole = int(np.floor(back))
    rows = (np.arange(YAWS) + whole) % YAWS
    share = back - whole
    return (1 - share) * table[rows] + share * table[(rows + 1) % YAWS]


@lru_cache(maxsize=64)
def _tables(
    model: Model,
    limits: Limits,
    speeds: tuple[float, ...],
    step: float,
    column: float,
    side: int,
) -> tuple[Float[np.ndarray, "yaws B"], ...]:
    """Return the largest pushes over each step, until the motors may have any speed."""
    lag = float(model.dynamics.motor_time_constant)
    count = min(int(_SETTLED * lag / step) + 1, _STEPS)
    # The mean of what thrusts can be over a step bounds what their mean can be.
    times = step * (np.arange(count)[:, None] + (np.arange(_PARTS) + 0.5) / _PARTS)
    if count < _STEPS:
        times[-1] = np.inf
    ranges = thrust_range(model, motor_range(model, np.array(speeds), times.ravel()), limits)
    low, high = (force.reshape(len(speeds), count, _PARTS).mean(axis=2) for force in ranges)
    moments = column / step * np.arange(-side - 0.5, side + 0.6, 0.5)
    extra = unaccounted(model, limits)
    return tuple(
        _chords(frontier(model, low[:, k], high[:, k], moments, extra)) for k in range(count)
    )


def _chords(fine: Float[np.ndarray, "yaws F"]) -> Float[np.ndarray, "yaws B"]:
    """Raise a concave function at every other point, so that its chords lie above it."""
    points, between = fine[:, 1::2], fine[:, 2:-1:2]
    excess = np.maximum(between - (points[:, 1:] + points[:, :-1]) / 2, 0.0)
    excess[:, (points[:, 1:] + points[:, :-1]).min(axis=0) < IMPOSSIBLE / 2] = 0.0
    sides = np.pad(excess, ((0, 0), (1, 1)))
    return points + np.maximum(sides[:, 1:], sides[:, :-1])
