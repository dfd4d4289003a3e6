"""The request for a plan, and bounds on what the propellers can produce, whatever the craft does.

Every bound is an upper bound (docs/planning.md) if `has_bounds` is true: an effect that states no
bounds is left out.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from jaxtyping import Float

from airpuck.boundary.arguments import checked_class, numbers_of
from airpuck.boundary.errors import InputError
from airpuck.control.reference import Numbers
from airpuck.craft.table import Table
from airpuck.model.model_file import Model
from airpuck.physics.effects import Envelope, weighted_range
from airpuck.physics.motor import lag_decay
from airpuck.physics.rigid_body import wrapped
from airpuck.physics.thrust import thrust
from airpuck.planning.settings import Limits

#: A yaw beyond this must be a mistake: the craft would turn for seconds [rad].
_MOST_YAW = 50.0
#: No table is larger than this [m].
_FARTHEST = 100.0
_MOST_POINTS = 20
#: A start and a goal closer than this are the same [m, m, rad, m/s, m/s, rad/s].
_SAME = np.array([1e-6, 1e-6, 1e-6, 1e-6, 1e-6, 1e-6])
#: Time step for checking whether the craft can brake before a rail [s].
_STEP = 1e-3
#: Braking is followed for at most this long [s].
_LONGEST_BRAKING = 5.0
#: Rounding of the distance travelled [m] and of thrusts [N].
_ROUNDING, _FORCE_ROUNDING = 1e-6, 1e-12
#: Motor speeds at which the reserve is evaluated: steps of 0.05 % of the range.
_SPEEDS = 2001
#: Number of yaws per turn that `strongest_push` evaluates.
_YAWS = 314
#: The push at the nearest of these yaws is at least this fraction of the push at any yaw.
_BETWEEN_YAWS = math.cos(math.pi / _YAWS)


@checked_class
@dataclass(frozen=True)
class Goal:
    """The end state of a plan.

    Attributes
    ----------
    x, y : float
        Position [m].
    yaw : float, optional
        Orientation [rad]; None: free.
    velocity : (vx, vy, spin), optional
        Rates at the end [m/s, m/s, rad/s], by default at rest; None: free.
    turn : {"shorter", "exact"}, default "shorter"
        Whether the craft turns the shorter way to the yaw; otherwise the yaw is continuous, whole
        turns included.

    Raises
    ------
    InputError
        If a number is not finite, or the velocity is not three numbers.

    Examples
    --------
    >>> goal = airpuck.Goal(0.3, 0.1, yaw=None)  # any yaw
    >>> goal.velocity
    (0.0, 0.0, 0.0)
    """

    x: float
    y: float
    yaw: float | None = None
    velocity: tuple[float, float, float] | None = (0.0, 0.0, 0.0)
    turn: Literal["shorter", "exact"] = "shorter"

    @property
    def state(self) -> Float[np.ndarray, " 6"]:
        """x, y, γ and their rates; nan where free."""
        yaw = math.nan if self.yaw is None else self.yaw
        velocity = (math.nan,) * 3 if self.velocity is None else self.velocity
        return np.array([self.x, self.y, yaw, *velocity], dtype=float)


@dataclass(frozen=True, eq=False)
class Request:
    """A checked request, ready for the solver."""

    model: Model
    #: x, y, γ, their rates, and the motor speeds.
    start: Float[np.ndarray, " s"]
    goal: Goal
    #: Way points, in order [m].
    via: Float[np.ndarray, "V 2"]
    #: Largest distance of the craft's centre from the centre of the table [m]; inf without rails.
    reach: tuple[float, float]
    #: For each disc, its centre and the smallest distance of the craft's centre [m].
    keep_out: Float[np.ndarray, "D 3"]
    limits: Limits

    @cached_property
    def highest_command(self) -> Float[np.ndarray, " n"]:
        """The command of each motor at which the reserve begins."""
        vehicle, curves = self.model.vehicle, self.model.dynamics.thrust
        speeds = np.linspace(vehicle.command_min, vehicle.command_max, _SPEEDS)
        forces = thrust(curves, np.tile(speeds, (vehicle.n_propellers, 1)))
        allowed = (1 - self.limits.reserve) * forces[:, -1:]
        return speeds[(forces <= allowed + _FORCE_ROUNDING).sum(axis=1) - 1]

    @property
    def strongest_push(self) -> float:
        """Bound on the acceleration of the centre at any yaw and with any motor speeds [m/s²]."""
        return float(strongest_push(self.model, self.limits, self.start[6:], np.array([np.inf]))[0])

    def goal_yaws(self) -> tuple[float, ...]:
        """Return the final yaws worth trying, as continuous angles; the nearest first."""
        begin, yaw = self.start[2], self.goal.yaw
        if yaw is None:
            return (float(begin),)
        if self.goal.turn == "exact":
            return (float(yaw),)
        turn = float(wrapped(np, yaw - begin))
        # The longer way round can only be faster if both ways are about equally long.
        other = turn - math.copysign(2 * np.pi, turn)
        near = (turn,) if abs(turn) < 2.0 else (turn, other)
        return tuple(float(begin) + one for one in near)


def checked_request(
    model: Model,
    start: Numbers,
    goal: Goal | Numbers,
    via: Sequence[Numbers],
    table: Table | None,
    keep_out: Sequence[Numbers],
    limits: Limits,
) -> Request:
    """Check a request; raise InputError, naming the field and the problem."""
    vehicle = model.vehicle
    if vehicle.actuation.two_way.any():
        raise InputError(
            f"plans are for propellers that push one way, but {vehicle.name!r} has wheels or "
            "reversible propellers; steer it with the LQR or MPC",
            field="model",
        )
    begin = _numbers(start, "start", (3, 6, 6 + vehicle.n_propellers))
    begin = np.append(begin, np.zeros(max(0, 6 - len(begin))))
    if len(begin) == 6:  # motors idle
        begin = np.append(begin, np.full(vehicle.n_propellers, vehicle.command_min))
    if not isinstance(goal, Goal):
        end = _numbers(goal, "goal", (3, 6)).tolist()
        velocity = (end[3], end[4], end[5]) if len(end) == 6 else (0.0, 0.0, 0.0)
        goal = Goal(end[0], end[1], end[2], velocity)
    wanted = goal.state
    if not np.isfinite(wanted[:2]).all() or np.isinf(wanted).any():
        raise InputError("must be finite numbers", field="goal")
    points = _rows(via, "via", 2)
    discs = _rows(keep_out, "keep_out", 3)
    if (discs[:, 2] <= 0).any():
        raise InputError("a disc needs a radius above zero", field="keep_out")
    discs = discs + np.array([0.0, 0.0, vehicle.radius_m + limits.margin])
    room = np.inf if table is None else vehicle.radius_m + limits.margin
    reach = (np.inf, np.inf) if table is None else table.reach(room)
    request = Request(model, begin, goal, points, reach, discs, limits)
    _check_motion(request, begin[2:6], "start")
    _check_motion(request, wanted[2:6], "goal")
    places = [("start", begin[:2]), *(("via", p) for p in points), ("goal", wanted[:2])]
    for name, place in places:
        _check_place(request, name, place)
    if not ((begin[6:] >= 0) & (begin[6:] <= 1)).all():
        raise InputError("motor speeds must lie in [0, 1]", field="start")
    away = wanted - begin[:6]
    away[2] = away[2] if goal.turn == "exact" else wrapped(np, away[2])
    if len(points) == 0 and (np.isnan(away) | (np.abs(away) < _SAME)).all():
        raise InputError("is where the craft is already", field="goal")
    _check_braking(request, begin[:5], "start", "hits the rail whatever it does")
    if goal.velocity is not None:
        backwards = np.concatenate([wanted[:3], -wanted[3:5]])
        _check_braking(request, backwards, "goal", "must have come from beyond the rail")
    return request


def _numbers(values: Numbers, field: str, lengths: tuple[int, ...]) -> Float[np.ndarray, " k"]:
    """Return finite numbers, or raise InputError."""
    array = numbers_of(values, (None,), field)
    if len(array) not in lengths:
        raise InputError(f"must be {' or '.join(map(str, lengths))} numbers", field=field)
    return array


def _rows(values: Sequence[Numbers], field: str, width: int) -> Float[np.ndarray, "k width"]:
    """Return rows of finite numbers, or raise InputError."""
    if len(values) > _MOST_POINTS:
        raise InputError(f"must be at most {_MOST_POINTS} entries", field=field)
    return np.array([_numbers(row, field, (width,)) for row in values]).reshape(-1, width)


def _check_motion(request: Request, motion: Float[np.ndarray, " 4"], field: str) -> None:
    """Reject a yaw of many turns, and rates beyond the limits."""
    yaw, vx, vy, spin = motion
    limits = request.limits
    if abs(yaw) > _MOST_YAW:
        raise InputError(
            f"a yaw of {yaw:g} rad is {abs(yaw) / (2 * np.pi):.0f} turns; use radians, at most "
            f"{_MOST_YAW:g}",
            field=field,
        )
    fastest = np.nanmax(np.abs([vx, vy, 0.0]))
    if fastest > limits.speed:
        problem = f"its speed, {fastest:g} m/s, is above the limit of {limits.speed:g} m/s"
        raise InputError(problem, field=field)
    if abs(spin) > limits.spin:
        problem = f"its yaw rate, {spin:g} rad/s, is above the limit of {limits.spin:g} rad/s"
        raise InputError(problem, field=field)


def _check_place(request: Request, name: str, place: Float[np.ndarray, " 2"]) -> None:
    """Reject a place outside the rails, or where the craft would touch a disc."""
    x, y = (float(v) for v in place)
    if max(abs(x), abs(y)) > _FARTHEST:
        raise InputError(f"({x:g}, {y:g}) m is not on the table", field=name)
    reach = request.reach
    if abs(x) > reach[0] or abs(y) > reach[1]:
        raise InputError(
            f"({x:g}, {y:g}) is outside the rails: the craft's centre can be within "
            f"±{reach[0]:g} m by ±{reach[1]:g} m",
            field=name,
        )
    for cx, cy, radius in request.keep_out:
        if math.hypot(x - cx, y - cy) < radius:
            raise InputError(
                f"({x:g}, {y:g}) is inside the keep-out disc around ({cx:g}, {cy:g}): "
                f"the craft's centre must stay {radius:g} m away",
                field=name,
            )


def _check_braking(request: Request, state: Float[np.ndarray, " 5"], field: str, fate: str) -> None:
    """Reject a velocity towards a rail that even the hardest braking cannot stop in time."""
    if not has_bounds(request.model, request.limits):
        return
    times = np.arange(_STEP, _LONGEST_BRAKING, _STEP)
    known = times if field == "start" else np.full_like(times, np.inf)
    push = strongest_push(request.model, request.limits, request.start[6:], known)
    lost = np.cumsum(push) * _STEP
    for axis, name in enumerate("xy"):
        velocity = float(state[3 + axis])
        room = request.reach[axis] - float(state[axis]) * np.sign(velocity)
        travelled = float(np.maximum(abs(velocity) - lost, 0.0).sum() * _STEP)
        if travelled > room + _ROUNDING:
            raise InputError(
                f"at {abs(velocity):g} m/s towards a rail {room:.3f} m away along {name}, it "
                f"{fate}: no thrust stops it in less than {travelled:.3f} m",
                field=field,
            )


def motor_range(
    model: Model, speed: Float[np.ndarray, " n"], times: Float[np.ndarray, " K"]
) -> tuple[Float[np.ndarray, "n K"], Float[np.ndarray, "n K"]]:
    """Return bounds of the motor speeds at given times (eq. motor_dynamics)."""
    vehicle, lag = model.vehicle, float(model.dynamics.motor_time_constant)
    lag *= 1 + min(float(model.dynamics.idle_lag or 0.0), 0.0)
    left = lag_decay(np, times, lag)
    low = np.minimum(vehicle.command_min, speed)[:, None] * np.ones_like(left)
    high = np.maximum(vehicle.command_max, speed)[:, None]
    return low, high + (speed[:, None] - high) * left


def thrust_range(
    model: Model, speeds: tuple[Float[np.ndarray, "n K"], Float[np.ndarray, "n K"]], limits: Limits
) -> tuple[Float[np.ndarray, "n K"], Float[np.ndarray, "n K"]]:
    """Return the lowest and highest thrusts over a range of speeds, effects included."""
    curves = np.asarray(model.dynamics.thrust)
    # A polynomial is extreme at the ends of the range, or at a stationary point within it.
    powers = np.arange(1, curves.shape[1] + 1)
    stationary = [np.roots((row * powers)[::-1]).real for row in curves]
    longest = max(map(len, stationary))
    points = np.array([np.resize(np.append(one, 0.0), longest + 1) for one in stationary])
    inside = np.clip(points.T[:, :, None], *speeds)
    forces = np.stack([thrust(curves, one) for one in (*speeds, *inside)])
    low, high = forces.min(axis=0), forces.max(axis=0)
    for effect in model.dynamics.effects:
        low, high = effect.thrust_bounds(low, high, _envelope(limits)) or (low, high)
    return low, high


def has_bounds(model: Model, limits: Limits) -> bool:
    """Return whether every effect bounds its contribution."""
    within = _envelope(limits)
    low, high = _all_speeds(model)
    for effect in model.dynamics.effects:
        bounds = effect.thrust_bounds(low, high, within)
        if bounds is None or effect.acceleration_bound(within) is None:
            return False
        low, high = bounds
    return True


def _envelope(limits: Limits) -> Envelope:
    return Envelope(math.sqrt(2) * limits.speed, limits.spin)


def _all_speeds(model: Model) -> tuple[Float[np.ndarray, "n 1"], Float[np.ndarray, "n 1"]]:
    """Return the range of motor speeds after a long time."""
    idle = np.full(model.vehicle.n_propellers, model.vehicle.command_min)
    return motor_range(model, idle, np.array([np.inf]))


def added_accelerations(model: Model, limits: Limits) -> tuple[float, float]:
    """Return the largest linear and angular accelerations that effects add, apart from gravity."""
    stated = [e.acceleration_bound(_envelope(limits)) for e in model.dynamics.effects]
    known = [bound for bound in stated if bound is not None]
    return sum(b[0] for b in known), sum(b[1] for b in known)


def gravity(model: Model) -> complex:
    """Return the constant acceleration in the world frame, x + iy [m/s²]."""
    pulls = (e.gravity for e in model.dynamics.effects if e.gravity is not None)
    return sum((complex(*pull) for pull in pulls), 0j)


def largest_moment(model: Model, limits: Limits) -> float:
    """Return the largest angular acceleration, either way, effects included [rad/s²]."""
    turn = np.asarray(model.dynamics.configuration)[2]
    least, most = weighted_range(turn, *thrust_range(model, _all_speeds(model), limits))
    return float(max(most[0], -least[0])) + added_accelerations(model, limits)[1]


def strongest_thrust(
    model: Model, low: Float[np.ndarray, "n K"], high: Float[np.ndarray, "n K"]
) -> Float[np.ndarray, " K"]:
    """Bound the linear acceleration of thrusts within a range, over all yaws."""
    push = pushes(model, 2 * np.pi * np.arange(_YAWS) / _YAWS)
    return weighted_range(push, low, high)[1].max(axis=0) / _BETWEEN_YAWS


def pushes(model: Model, angles: Float[np.ndarray, " Y"]) -> Float[np.ndarray, "Y n"]:
    """Return the acceleration along a direction per unit of each thrust, at angles to it."""
    forward, left, _ = np.asarray(model.dynamics.configuration)
    return np.cos(angles)[:, None] * forward - np.sin(angles)[:, None] * left


def strongest_push(
    model: Model, limits: Limits, motors: Float[np.ndarray, " n"], times: Float[np.ndarray, " K"]
) -> Float[np.ndarray, " K"]:
    """Bound the acceleration of the geometric centre at times since given motor speeds.

    The bound holds for all yaws. At infinite times it holds for any motor speeds.
    """
    ranges = thrust_range(model, motor_range(model, motors, times), limits)
    offset = float(np.hypot(*model.dynamics.center_of_mass))
    turned = offset * (limits.spin**2 + largest_moment(model, limits))
    added = added_accelerations(model, limits)[0] + abs(gravity(model))
    return strongest_thrust(model, *ranges) + turned + added
