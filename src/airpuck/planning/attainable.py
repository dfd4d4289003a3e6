"""What the propellers can give, whatever the craft does: the sets behind braking and certificate.

Proofs of what bounds what are in docs/planning.md.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from airpuck.model.model_file import Model
from airpuck.physics.effects import GRAVITY, Drag, Inflow, PairInteraction, Tilt, VoltageSag
from airpuck.physics.thrust import thrust

if TYPE_CHECKING:
    from airpuck.planning.request import Limits, Request

#: Yaws at which tables stand, one turn.
YAWS = 314
#: The push at the nearest of them is at least this share of that in between.
_BETWEEN_YAWS = math.cos(math.pi / YAWS)
#: Accelerations that no thrust gives.
IMPOSSIBLE = -1e4


def motor_range(
    model: Model, speed: Float[np.ndarray, " n"], times: Float[np.ndarray, " K"]
) -> tuple[Float[np.ndarray, "n K"], Float[np.ndarray, "n K"]]:
    """Return the lowest and highest speeds that motors can have by then (eq. motor_dynamics)."""
    vehicle, lag = model.vehicle, float(model.dynamics.motor_time_constant)
    left = np.exp(-times / lag) if lag > 0 else np.zeros_like(times)
    low = np.minimum(vehicle.command_min, speed)[:, None] * np.ones_like(left)
    high = np.maximum(vehicle.command_max, speed)[:, None]
    return low, high + (speed[:, None] - high) * left


def thrust_range(
    model: Model,
    speeds: tuple[Float[np.ndarray, "n K"], Float[np.ndarray, "n K"]],
    limits: Limits,
) -> tuple[Float[np.ndarray, "n K"], Float[np.ndarray, "n K"]]:
    """Return the lowest and the highest thrusts at speeds within a range, with the effects."""
    low_speed, high_speed = speeds
    share = np.linspace(0, 1, 33)[:, None, None]
    between = low_speed + share * (high_speed - low_speed)
    forces = np.stack([thrust(model.dynamics.thrust, one) for one in between])
    low, high = forces.min(axis=0), forces.max(axis=0)
    total = np.abs(high).sum(axis=0)
    for effect in model.dynamics.effects:
        if isinstance(effect, PairInteraction):
            low = low / (1 + abs(effect.coefficient) * total)
        elif isinstance(effect, VoltageSag):
            most = np.abs(np.asarray(effect.weights)) @ np.abs(high)
            low = low * (2 / (1 + np.sqrt(1 + 4 * abs(effect.coefficient) * most))) ** 2
        elif isinstance(effect, Inflow):
            axes = np.abs(np.asarray(effect.axes))
            axial = axes @ np.array([math.sqrt(2) * limits.speed] * 2 + [limits.spin])
            share = (abs(effect.coefficient) * axial)[:, None]
            low, high = low * np.maximum(1 - share, 0.0), high * (1 + share)
    return low, high


def unaccounted(model: Model, limits: Limits) -> tuple[float, float]:
    """Return the most that drag and an offset centre of mass add, linear and angular.

    An offset that is fixed to the body adds nothing to the motion of the centre of mass.
    """
    fastest, spin, linear, angular = math.sqrt(2) * limits.speed, limits.spin, 0.0, 0.0
    dynamics = model.dynamics
    for effect in dynamics.effects:
        if isinstance(effect, Drag):
            linear += (abs(effect.linear) + abs(effect.quadratic) * fastest) * fastest
            angular += (abs(effect.spin_linear) + abs(effect.spin_quadratic) * spin) * spin
    if dynamics.frame == "world":
        offset = float(np.hypot(*dynamics.center_of_mass))
        linear += offset * (spin**2 + angular + largest_moment(model, limits))
    return linear, angular


def slope_of_table(model: Model) -> complex:
    """Return the acceleration that a tilted table adds, x + iy [m/s²]."""
    tilts = (e for e in model.dynamics.effects if isinstance(e, Tilt))
    return sum((GRAVITY * complex(e.x, e.y) for e in tilts), 0j)


def largest_moment(model: Model, limits: Limits) -> float:
    """Return the largest angular acceleration of the thrusts, either way [rad/s²]."""
    n = model.vehicle.n_propellers
    ends = motor_range(model, np.full(n, model.vehicle.command_min), np.array([np.inf]))
    low, high = thrust_range(model, ends, limits)
    turn = np.asarray(model.dynamics.configuration)[2][:, None]
    most = np.maximum(turn * low, turn * high).sum()
    least = np.minimum(turn * low, turn * high).sum()
    return float(max(most, -least))


def pushes(model: Model) -> Float[np.ndarray, "yaws n"]:
    """Return what each newton pushes the craft along a direction, at each yaw against it."""
    yaw = 2 * np.pi * np.arange(YAWS) / YAWS
    forward, left = np.asarray(model.dynamics.configuration)[:2]
    return np.cos(yaw)[:, None] * forward - np.sin(yaw)[:, None] * left


def strongest_push(
    request: Request, times: Float[np.ndarray, " K"], *, motors_known: bool = True
) -> Float[np.ndarray, " K"]:
    """Bound the acceleration in any direction at times since the start, at whatever yaw."""
    model, limits = request.model, request.limits
    if not motors_known:
        times = np.full_like(times, np.inf)
    speeds = motor_range(model, request.start[6:], times)
    low, high = thrust_range(model, speeds, limits)
    push = pushes(model)
    most = (np.maximum(push, 0) @ high + np.minimum(push, 0) @ low).max(axis=0)
    offset = float(np.hypot(*model.dynamics.center_of_mass))
    if model.dynamics.frame == "body":
        most = most + offset * (limits.spin**2 + largest_moment(model, limits))
    extra = unaccounted(model, limits)[0] + abs(slope_of_table(model))
    return most / _BETWEEN_YAWS + extra


def frontier(
    model: Model,
    low: Float[np.ndarray, " n"],
    high: Float[np.ndarray, " n"],
    moments: Float[np.ndarray, " B"],
    extra: tuple[float, float],
) -> Float[np.ndarray, "yaws B"]:
    """Find the largest push along a direction at each yaw and moment, a linear program each.

    Its dual has one unknown μ: min over μ of max over F of (push + μ turn)·F - μ moment, whose
    minimum lies where one term changes its sign. Beyond what thrusts give, `extra` of both. Moments
    are evenly spaced, half of what separates the ones that count.
    """
    turn = np.asarray(model.dynamics.configuration)[2]
    push = pushes(model)
    with np.errstate(divide="ignore", invalid="ignore"):
        prices = np.nan_to_num(-push / turn, nan=0.0, posinf=0.0, neginf=0.0)
    prices = np.append(prices, np.zeros((YAWS, 1)), axis=1)
    gains = push[:, None, :] + prices[:, :, None] * turn
    most = np.where(gains > 0, gains * high, gains * low).sum(axis=-1)
    most = most + np.abs(prices) * extra[1]
    highest = np.maximum(turn * low, turn * high).sum() + extra[1]
    lowest = np.minimum(turn * low, turn * high).sum() - extra[1]
    # The first moment beyond either end stands for that end.
    within = np.clip(moments, lowest, highest)
    table = (most[:, :, None] - prices[:, :, None] * within).min(axis=1)
    table = table / _BETWEEN_YAWS + extra[0]
    spacing = 2 * (moments[1] - moments[0])
    return np.where(np.abs(moments - within) < spacing, table, IMPOSSIBLE)
