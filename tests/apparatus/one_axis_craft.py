"""Crafts of which the fastest flight is known by hand."""

import numpy as np

from airpuck.craft.vehicle import Nominal, Propeller, Vehicle
from airpuck.model.model_file import nominal_model

#: Thrusts of the propellers [N] and mass [kg].
THRUST, WEAK, MASS = 0.5, 1e-4, 0.25


def one_axis(lag: float = 0.0):
    """Two propellers push along x, through the centre; four weak ones push along y and turn.

    Thrust goes with the speed. The weak ones are so weak that a flight along x is that of the
    first two, to six digits.
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


#: Of `one_axis` [m/s²].
ACCELERATION = THRUST / MASS


def at_rest(x: float) -> np.ndarray:
    return np.array([x, 0.0, 0.0])
