"""Craft whose fastest flight can be calculated by hand."""

import numpy as np

from airpuck.craft.vehicle import Nominal, Propeller, Vehicle
from airpuck.model.model_file import nominal_model

#: Thrusts of the propellers [N] and mass [kg].
THRUST, WEAK, MASS = 0.5, 1e-4, 0.25


def one_axis(lag: float = 0.0):
    """Two propellers push along x, through the centre; four weak ones push along y and turn.

    Thrust is proportional to speed. The weak propellers barely affect a flight along x: to six
    digits, it is the flight of the first two.
    """
    places = [
        ("forward", -0.03, 0.0),
        ("back", 0.03, 180.0),
        ("left front", 0.04, 90.0),
        ("right front", 0.04, 270.0),
        ("left rear", -0.04, 90.0),
        ("right rear", -0.04, 270.0),
    ]
    propellers = tuple(
        Propeller(name=name, position_m=(x, 0.0), direction_deg=angle) for name, x, angle in places
    )
    nominal = Nominal(
        thrust_N=((THRUST,),) * 2 + ((WEAK,),) * 4, inertia_kg_m2=5e-4, motor_time_constant_s=lag
    )
    vehicle = Vehicle(
        name="one axis", mass_kg=MASS, propellers=propellers, nominal=nominal, command_min=0.0
    )
    return nominal_model(vehicle)


#: Acceleration of `one_axis` [m/s²].
ACCELERATION = THRUST / MASS


def at_rest(x: float) -> np.ndarray:
    return np.array([x, 0.0, 0.0])


def ring(count: int):
    """Propellers on a ring that push inwards, skewed in alternating directions; an odd last one
    straight.

    Four or more can push and turn in any direction at once. Three cannot: they turn to move.
    """
    angles = 360 * np.arange(count) / count
    askew = [0.0 if k == count - 1 and count % 2 else 60.0 - 120.0 * (k % 2) for k in range(count)]
    propellers = tuple(
        Propeller(
            name=f"p{k}",
            position_m=(0.05 * np.cos(np.radians(angle)), 0.05 * np.sin(np.radians(angle))),
            direction_deg=float(angle + 180 + askew[k]),
        )
        for k, angle in enumerate(angles)
    )
    nominal = Nominal(thrust_N=(0.0, 0.4), inertia_kg_m2=3e-4)
    return nominal_model(
        Vehicle(name=f"ring of {count}", mass_kg=0.15, propellers=propellers, nominal=nominal)
    )
