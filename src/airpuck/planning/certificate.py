"""A time that no control undercuts: weak duality, with the yaw's dynamics solved globally.

For any weight w(t) in the plane, integration by parts turns what a flight must have reached into
what its thrusts must have given, ∫ w·a dt. The most that any thrusts can give, over all paths of
yaw and spin, follows from `YawProgram`. A duration at which the most is less than what is needed is
impossible. Every rounding is upwards; docs/planning.md proves each.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Float

from airpuck.physics.angle import wrapped
from airpuck.planning.attainable import gravity, has_bounds, largest_moment, strongest_push
from airpuck.planning.request import Goal, Request
from airpuck.planning.yaw_program import Fineness, Weight, YawProgram

#: The search begins coarsely; only near the bound a fine grid pays.
_COARSE, _FINE = Fineness(40, 8, 100, 256), Fineness(60, 20, 240, 480)
#: The programs run up to so many times a weight's own duration.
_BEYOND = 1.06
#: Coarse and fine programs at most.
_SEARCHES, _REFINEMENTS = 14, 4
#: An improvement of the bound by less than this share ends the search.
_IMPROVED = 5e-4
#: The last fine program begins by this share below the bound that the one before promised.
_BELOW = 3e-4
#: How many steps beyond its last time a program may promise.
_GUESSED = 4.0
#: Rounding of times [s].
_SAME = 1e-12
#: Shares of a step for which a craft that moves at the goal may have coasted.
_COASTS = np.linspace(0.0, 1.0, 9)
#: Intervals of time that are refuted one by one, and how long they are, in durations of the weight.
_BINS, _LONGEST = 4000, 2.0
#: Durations for which a leg between way points is tried, as shares of the plan's, which has turns.
_SHARES_OF_LEG = np.linspace(1.0, 0.4, 11)
#: A bound above this share of the duration that was tried came from its weight.
_NEAR = 0.8


def lower_bound(request: Request, weight: Weight, duration: float) -> float | None:
    """Find a time that no control of these motors can undercut.

    Parameters
    ----------
    request : Request
        What is asked for; its reserve is not kept here, and way points and discs are not seen.
    weight : Weight
        Of accelerations over time; any gives a true bound, the costates of a good plan a high one.
    duration : float
        For which the weight was made [s]: where the search begins, not a limit of the bound.

    Returns
    -------
    float or None
        A duration [s] below which every one is refuted, zero where none was; None where an effect
        of the model states no bounds.
    """
    if not has_bounds(request.model, request.limits):
        return None
    return _refuted(request, weight, duration)


def missing_at(request: Request, weight: Weight, duration: float) -> tuple[float, float, float]:
    """Return what a flight of a duration needs, the most that it can get, and the scale of both.

    The duration is impossible if it needs more.
    """
    program = YawProgram(request, weight, duration, _COARSE, np.zeros(1))
    needed = _needed(request, program, np.zeros(1))
    return float(needed[-1, 0]), float(program.most[-1, 0]), program.worth


def _refuted(request: Request, weight: Weight, duration: float) -> float:
    """Refute durations with compressed weights, first on coarse grids, until no gap is left."""
    found = _Durations(request, weight, duration)
    own, top = duration, 0.0
    for _ in range(_SEARCHES):
        root = found.refute(own, _BEYOND * own, _COARSE)
        better, top = root > (1 + _IMPROVED) * top, max(top, root)
        gap = found.gap_below(top)
        if better:
            own = root
        elif gap is None:
            break
        elif gap == own:  # this weight does not close it, so the bound is not above
            top = (1 - _IMPROVED) * gap
        else:
            own = gap
    own = top
    for number in range(_REFINEMENTS if top else 0):
        before = found.bound
        # Craft that can wait are refuted at the last end of a step; it should lie at the bound.
        # For others ends of steps should lie elsewhere each time.
        far = 1.0 if found.waits else _BEYOND + number / (2 * _FINE.steps)
        root = found.refute(own, far * own, _FINE)
        done = root if found.waits else (1 + _IMPROVED) * before
        if found.bound and found.bound >= (1 - _IMPROVED) * done and (number or found.waits):
            break
        own = (1 - _BELOW) * (root or own)
    return found.bound


class _Durations:
    """Which durations are refuted."""

    def __init__(self, request: Request, weight: Weight, duration: float) -> None:
        self._request, self._weight, self._duration = request, weight, duration
        self._edges = np.linspace(0.0, _LONGEST * duration, _BINS + 1)
        self._last = _by_the_limits(request)
        self._refuted = self._edges[1:] <= self._last
        #: Whether flights can be prolonged by waiting, so that a refuted duration refutes all
        #: shorter ones: at rest at the start or at the goal nothing moves a craft.
        still = [np.all(state[3:6] == 0) for state in (request.start, request.goal.state)]
        self.waits = any(still) and gravity(request.model) == 0

    @property
    def bound(self) -> float:
        """The duration below which all are refuted [s]."""
        if self.waits or self._refuted.all():
            return self._last
        return float(self._edges[:-1][~self._refuted][0])

    def gap_below(self, top: float) -> float | None:
        """Return the longest duration below one that is not refuted."""
        below = self._edges[1:][~self._refuted & (self._edges[1:] <= top)]
        return None if self.waits or not len(below) else float(below[-1])

    def refute(self, own: float, horizon: float, fineness: Fineness) -> float:
        """Try the weight of a duration; return where near it that stops refuting [s]."""
        coasts = _COASTS[:1] if self.waits else _COASTS
        weight = self._weight.compressed(own / self._duration)
        coasts = coasts * horizon / fineness.steps
        program = YawProgram(self._request, weight, horizon, fineness, coasts)
        needed = _needed(self._request, program, coasts)
        ends = program.step * np.arange(1, fineness.steps + 1)
        if self.waits:
            missing = (needed - program.most)[:, 0]
            self._last = max(self._last, ends[missing > 0].max(initial=0.0))
            longest = ends
        else:
            # Of each pair of neighbouring times of coasting, latest first: in order of duration.
            pairs = [slice(1, None), slice(None, -1)]
            least = np.minimum(*(needed[:, one] for one in pairs))
            most = np.maximum(*(program.most[:, one] for one in pairs))
            missing = (least - most)[:, ::-1].ravel()
            shortest, longest = ((ends[:, None] - coasts[one])[:, ::-1].ravel() for one in pairs)
            for low, high in zip(shortest[missing > 0], longest[missing > 0], strict=True):
                first, last = np.searchsorted(self._edges, [low - _SAME, high + _SAME])
                self._refuted[first : max(last - 1, first)] = True
        return _root(longest, missing, own)


def _by_the_limits(request: Request) -> float:
    """Return the time that the change of state takes at the largest rates [s]."""
    limits, strongest = request.limits, strongest_push(request, np.array([np.inf]))[0]
    turning = max(largest_moment(request.model, limits), 1e-9)
    change = request.goal.state - request.start[:6]
    change[2] = wrapped(np, change[2])
    rates = [limits.speed, limits.speed, limits.spin, strongest, strongest, turning]
    return float(np.nanmax(np.abs(change) / rates))


def _root(times: Float[np.ndarray, " K"], missing: Float[np.ndarray, " K"], near: float) -> float:
    """Return the end of the run of refuted times in or below which one lies."""
    own = min(int(np.searchsorted(times, near)), len(times) - 1)
    while own >= 0 and missing[own] <= 0:
        own -= 1
    while 0 <= own < len(times) - 1 and missing[own + 1] > 0:
        own += 1
    if own < 0:
        return 0.0
    last = min(own, len(times) - 2)
    fall = missing[last] - missing[last + 1]
    reach = missing[last] / fall if fall > 0 else 1.0
    # Beyond the last time this is a guess, of a few steps.
    return float(times[last] + (times[last + 1] - times[last]) * min(reach, _GUESSED))


def lower_bound_through(request: Request, durations: Float[np.ndarray, " legs"]) -> float | None:
    """Find a time that no control undercuts that passes way points in order.

    The larger of two: of a flight that need not pass them; and of the first leg, with any velocity
    at its end, together with the last, flown backwards from the goal.
    """
    if not has_bounds(request.model, request.limits):
        return None
    direct = replace(request, via=request.via[:0])
    goal = request.goal.state
    total = float(durations.sum())
    whole = _refuted(direct, _straight(direct, goal[:2], total, rest=True), total)
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
    best = 0.0
    for time in duration * _SHARES_OF_LEG:
        found = _refuted(request, _straight(request, to, time), time)
        best = max(best, found)
        if best > _NEAR * time:
            break
    return best


def unavoidable_rail(request: Request) -> str | None:
    """Return the axis along which the craft hits a rail whatever it does; None if that is not sure.

    At time t it is where it drifts to, less ∫ (t - s) times what thrusts give against the motion;
    `YawProgram` bounds the integral for this yaw and spin at the start.
    """
    if not has_bounds(request.model, request.limits):
        return None
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
            weight = Weight(against * time, -against, none, none.astype(complex))
            most = float(YawProgram(anywhere, weight, time, _COARSE, np.zeros(1)).most[-1, 0])
            tilted = abs(gravity(request.model)) * time**2 / 2
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
    none = np.zeros(0)
    return Weight(along * stop, -along, none, none.astype(complex))


def _needed(
    request: Request, program: YawProgram, coasts: Float[np.ndarray, " T"]
) -> Float[np.ndarray, "K T"]:
    """Return what ∫ w·a over thrusts must at least be for craft that coast from the goal.

    ∫ w·a = [w·v] - ∫ w'·v, where a piecewise constant w' leaves positions at the ends and at the
    kinks, of which the rails bound the latter.
    """
    limits, weight, pull = request.limits, program.weight, gravity(request.model)
    times = program.step * np.arange(1, len(program.most) + 1)
    start, speed, _, _ = _accelerated_point(request, request.start[:6], times)
    goal, goal_speed, place_error, speed_error = _accelerated_point(
        request, request.goal.state, times
    )
    end: Any = weight(times)[:, None]
    slope: Any = weight.slope(times)[:, None]
    # w(T)·v - w'(T)·(p + v τ): the velocity at arrival has the weight of that time.
    arrival = end - slope * coasts
    needed = _dot(weight.beta, start) - _dot(weight(np.zeros(1))[0], speed) - _dot(slope, goal)
    needed = needed - np.abs(slope) * place_error[:, None] - np.abs(arrival) * speed_error
    if np.isnan(goal_speed):
        needed = needed - limits.speed * (np.abs(arrival.real) + np.abs(arrival.imag))
    else:
        needed = needed + _dot(arrival, goal_speed)
    offset = float(np.hypot(*request.model.dynamics.center_of_mass))
    for time, kink in zip(weight.kink_times, weight.kinks, strict=True):
        room = abs(kink.real) * request.reach[0] + abs(kink.imag) * request.reach[1]
        room += abs(kink) * offset * max(1.0, limits.spin * time)
        needed = needed - np.where(times > time, room, 0.0)[:, None]
    if pull:
        needed = needed + _dot(end - slope * coasts / 2, pull) * coasts
        # Between two times of coasting this is bent by as much, at most.
        needed = needed - np.abs(slope * pull) * (coasts[1:2].sum() / 2) ** 2
        # The trapezoidal rule is exact: kinks lie at ends of steps.
        pushed = _dot(weight(np.append(0.0, times)), pull)
        needed = needed - (np.cumsum(pushed[1:] + pushed[:-1]) * program.step / 2)[:, None]
    return needed


def _accelerated_point(
    request: Request, state: Float[np.ndarray, " 6"], times: Float[np.ndarray, " K"]
) -> tuple[complex, complex, Float[np.ndarray, " K"], float]:
    """Return place and velocity of the point that thrusts accelerate, and how far off they may be.

    It is the centre of mass. Where the offset r is fixed in the world, it is p + i r (γ - γ₀),
    which thrusts and r ω² accelerate; how many turns the craft has made by a time is open.
    """
    offset, spin = complex(*request.model.dynamics.center_of_mass), request.limits.spin
    world = request.model.dynamics.frame == "world"
    place, speed = complex(state[0], state[1]), complex(state[3], state[4])
    error = np.zeros_like(times)
    turn = state[2] - request.start[2]
    if np.isnan(turn):
        arm = lever = 0j
        error = abs(offset) * (spin * times if world else np.ones_like(times))
    elif world:
        if request.goal.turn == "shorter":
            turn = float(wrapped(np, turn))
            error = abs(offset) * 2 * np.pi * ((spin * times + abs(turn)) // (2 * np.pi))
        arm, lever = 1j * offset * turn, 1j * offset
    else:
        arm = offset * np.exp(1j * state[2])
        lever = 1j * arm
    if np.isnan(state[5]):
        return place + arm, speed, error, abs(offset) * spin
    unknown = abs(offset * state[5]) if np.isnan(turn) and not world else 0.0
    if np.isnan(turn) and world:
        lever = 1j * offset
    return place + arm, speed + lever * state[5], error, unknown


def _dot(a: Any, b: Any) -> Any:
    """Return the scalar product of vectors that are complex numbers."""
    return np.real(np.conj(a) * b)
