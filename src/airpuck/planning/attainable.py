"""Bounds on what the propellers can produce, whatever the craft does: for braking and certificates.

Every number here is an upper bound (docs/planning.md) if `has_bounds` is true: an effect that
states no bounds is left out.
"""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float

from airpuck.model.model_file import Model
from airpuck.physics.effects import Envelope
from airpuck.physics.thrust import thrust
from airpuck.planning.settings import Limits

#: Number of yaws per turn that `strongest_push` evaluates.
_YAWS = 314
#: The push at the nearest of these yaws is at least this fraction of the push at any yaw.
_BETWEEN_YAWS = math.cos(math.pi / _YAWS)


def motor_range(
    model: Model, speed: Float[np.ndarray, " n"], times: Float[np.ndarray, " K"]
) -> tuple[Float[np.ndarray, "n K"], Float[np.ndarray, "n K"]]:
    """Return bounds of the motor speeds at given times (eq. motor_dynamics)."""
    vehicle, lag = model.vehicle, float(model.dynamics.motor_time_constant)
    lag *= 1 + min(float(model.dynamics.idle_lag or 0.0), 0.0)
    left = np.exp(-times / lag) if lag > 0 else np.zeros_like(times)
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


def moment_range(
    model: Model, low: Float[np.ndarray, "n *K"], high: Float[np.ndarray, "n *K"]
) -> tuple[Float[np.ndarray, " *K"], Float[np.ndarray, " *K"]]:
    """Return the lowest and highest angular accelerations of thrusts within a range [rad/s²]."""
    turn = np.asarray(model.dynamics.configuration)[2]
    up, down = np.maximum(turn, 0.0), np.minimum(turn, 0.0)
    return np.asarray(up @ low + down @ high), np.asarray(up @ high + down @ low)


def largest_moment(model: Model, limits: Limits) -> float:
    """Return the largest angular acceleration, either way, effects included [rad/s²]."""
    least, most = moment_range(model, *thrust_range(model, _all_speeds(model), limits))
    return float(max(most[0], -least[0])) + added_accelerations(model, limits)[1]


def strongest_thrust(
    model: Model, low: Float[np.ndarray, "n K"], high: Float[np.ndarray, "n K"]
) -> Float[np.ndarray, " K"]:
    """Bound the linear acceleration of thrusts within a range, over all yaws."""
    yaw = 2 * np.pi * np.arange(_YAWS) / _YAWS
    forward, left = np.asarray(model.dynamics.configuration)[:2]
    push = np.cos(yaw)[:, None] * forward - np.sin(yaw)[:, None] * left
    most = np.maximum(push, 0) @ high + np.minimum(push, 0) @ low
    return most.max(axis=0) / _BETWEEN_YAWS


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
