"""The plant: a craft on a table, as pure functions of its state."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from airpuck.compute.arrays import if_any
from airpuck.compute.compiled import program
from airpuck.craft.actuators import Actuators, Propellers
from airpuck.craft.table import Table
from airpuck.model.model_file import Model
from airpuck.model.parameters import Parameters, make_effects
from airpuck.physics.puck import contact_impulse, mobility
from airpuck.physics.rigid_body import Dynamics, step
from airpuck.twin.settings import TwinSettings, default_twin_settings

#: Longest integration step [s]: less than half the control period.
LONGEST_STEP = 1 / 240


def build_plant(
    model: Model, settings: TwinSettings | None = None, *, compiled: bool = True
) -> Plant:
    """Put a craft on a table, with the effects of its model and of the settings.

    Parameters
    ----------
    model : Model
        The truth.
    settings : TwinSettings, optional
        Table and effects; by default the paper's.
    compiled : bool, default True
        Whether to compile its steps (a second, once) or to run them in NumPy.

    Returns
    -------
    Plant
        Compiled once, however many twins fly it.
    """
    settings = settings or default_twin_settings()
    layout = model.parameters.layout(np, model.vehicle)
    switched_on = make_effects(settings.effects.coefficients(), layout)
    dynamics = replace(model.dynamics, effects=model.dynamics.effects + switched_on)
    vehicle, inertia = model.vehicle, float(model.parameters.inertia)
    body = CraftBody(vehicle.mass_kg, inertia, vehicle.radius_m)
    return Plant(dynamics, body, settings.table, vehicle.actuators, compiled)


@dataclass(frozen=True)
class CraftBody:
    """The craft's properties for contacts with a rail."""

    #: [kg].
    mass: Any
    #: Moment of inertia about the centre of mass [kg m²].
    inertia: Any
    #: [m].
    radius: Any


@dataclass(frozen=True, eq=False)
class Plant:
    """A craft on a table: coefficients with all effects, disc and rails."""

    dynamics: Dynamics
    disc: CraftBody
    table: Table
    #: Kind of the thrusters.
    actuators: Actuators = field(default_factory=Propellers)
    #: Whether `advance` is compiled, or run in NumPy.
    compiled: bool = True

    @cached_property
    def advance(self) -> Callable[..., Any]:
        """Function ``(state, drive, duration, thrust scales) -> (state, met)`` of one craft.

        `met` tells whether it met a rail.
        """

        def advanced(xp: Any, state: Any, drive: Any, duration: Any, scale: Any) -> Any:
            dynamics = scaled(self.dynamics, scale[:, None])
            lag = self.actuators.lag(xp, drive, dynamics.motor_time_constant)
            dynamics = replace(dynamics, motor_time_constant=lag)
            free = step(xp, dynamics, state, drive, duration)
            state = rebound(xp, replace(self, dynamics=dynamics), free)
            return state, (state != free).any()

        n = self.dynamics.configuration.shape[1]
        examples = np.zeros(6 + n), np.zeros(n), 0.0, np.ones(n)
        return program(advanced, *examples, compiled=self.compiled)


def scaled(dynamics: Dynamics, factor: Any) -> Dynamics:
    """Scale thrusts."""
    return replace(dynamics, thrust=dynamics.thrust * factor)


def advance(xp: Any, plant: Plant, state: Any, command: Any, duration: Any) -> Any:
    """Advance a craft, or a batch, by one integration step; rails push it back."""
    return rebound(xp, plant, step(xp, plant.dynamics, state, command, duration))


def rebound(xp: Any, plant: Plant, state: Any) -> Any:
    """Push a craft back that went beyond a rail."""
    x_reach, y_reach = plant.table.reach(plant.disc.radius)
    beyond = (xp.abs(state[0]) > x_reach) | (xp.abs(state[1]) > y_reach)

    def bounced(state: Any) -> Any:
        state = _bounce(xp, plant, state, axis=0, reach=x_reach)
        return _bounce(xp, plant, state, axis=1, reach=y_reach)

    # Contacts with a rail are rare, and their impulse costs more than the integration step.
    return if_any(xp, beyond, bounced, state)


def _bounce(xp: Any, plant: Plant, state: Any, *, axis: int, reach: float) -> Any:
    """Apply the impulse of the rails across one axis; friction may stop the slip."""
    dynamics, disc, table = plant.dynamics, plant.disc, plant.table
    position, speed = state[axis], state[3 + axis]
    side = xp.sign(position)
    depth = xp.abs(position) - reach
    meets = (depth > 0) & (side * speed > 0)

    # From the centre of mass to the contact, along the normal (into the table) and the tangent (the
    # normal turned by 90 degrees).
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

    impulse_n, impulse_t = contact_impulse(
        xp,
        mobility(disc.mass, disc.inertia, arm_n, arm_t),
        normal_speed,
        slip,
        table.restitution,
        table.friction,
    )

    # Velocity of the centre of mass, then of the geometric centre, which turns about it.
    turned = (arm_n * impulse_t - arm_t * impulse_n) / disc.inertia
    gained_x = (impulse_n * nx - impulse_t * ny) / disc.mass + turned * ry
    gained_y = (impulse_n * ny + impulse_t * nx) / disc.mass - turned * rx
    zero = 0.0 * position
    # The position rebounds like the speed: by 1 + e times the depth.
    back = -side * depth * (1 + table.restitution)
    along = (back, zero) if axis == 0 else (zero, back)
    change = [*along, zero, gained_x, gained_y, turned]
    return xp.concatenate([state[:6] + xp.where(meets, xp.stack(change), 0.0), state[6:]])


def moved(parameters: Parameters, spread: float, seed: int) -> Parameters:
    """Multiply thrusts, inertia and motor lag by random factors exp(spread · N(0, 1))."""
    rng = np.random.default_rng([seed, 7])
    inertia, lag, *thrusts = np.exp(spread * rng.normal(size=2 + len(parameters.thrust)))
    return replace(
        parameters,
        thrust=parameters.thrust * np.array(thrusts)[:, None],
        inertia=parameters.inertia * inertia,
        motor_time_constant=parameters.motor_time_constant * lag,
    )


def varied(model: Model, spread: float, seed: int) -> Model:
    """Return a model with `moved` parameters."""
    if not spread:
        return model
    return replace(model, parameters=moved(model.parameters, spread, seed), uncertainty=None)
