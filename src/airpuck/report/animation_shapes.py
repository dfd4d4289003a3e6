"""Shapes of an animation: the craft in its own frame, and the arrows of its thrusts."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from airpuck.craft.vehicle import Vehicle
from airpuck.physics.thrust import thrust

#: Colours that only animations need: the table, and what the craft was asked to do.
FLOOR, HOLES, GRID, RAIL = "#f4f7fa", "#cbd6e0", "#dfe6ed", "#a5b2bf"
ASKED = "#a93f7c"
#: An arrow of the largest thrust is as long as this many radii of the craft.
_LONGEST_ARROW = 4.5
#: Half width of an arrow's shaft, half width and length of its head, in radii of the craft.
SHAFT, HEAD_WIDTH, HEAD_LENGTH = 0.07, 0.21, 0.42


def arrow_scale(vehicle: Vehicle) -> float:
    """Return how long the arrow of a thrust is."""
    full = _largest_thrust(vehicle)
    return _LONGEST_ARROW * vehicle.radius_m / full if full > 0 else 0.0


def _largest_thrust(vehicle: Vehicle) -> float:
    """Return the largest nominal thrust at full command [N]."""
    full = thrust(vehicle.nominal_thrust, np.ones(vehicle.n_propellers))
    return float(np.abs(full).max())


def thrust_arrows(
    vehicle: Vehicle, pose: Float[np.ndarray, "F 3"], command: Float[np.ndarray, "F n"]
) -> Float[np.ndarray, "F n 2 2"]:
    """Say where the arrows of the commanded thrusts start and end."""
    cos, sin = np.cos(pose[:, 2]), np.sin(pose[:, 2])
    turn = np.stack([np.stack([cos, -sin], axis=-1), np.stack([sin, cos], axis=-1)], axis=-2)
    start = pose[:, None, :2] + np.einsum("fij,nj->fni", turn, vehicle.positions)
    force = thrust(vehicle.nominal_thrust, command.T).T[..., None]
    push = np.einsum("fij,nj->fni", turn, vehicle.directions)
    return np.stack([start, start + arrow_scale(vehicle) * force * push], axis=2)


def arrow_shapes(arrows: Float[np.ndarray, "n 2 2"], radius: float) -> Float[np.ndarray, "n 7 2"]:
    """Return the outlines of arrows."""
    along = arrows[:, 1] - arrows[:, 0]
    length = np.hypot(along[:, 0], along[:, 1])
    unit = along / np.where(length > 0, length, 1.0)[:, None]
    left = np.stack([-unit[:, 1], unit[:, 0]], axis=1)
    size = radius * np.minimum(1.0, length / (1.6 * HEAD_LENGTH * radius))
    neck = length - HEAD_LENGTH * size
    zero = np.zeros_like(length)
    shaft, head = SHAFT * size, HEAD_WIDTH * size
    corners = (
        (zero, shaft),
        (neck, shaft),
        (neck, head),
        (length, zero),
        (neck, -head),
        (neck, -shaft),
        (zero, -shaft),
    )
    points = [
        arrows[:, 0] + forward[:, None] * unit + side[:, None] * left for forward, side in corners
    ]
    return np.stack(points, axis=1)


def heading_mark(vehicle: Vehicle) -> Float[np.ndarray, "3 2"]:
    """Return the mark that says where the front is."""
    return vehicle.radius_m * np.array([[1.3, 0.0], [1.0, 0.24], [1.0, -0.24]])


def propeller_size(vehicle: Vehicle) -> float:
    """Return the radius that propellers are drawn with: they must not overlap."""
    x, y = vehicle.positions.T
    apart = np.hypot(x[:, None] - x, y[:, None] - y)
    np.fill_diagonal(apart, np.inf)
    # Propellers that share an axle are drawn on top of each other.
    closest = float(np.where(apart > 1e-3, apart, np.inf).min())
    return min(0.16 * vehicle.radius_m, 0.42 * closest)


def round_thrust(vehicle: Vehicle) -> float:
    """Return a round thrust that an arrow in the key can stand for."""
    full = _largest_thrust(vehicle) / 2
    power = 10.0 ** np.floor(np.log10(full)) if full > 0 else 1.0
    return float(max(k * power for k in (1, 2, 5) if k == 1 or k * power <= full))


def short_names(names: tuple[str, ...]) -> list[str]:
    """Return names without the words that all begin with."""
    words = [name.split("_") for name in names]
    # The last word of a name is always its own.
    most = min(map(len, words)) - 1 if len(names) > 1 else 0
    alike = [len({word[k] for word in words}) == 1 for k in range(most)]
    cut = alike.index(False) if False in alike else most
    return [" ".join(word[cut:]) for word in words]
