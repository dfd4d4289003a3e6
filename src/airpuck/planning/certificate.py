"""Lower bounds on the flight time: weak duality, with the yaw's dynamics solved globally.

For any weight w(t) in the plane, integration by parts turns the required change of state into a
required integral over the thrusts, ∫ w·a dt. `YawProgram` bounds this integral from above, over all
paths of yaw and yaw rate. A duration is impossible if the bound is below the required value. All
rounding is upwards; docs/planning.md has the proofs.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Float

from airpuck.data.sampling import runs
from airpuck.physics.rigid_body import wrapped
from airpuck.planning.request import Goal, Request, gravity, has_bounds, largest_moment
from airpuck.planning.yaw_program import LEAST_MOMENT, Fineness, Weight, YawProgram

#: The search begins with coarse grids; a fine grid pays off only near the bound.
_COARSE, _FINE = Fineness(40, 8, 100, 256), Fineness(60, 20, 240, 480)
#: Horizon of the programs, as a multiple of the weight's own duration.
_BEYOND = 1.06
#: Largest numbers of coarse and of fine programs.
_SEARCHES, _REFINEMENTS = 14, 4
#: Fractions of the duration at which the control of least energy refutes durations that are far too
#: short. If the craft moves at both ends, a weight made for a long flight refutes few of them.
_LEADS = (0.4, 0.6, 0.8)
#: The coarse search ends when the bound improves by less than this fraction.
_IMPROVED = 5e-4
#: The fine search ends when the bound is within this fraction of the time where a program stops
#: refuting.
_NEAR_END = 1e-3
#: Fine grids refute a longer duration than coarse ones, by about this factor (1.02 to 1.05).
_FINER = 1.03
#: The last fine program begins this fraction below the bound that the previous one promised.
_BELOW = 3e-4
#: Number of steps beyond its last time for which a program may extrapolate.
_GUESSED = 4.0
#: Rounding of times [s].
_SAME = 1e-12
#: Fractions of a step for which a craft that is moving at the goal may have coasted.
_COASTS = np.linspace(0.0, 1.0, 9)
#: Number of time intervals that are refuted separately, and their length relative to the weight's
#: duration.
_BINS, _LONGEST = 4000, 2.0
#: Durations tried for a leg between way points, as fractions of the plan's, which includes turns.
_SHARES_OF_LEG = np.linspace(1.0, 0.4, 11)
#: Times at which the proof tests for a collision with a rail, as multiples of the time to brake at
#: full thrust in a straight line, without turns.
_BRAKING_TIMES = (1.0, 1.2, 1.5)
#: If the bound exceeds this fraction of the tried duration, it came from that duration's weight.
_NEAR = 0.8


def lower_bound(request: Request, weight: Weight, duration: float) -> float | None:
    """Compute a lower bound on the flight time, over all controls of these motors.

    Parameters
    ----------
    request : Request
        The request. Way points, discs and the reserve of thrust are ignored.
    weight : Weight
        Weight of accelerations over time. Any weight gives a valid bound; the costates of a good
        plan give a high one.
    duration : float
        Duration for which the weight was made [s]; the search begins there. It does not limit the
        bound.

    Returns
    -------
    float or None
        All durations below this one [s] are refuted; zero: none is refuted. None: an effect of the
        model states no bounds.
    """
    if not has_bounds(request.model, request.limits):
        return None
    return _refuted(request, weight, duration)


def _refuted(request: Request, weight: Weight, duration: float) -> float:
    """Refute durations with compressed weights, first on coarse grids, until no gap is left."""
    found = _Durations(request, weight, duration)
    own, top = duration, 0.0
    for share in () if found.waits else _LEADS:
        lead = share * duration
        found.refute(lead, _BEYOND * lead, _COARSE, _least_energy(request, lead))
    for _ in range(_SEARCHES):
        root = found.refute(own, _BEYOND * own, _COARSE)
        better, top = root > (1 + _IMPROVED) * top, max(top, root)
        gap = found.gap_below(top)
        if gap == own:  # the given weight does not close the gap
            found.refute(own, _BEYOND * own, _COARSE, _least_energy(request, own))
            gap = found.gap_below(top)
        if better:
            own = root
        elif gap is None:
            break
        elif gap == own:  # nor does the other weight, so the bound cannot be higher
            top = (1 - _IMPROVED) * gap
        else:
            own = gap
    own = _FINER * top if found.waits else top
    for number in range(_REFINEMENTS if top else 0):
        # For craft that can wait, the last end of a step refutes; it should lie at the bound. For
        # other craft the ends of steps should differ between the two programs.
        far = 1.0 if found.waits else _BEYOND + number / (2 * _FINE.steps)
        root = found.refute(own, far * own, _FINE)
        done = found.bound >= (1 - _NEAR_END) * root if found.waits else number == 1
        if found.bound and done:
            break
        own = (1 - _BELOW) * (root or own)
    return found.bound


class _Durations:
    """The durations that are refuted."""

    def __init__(self, request: Request, weight: Weight, duration: float) -> None:
        self._request, self._weight, self._duration = request, weight, duration
        self._edges = np.linspace(0.0, _LONGEST * duration, _BINS + 1)
        self._last = _by_the_limits(request)
        self._refuted = self._edges[1:] <= self._last
        #: Whether waiting can prolong a flight, so that a refuted duration refutes all shorter
        #: ones: nothing moves a craft at rest at the start or at the goal.
        still = [np.all(state[3:6] == 0) for state in (request.start, request.goal.state)]
        self.waits = any(still) and gravity(request.model) == 0

    @property
    def bound(self) -> float:
        """All durations below this one are refuted [s]."""
        if self.waits or self._refuted.all():
            return self._last
        return float(self._edges[:-1][~self._refuted][0])

    def gap_below(self, top: float) -> float | None:
        """Return the longest duration below a given limit that is not refuted."""
        below = self._edges[1:][~self._refuted & (self._edges[1:] <= top)]
        return None if self.waits or not len(below) else float(below[-1])

    def refute(
        self, own: float, horizon: float, fineness: Fineness, weight: Weight | None = None
    ) -> float:
        """Try a weight for a duration; return the nearby duration where it stops refuting [s].

        By default the given weight is compressed to the duration.
        """
        coasts = _COASTS[:1] if self.waits else _COASTS
        weight = weight or self._weight.compressed(own / self._duration)
        coasts = coasts * horizon / fineness.steps
        # A fine program need not refute again what is refuted, but for the steps from which `_root`
        # extrapolates. A coarse one that refutes nothing must show it, so that the search ends.
        begins = self.waits and fineness is _FINE
        since = self._last - _GUESSED * horizon / fineness.steps if begins else 0.0
        program = YawProgram(self._request, weight, horizon, fineness, coasts, since)
        needed = _needed(self._request, program, coasts)
        ends = program.step * np.arange(1, fineness.steps + 1)
        if self.waits:
            missing = (needed - program.most)[:, 0]
            self._last = max(self._last, ends[missing > 0].max(initial=0.0))
            longest = ends
        else:
            # For each pair of neighbouring coasting times, latest first: in order of duration.
            pairs = [slice(1, None), slice(None, -1)]
            least = np.minimum(*(needed[:, one] for one in pairs))
            most = np.maximum(*(program.most[:, one] for one in pairs))
            missing = (least - most)[:, ::-1].ravel()
            shortest, longest = ((ends[:, None] - coasts[one])[:, ::-1].ravel() for one in pairs)
            # Neighbouring intervals touch, so runs of them are refuted as a whole.
            for first, last in runs(missing > 0):
                ends_of_run = [shortest[first] - _SAME, longest[last - 1] + _SAME]
                low, high = np.searchsorted(self._edges, ends_of_run)
                self._refuted[low : max(high - 1, low)] = True
        return _root(longest, missing, own)


def _by_the_limits(request: Request) -> float:
    """Return the time that the change of state takes at the largest rates [s]."""
    limits, strongest = request.limits, request.strongest_push
    turning = max(largest_moment(request.model, limits), LEAST_MOMENT)
    change = request.goal.state - request.start[:6]
    change[2] = wrapped(np, change[2])
    rates = [limits.speed, limits.speed, limits.spin, strongest, strongest, turning]
    return float(np.nanmax(np.abs(change) / rates))


def _root(times: Float[np.ndarray, " K"], missing: Float[np.ndarray, " K"], near: float) -> float:
    """Return the end of the run of refuted times that contains a time, or of the run below it."""
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
    # Beyond the last time this is an extrapolation over a few steps.
    return float(times[last] + (times[last + 1] - times[last]) * min(reach, _GUESSED))


def lower_bound_through(request: Request, durations: Float[np.ndarray, " legs"]) -> float | None:
    """Compute a lower bound for a flight that passes way points in order.

    The larger of two bounds: one for a flight without the way points; one for the first leg, with
    any velocity at its end, plus the last leg, flown backwards from the goal.
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
        # In reversed time, velocities change their sign and accelerations do not; motors are free.
        n, point, time = len(request.start) - 6, request.via[-1], float(durations[-1])
        state = np.concatenate([goal[:3], -goal[3:], np.full(n, request.model.vehicle.command_max)])
        place = Goal(float(point[0]), float(point[1]), velocity=None)
        last = _of_leg(replace(direct, start=state, goal=place), point, time)
    return max(whole, first + last)


def _of_leg(request: Request, to: Float[np.ndarray, " 2"], duration: float) -> float:
    """Compute a bound for a leg with a free final velocity; the plan's leg may take much longer."""
    best = 0.0
    for time in duration * _SHARES_OF_LEG:
        best = max(best, _refuted(request, _straight(request, to, time), time))
        if best > _NEAR * time:
            break
    return best


def unavoidable_rail(request: Request) -> str | None:
    """Return the axis along which the craft is certain to hit a rail; None if a hit is not certain.

    At time t the craft has drifted, minus ∫ (t - s) times the thrust against the motion;
    `YawProgram` bounds the integral for the yaw and yaw rate at the start.
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
        for share in _BRAKING_TIMES:
            time = share * abs(speed) / request.strongest_push
            against = -outwards * normal
            weight = Weight(against * time, -against)
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
    """Return the weight of a straight flight that brakes half way or not at all."""
    way = complex(*(to - request.start[:2]))
    along = way / abs(way) if way else 0j
    return Weight(along * (duration / 2 if rest else duration), -along)


def _least_energy(request: Request, duration: float) -> Weight:
    """Return the acceleration with the smallest ∫ a² that reaches the goal, ignoring the yaw."""
    start, goal = request.start, request.goal.state
    away = complex(*(goal[:2] - start[:2])) - complex(*start[3:5]) * duration
    if np.isnan(goal[3:5]).any():
        alpha = 3 * away / duration**2
        beta = -alpha / duration
    else:
        faster = complex(*(goal[3:5] - start[3:5]))
        alpha = 6 * away / duration**2 - 2 * faster / duration
        beta = 6 * faster / duration**2 - 12 * away / duration**3
    size = max(abs(alpha), abs(alpha + beta * duration)) or 1.0
    return Weight(alpha / size, beta / size)


def _needed(
    request: Request, program: YawProgram, coasts: Float[np.ndarray, " T"]
) -> Float[np.ndarray, "K T"]:
    """Return the least ∫ w·a that the thrusts of craft that coast from the goal must produce.

    ∫ w·a = [w·v] - ∫ w'·v. With a piecewise constant w', the second term depends only on positions
    at the ends and at the kinks; the rails bound the positions at the kinks.
    """
    limits, weight, pull = request.limits, program.weight, gravity(request.model)
    times = program.step * np.arange(1, len(program.most) + 1)
    start, speed, _, _ = _accelerated_point(request, request.start[:6], times)
    goal, goal_speed, place_error, speed_error = _accelerated_point(
        request, request.goal.state, times
    )
    end: Any = weight(times)[:, None]
    slope: Any = weight.slope(times)[:, None]
    # w(T)·v - w'(T)·(p + v τ): the velocity at arrival is weighted by w at that time.
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
        # Bound of the curvature's effect between two coasting times.
        needed = needed - np.abs(slope * pull) * (coasts[1:2].sum() / 2) ** 2
        # The trapezoidal rule is exact: kinks lie at ends of steps.
        pushed = _dot(weight(np.append(0.0, times)), pull)
        needed = needed - (np.cumsum(pushed[1:] + pushed[:-1]) * program.step / 2)[:, None]
    return needed


def _accelerated_point(
    request: Request, state: Float[np.ndarray, " 6"], times: Float[np.ndarray, " K"]
) -> tuple[complex, complex, Float[np.ndarray, " K"], float]:
    """Return position, velocity and uncertainty of the point that thrusts accelerate.

    This point is the centre of mass. If the offset r is fixed in the world, it is p + i r (γ - γ₀),
    accelerated by thrusts and r ω²; the number of turns made by then is unknown.
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
    """Return the scalar product of vectors written as complex numbers."""
    return np.real(np.conj(a) * b)
