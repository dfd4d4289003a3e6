"""The plant: a craft on a table, as pure functions of its state."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from airpuck.compute.arrays import if_any
from airpuck.compute.compiled import program
from airpuck.craft.table import Table
from airpuck.model.model_file import Model
from airpuck.physics.rigid_body import Dynamics
from airpuck.physics.rollout import step

#: Longest step of the integration [s]: below half the period of control.
LONGEST_STEP = 1 / 240


@dataclass(frozen=True)
class Disc:
    """What a rail meets."""

    #: [kg].
    mass: Any
    #: About the centre of mass [kg m²].
    inertia: Any
    #: [m].
    radius: Any


@dataclass(frozen=True, eq=False)
class Plant:
    """A craft on a table.

    Attributes
    ----------
    model : Model
        The truth of this world.
    table : Table
        Its rails.
    dynamics : Dynamics
        The model's coefficients, with optional effects.
    """

    model: Model
    table: Table
    dynamics: Dynamics

    @property
    def disc(self) -> Disc:
        """What a rail meets."""
        vehicle = self.model.vehicle
        return Disc(vehicle.mass_kg, float(self.model.parameters.inertia), vehicle.radius_m)

    @cached_property
    def advance(self) -> Callable[..., Any]:
        """Compiled ``(state, command, duration, thrust scales) -> (state, met)`` of one craft.

        `met` says whether it met a rail.
        """

        def advanced(
            xp: Any, state: Any, command: Any, duration: Any, scale: Any
        ) -> tuple[Any, Any]:
            dynamics = scaled(self.dynamics, scale[:, None])
            free = step(xp, dynamics, state, command, duration)
            state = rebound(xp, dynamics, self.disc, self.table, free)
            return state, (state != free).any()

        n = self.model.vehicle.n_propellers
        return program(advanced, np.zeros(6 + n), np.zeros(n), 0.0, np.ones(n), compiled=True)


def scaled(dynamics: Dynamics, factor: Any) -> Dynamics:
    """Scale thrusts."""
    return replace(dynamics, thrust=dynamics.thrust * factor)


def advance(
    xp: Any, dynamics: Dynamics, disc: Disc, table: Table, state: Any, command: Any, duration: Any
) -> Any:
    """Advance a craft by one step of the integration; rails push it back."""
    return rebound(xp, dynamics, disc, table, step(xp, dynamics, state, command, duration))


def rebound(xp: Any, dynamics: Dynamics, disc: Disc, table: Table, state: Any) -> Any:
    """Push a craft back that went beyond a rail."""
    x_reach, y_reach = table.reach(disc.radius)
    beyond = (xp.abs(state[0]) > x_reach) | (xp.abs(state[1]) > y_reach)

    def bounced(state: Any) -> Any:
        state = _bounce(xp, dynamics, disc, table, state, axis=0, reach=x_reach)
        return _bounce(xp, dynamics, disc, table, state, axis=1, reach=y_reach)

    # A rail is met rarely, and its impulse costs more than the step of the integration.
    return if_any(xp, beyond, bounced, state)


def _bounce(
    xp: Any, dynamics: Dynamics, disc: Disc, table: Table, state: Any, *, axis: int, reach: float
) -> Any:
    """Apply the impulse of the rails across one axis.

    Newton's law of restitution in the normal direction; in the tangential one an impulse that
    stops the slip if the cone of friction allows that, and otherwise lies on the cone.
    """
    position, speed = state[axis], state[3 + axis]
    side = xp.sign(position)
    depth = xp.abs(position) - reach
    meets = (depth > 0) & (side * speed > 0)

    # From the centre of mass to the contact, along the normal (into the table) and the tangent,
    # the normal turned by 90 degrees.
    yaw, spin = state[2], state[5]
    rx, ry = dynamics.center_of_mass[0], dynamics.center_of_mass[1]
    if dynamics.frame == "body":
        cos, sin = xp.cos(yaw), xp.sin(yaw)
        rx, ry = cos * rx - sin * ry, sin * rx + cos * ry
    nx, ny = (-side, 0.0 * side) if axis == 0 else (0.0 * side, -side)
    arm_n = -disc.radius - (rx * nx + ry * ny)
    arm_t = -(ry * nx - rx * ny)
    normal_speed = state[3] * nx + state[4] * ny
    slip = state[4] * nx - state[3] * ny - disc.radius * spin

    # Velocity of the contact per impulse.
    k_nn = 1 / disc.mass + arm_t**2 / disc.inertia
    k_tt = 1 / disc.mass + arm_n**2 / disc.inertia
    k_nt = -arm_n * arm_t / disc.inertia
    wanted_n, wanted_t = -(1 + table.restitution) * normal_speed, -slip
    determinant = k_nn * k_tt - k_nt**2
    stick_n = (k_tt * wanted_n - k_nt * wanted_t) / determinant
    stick_t = (k_nn * wanted_t - k_nt * wanted_n) / determinant
    sign = xp.sign(wanted_t)
    slide_n = wanted_n / (k_nn + table.friction * sign * k_nt)
    sticks = xp.abs(stick_t) <= table.friction * stick_n
    impulse_n = xp.where(sticks, stick_n, slide_n)
    impulse_t = xp.where(sticks, stick_t, table.friction * sign * slide_n)
    # With friction and an offset centre of mass, Newton's law can add energy (Kane and Levinson
    # 1985). Where it would, the rail is taken to be smooth.
    work = impulse_n * (normal_speed + (k_nn * impulse_n + k_nt * impulse_t) / 2) + impulse_t * (
        slip + (k_nt * impulse_n + k_tt * impulse_t) / 2
    )
    impulse_n = xp.where(work > 0, wanted_n / k_nn, impulse_n)
    impulse_t = xp.where(work > 0, 0.0, impulse_t)

    # Of the centre of mass, then of the geometric centre, which turns about it.
    turned = (arm_n * impulse_t - arm_t * impulse_n) / disc.inertia
    gained_x = (impulse_n * nx - impulse_t * ny) / disc.mass + turned * ry
    gained_y = (impulse_n * ny + impulse_t * nx) / disc.mass - turned * rx
    zero = 0.0 * position
    # What it went too far it comes back, at the speed it has now.
    back = -side * depth * (1 + table.restitution)
    change = [back if axis == 0 else zero, back if axis == 1 else zero]
    change += [zero, gained_x, gained_y, turned]
    moved = state[:6] + xp.where(meets, xp.stack(change), 0.0)
    return xp.concatenate([moved, state[6:]])
