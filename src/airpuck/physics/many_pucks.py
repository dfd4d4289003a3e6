"""Many untouched pucks at once: `PuckOnTable` over arrays, each puck with numbers of its own.

A prediction with its uncertainty needs twenty flights. One by one they take twice as long.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from airpuck.craft.table import AirHockey
from airpuck.physics.puck import STILL, Disc, strike, walls_of
from airpuck.physics.puck_on_table import MOST, WITHIN

#: The numbers of a puck that may differ.
PUCK_NUMBERS = ("drag_1_s", "spin_drag_1_s", "rail.restitution", "rail.grip")
#: A smaller drag has no effect; with none, the distance would be 0 / 0 [1/s].
_NO_DRAG = 1e-12


def puck_paths(
    equipment: AirHockey,
    states: Float[np.ndarray, "V 6"],
    numbers: Float[np.ndarray, "V 4"],
    after: Float[np.ndarray, " T"],
) -> Float[np.ndarray, "V T 6"]:
    """Return the states of untouched pucks after increasing times; in a goal, the state at entry.

    Parameters
    ----------
    equipment : AirHockey
        Table and puck.
    states : array, shape (V, 6)
        States at time 0.
    numbers : array, shape (V, 4)
        `PUCK_NUMBERS` of each puck, instead of the equipment's.
    after : array, shape (T,)
        Times [s].
    """
    puck, walls = equipment.puck, walls_of(equipment)
    rail = puck.rail.model_copy(update={"restitution": numbers[:, 2], "grip": numbers[:, 3]})
    rates, motion = np.maximum(numbers[:, [0, 0, 1]], _NO_DRAG), states[:, 3:]
    place = states[:, :3].copy()
    place[:, :2] = [walls.nearest(x, y) for x, y in states[:, :2].tolist()]
    found, end = np.empty((len(states), len(after), 6)), after.max(initial=0.0)
    # When the present free path began; infinite if the puck is followed no further.
    now, contacts = np.zeros(len(states)), np.zeros(len(states))
    with np.errstate(divide="ignore", invalid="ignore"):
        while True:
            sigma, goal, nx, ny = first_meetings(equipment, place, motion)
            lasts = -np.log1p(-np.minimum(rates[:, 0] * sigma, 1.0)) / rates[:, 0]
            # States beyond the next bounce are replaced in the next round.
            span = np.minimum(after - now[:, None], np.where(goal, lasts, np.inf)[:, None])
            path = np.concatenate(_coasted(place, motion, rates, np.maximum(span, 0.0)), axis=-1)
            np.copyto(found, path, where=(after >= now[:, None])[..., None])
            now = np.where(goal, np.inf, now + lasts)
            if not (now < end).any():
                return found
            place, motion = (part[:, 0] for part in _coasted(place, motion, rates, lasts[:, None]))
            vx, vy, spin = motion.T
            body = Disc(0.0, 0.0, vx, vy, spin, puck.radius_m, puck.mass_kg, puck.inertia)
            strike(body, Disc(0.0, 0.0), nx, ny, rail, np)
            # A wedged puck stops.
            contacts = np.where(lasts > WITHIN, 1, contacts + 1)
            motion = np.array([body.vx, body.vy, body.spin]).T * (contacts <= MOST)[:, None]


def _coasted(
    place: Float[np.ndarray, "V 3"],
    motion: Float[np.ndarray, "V 3"],
    rates: Float[np.ndarray, "V 3"],
    span: Float[np.ndarray, "V T"],
) -> tuple[Float[np.ndarray, "V T 3"], Float[np.ndarray, "V T 3"]]:
    """Return places and motions of pucks that coast for some times, each with drag of its own."""
    sigma = np.expm1(span[..., None] * -rates[:, None]) / -rates[:, None]
    motion = motion[:, None]
    return place[:, None] + motion * sigma, motion * (1 - rates[:, None] * sigma)


class Meetings(NamedTuple):
    """The next contacts of pucks with the table; see `airpuck.physics.puck.Meeting`."""

    sigma: Float[np.ndarray, " V"]
    #: Whether the puck enters a goal.
    goal: Bool[np.ndarray, " V"]
    nx: Float[np.ndarray, " V"]
    ny: Float[np.ndarray, " V"]


def first_meetings(
    equipment: AirHockey, place: Float[np.ndarray, "V 3"], motion: Float[np.ndarray, "V 3"]
) -> Meetings:
    """Return the first contact of each coasting puck: `Walls.first` over arrays."""
    table, radius = equipment.table, equipment.puck.radius_m
    line, half = table.length_m / 2, min(table.goal_width_m, table.width_m) / 2
    reach = np.array(table.reach(radius))
    at, speed = place[:, :2], motion[:, :2]
    side, moves = np.copysign(1.0, speed), np.abs(speed) > STILL
    # σ until each coordinate reaches the rails, and until the puck is between posts or in a goal.
    rail = np.maximum((side * reach - at) / speed, 0.0)
    inner = (side * [line + radius, half - radius] - at) / speed
    within = np.maximum(inner[:, 1], 0.0)
    beside = np.abs(at[:, 1] + speed[:, 1] * rail[:, 0]) >= half
    behind = np.abs(at[:, 0] + speed[:, 0] * within) >= line
    apart = at[:, None] - [(x, y) for x in (-line, line) for y in (-half, half)]
    candidates = np.column_stack(
        [
            np.where(moves[:, 1], rail[:, 1], np.inf),
            np.where(moves[:, 1] & behind, within, np.inf),
            np.where(moves[:, 0] & beside, rail[:, 0], np.inf),
            np.where(moves[:, 0] & (inner[:, 0] >= 0), inner[:, 0], np.inf),
            _sigma_to_posts(apart, speed[:, None], radius),
        ]
    )
    which, rows = candidates.argmin(axis=1), np.arange(len(place))
    sigma = candidates[rows, which]
    nx, ny = -side[:, 0] * (which == 2), -side[:, 1] * (which < 2)
    post = np.flatnonzero((which > 3) & np.isfinite(sigma))
    if len(post):
        normal = apart[post, which[post] - 4] + speed[post] * sigma[post, None]
        nx[post], ny[post] = (normal / np.linalg.norm(normal, axis=1, keepdims=True)).T
    return Meetings(sigma, which == 3, nx, ny)


def _sigma_to_posts(
    apart: Float[np.ndarray, "V P 2"], speed: Float[np.ndarray, "V 1 2"], radius: float
) -> Float[np.ndarray, "V P"]:
    """Return σ until pucks meet each post: `sigma_to_circle` over arrays."""
    towards = -(apart * speed).sum(axis=-1)
    outside = np.maximum((apart * apart).sum(axis=-1) - radius * radius, 0.0)
    discriminant = towards * towards - (speed * speed).sum(axis=-1) * outside
    meets = (towards > STILL * radius) & (discriminant >= 0)
    return np.where(meets, outside / (towards + np.sqrt(discriminant)), np.inf)
