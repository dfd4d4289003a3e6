"""The plant: a craft on a table, as pure functions of its state."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from airpuck.compute.arrays import if_any
from airpuck.compute.compiled import Applied, program
from airpuck.craft.actuators import Actuators, Propellers
from airpuck.craft.table import Contact, Table
from airpuck.model.model_file import Model
from airpuck.model.parameters import Parameters, make_effects
from airpuck.physics.puck import Disc, strike
from airpuck.physics.rigid_body import Dynamics, center_of_mass, register_pytrees, step
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
    disc = Disc(0.0, 0.0, radius=vehicle.radius_m, mass=vehicle.mass_kg, inertia=inertia)
    return Plant(dynamics, disc, settings.table, vehicle.actuators, compiled)


@dataclass(frozen=True, eq=False)
class Plant:
    """A craft on a table: coefficients with all effects, disc and rails."""

    dynamics: Dynamics
    #: The craft as a disc that meets rails.
    disc: Disc
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
        known, actuators = (self.dynamics, self.disc.inertia), self.actuators
        kind = replace(self, dynamics=None, disc=replace(self.disc, inertia=math.nan))

        def advanced(xp: Any, known: Any, state: Any, drive: Any, duration: Any, scale: Any) -> Any:
            dynamics, inertia = known
            dynamics = scaled(dynamics, scale[:, None])
            lag = actuators.lag(xp, drive, dynamics.motor_time_constant)
            dynamics = replace(dynamics, motor_time_constant=lag)
            free = step(xp, dynamics, state, drive, duration)
            plant = replace(kind, dynamics=dynamics, disc=replace(kind.disc, inertia=inertia))
            state = rebound(xp, plant, free)
            return state, (state != free).any()

        if self.compiled:
            register_pytrees()
        n = self.dynamics.configuration.shape[1]
        examples = np.zeros(6 + n), np.zeros(n), 0.0, np.ones(n)
        return program(Applied(advanced, known), *examples, compiled=self.compiled)


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
    table = plant.table
    position, speed = state[axis], state[3 + axis]
    side = xp.sign(position)
    depth = xp.abs(position) - reach
    meets = (depth > 0) & (side * speed > 0)

    x, y, yaw, vx, vy, spin = state[:6]
    offset = center_of_mass(plant.dynamics, "world", xp.cos(yaw), xp.sin(yaw))
    disc = replace(plant.disc, vx=vx, vy=vy, spin=spin, offset=offset)
    nx, ny = (-side, 0.0 * side) if axis == 0 else (0.0 * side, -side)
    rail = Contact(restitution=table.restitution, grip=1.0, friction=table.friction)
    strike(disc, Disc(0.0, 0.0), nx, ny, rail, xp)
    # The position rebounds like the speed: by 1 + e times the depth.
    back = -side * depth * (1 + table.restitution)
    place = (x + back, y) if axis == 0 else (x, y + back)
    bounced = xp.stack([*place, yaw, disc.vx, disc.vy, disc.spin])
    return xp.concatenate([xp.where(meets, bounced, state[:6]), state[6:]])


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
