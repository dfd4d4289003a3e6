"""Sizes of a craft that cannot be in SI units, and which unit they probably are in."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from jaxtyping import Float

#: Radii of crafts for tables [m].
_RADII, _USUAL_RADIUS = (0.005, 2.0), 0.1
#: Farthest propeller by the radius; mass by the square of the size [kg/m²]; inertia by mass and
#: square of the size, that of a disc being ½.
_FARTHEST, _MASS, _INERTIA = 5.0, (0.03, 500.0), (0.01, 20.0)
#: Largest thrust of a propeller by the craft's weight; longest lag and delay [s].
_THRUST, _TIME = 10.0, 1.0
_GRAVITY = 9.81

_LENGTHS = {"millimetres": 1e-3, "centimetres": 1e-2, "inches": 0.0254}
_MASSES = {"grams": 1e-3}
_INERTIAS = {"g m²": 1e-3, "kg cm²": 1e-4, "kg mm²": 1e-6, "g cm²": 1e-7, "g mm²": 1e-9}
_FORCES = {"gram-force": 1e-3 * _GRAVITY}
_TIMES = {"milliseconds": 1e-3, "microseconds": 1e-6}


def check_sizes(
    mass: float, radius: float, positions: Float[np.ndarray, "n 2"], inertia: float
) -> None:
    """Raise ValueError if sizes are inconsistent, with a guess at the wrong unit."""
    distance = np.hypot(*positions.T)
    k = int(np.argmax(distance))
    farthest = float(distance[k])
    if not _RADII[0] <= radius <= _RADII[1]:
        # Positions may be in that other unit, too.
        usual = farthest if 0.02 <= farthest <= 0.5 else _USUAL_RADIUS
        guess = _guess(radius, _LENGTHS, usual)
        raise ValueError(f"radius_m = {radius:g} is no radius of a craft in metres{guess}")
    if farthest > _FARTHEST * radius:
        x, y = positions[k]
        guess = _guess(farthest, _LENGTHS, 0.7 * radius)
        raise ValueError(
            f"propellers.{k}.position_m = [{x:g}, {y:g}] is {farthest / radius:.3g} times as far "
            f"out as radius_m = {radius:g}{guess}"
        )
    size = max(radius, farthest)
    if not _MASS[0] <= mass / size**2 <= _MASS[1]:
        raise ValueError(
            f"mass_kg = {mass:g} is no mass of a craft with a radius of {size:g} m"
            f"{_guess(mass, _MASSES, 20 * size**2)}"
        )
    if not _INERTIA[0] <= inertia / (mass * size**2) <= _INERTIA[1]:
        disc = 0.5 * mass * radius**2
        raise ValueError(
            f"nominal.inertia_kg_m2 = {inertia:g} is far from that of a disc of this mass and "
            f"radius, {disc:.2g}{_guess(inertia, _INERTIAS, disc)}"
        )


def check_nominal(mass: float, thrust: float, lag: float, delay: float) -> None:
    """Raise ValueError if full thrust, lag or delay are implausible."""
    if thrust > _THRUST * mass * _GRAVITY:
        raise ValueError(
            f"nominal.thrust_N sums up to {thrust:g} at full speed, "
            f"{thrust / (mass * _GRAVITY):.0f} times the craft's weight"
            f"{_guess(thrust, _FORCES, 0.3 * mass * _GRAVITY)}"
        )
    for name, time, usual in (
        ("motor_time_constant_s", lag, 0.03),
        ("transport_delay_s", delay, 0.02),
    ):
        if time > _TIME:
            guess = _guess(time, _TIMES, usual)
            raise ValueError(f"nominal.{name} = {time:g} is too long to fly with{guess}")


def _guess(value: float, units: Mapping[str, float], usual: float) -> str:
    """Ask for the unit in which a value comes nearest to what is usual, if it comes near."""
    apart = {name: abs(math.log(value * size / usual)) for name, size in units.items()}
    nearest = min(apart, key=lambda name: apart[name])
    return f": {nearest}?" if apart[nearest] < math.log(10) else ": in another unit?"
