"""Shots: the effect of a contact on the puck, its path, and its probability of scoring.

All functions take arrays over shots, in the player's own frame: the goal is at x = +length / 2.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from scipy.special import ndtr, ndtri

from airpuck import AirHockey
from airpuck.extend import Disc, strike
from airpuck_hockey.player.rival import Rival
from airpuck_hockey.player.tactic import Pitch
from airpuck_hockey.puck.prediction import PuckModel, axes_of

#: An opponent at the time of a shot: places of its disc [m], its radius [m], and its limits.
Opposed = tuple[Float[np.ndarray, "*m 2"], float, Rival]
#: Largest number of banks of a shot.
MOST_BOUNCES = 2
#: Acceleration and largest speed of an opponent who moves to cover a straight path of the puck
#: after a bank, once the puck is on that path [m/s², m/s].
_PUSH, _FASTEST = 15.0, 0.9
#: Standard deviation of an opponent's reach [m]: for direct shots, which depend on its reaction and
#: speed (from 400 shots of 3 to 6.5 m/s at scripted hands in position), and after banks.
_DIRECT_ERROR, _BANK_ERROR = 0.04, 0.1
#: Probability that the opponent reads a shot after 0, 1, 2 banks.
_READS = (1.0, 1.0, 0.5)
#: A puck's speed falls linearly with the distance travelled; beyond this share of the range it is
#: too slow to count.
_ROLLS_OUT = 0.98
#: A slower puck rests [m/s].
_RESTS = 1e-6
#: Largest offset of a contact, as a fraction of the sum of the radii.
_GRAZING = 0.95
#: Uncertain numbers of a shot: the puck's state (6), the craft's place and velocity (2, 2),
#: restitution and grip of the contact and of the rails (2, 2).
_DIMENSIONS = 14
#: Standard deviations of restitution and grip of contacts with the craft, which are not identified.
_RESTITUTION, _GRIP = 0.03, 0.1


@dataclass(frozen=True, eq=False)
class Contacts:
    """Contacts of the craft with the puck; arrays of one shape.

    Attributes
    ----------
    place : array, shape (..., 2)
        Position of the puck's centre [m].
    puck : array, shape (..., 3)
        Its velocity and angular velocity before [m/s, rad/s].
    normal : array, shape (...)
        Direction from the craft's centre to the puck's [rad].
    craft : array, shape (..., 2)
        Velocity of the craft [m/s].
    """

    place: Float[np.ndarray, "*n 2"]
    puck: Float[np.ndarray, "*n 3"]
    normal: Any
    craft: Float[np.ndarray, "*n 2"]


@dataclass(frozen=True, eq=False)
class Flights:
    """Results of shots; arrays over shots.

    Attributes
    ----------
    scores : array of bool
        Whether the puck scores without touching a post.
    bounces : array of int
        Number of side rails met until then.
    passes : array
        Probability of getting past the opponent.
    """

    scores: Bool[np.ndarray, "*n"]
    bounces: Float[np.ndarray, "*n"]
    passes: Float[np.ndarray, "*n"]


def unit(angle: Any) -> Float[np.ndarray, "*n 2"]:
    """Return the unit vectors of directions."""
    found = np.empty((*np.shape(angle), 2))
    np.cos(angle, out=found[..., 0])
    np.sin(angle, out=found[..., 1])
    return found


def struck(pitch: Pitch, contacts: Contacts) -> Float[np.ndarray, "*n 3"]:
    """Return velocity and yaw rate of the puck after contacts."""
    puck = pitch.equipment.puck
    vx, vy, spin = np.moveaxis(contacts.puck, -1, 0)
    body = Disc(0.0, 0.0, vx, vy, spin, puck.radius_m, puck.mass_kg, puck.inertia)
    craft_x, craft_y = np.moveaxis(contacts.craft, -1, 0)
    sizes = pitch.craft_radius, pitch.craft_mass, pitch.craft_inertia
    craft = Disc(0.0, 0.0, craft_x, craft_y, np.zeros_like(vx), *sizes)
    nx, ny = np.cos(contacts.normal), np.sin(contacts.normal)
    # A puck that already moves away does not bounce.
    closing = (vx - craft_x) * nx + (vy - craft_y) * ny < 0
    strike(body, craft, nx, ny, puck.craft, np)
    after = np.stack([body.vx, body.vy, body.spin], axis=-1)
    return np.where(closing[..., None], after, contacts.puck)


def flown(
    equipment: AirHockey,
    place: Float[np.ndarray, "*n 2"],
    motion: Float[np.ndarray, "*n 3"],
    opponent: Opposed | None = None,
) -> Flights:
    """Follow pucks over side rails to the opponent's goal line.

    Parameters
    ----------
    equipment : AirHockey
        Table and puck, whose laws of contact may hold a number for each shot.
    place, motion : array
        Initial position [m], and velocity and angular velocity [m/s, rad/s].
    opponent : Opposed, optional
        The opponent; by default there is none.

    Returns
    -------
    Flights
        Which score.
    """
    puck, table = equipment.puck, equipment.table
    reach, line = table.reach(puck.radius_m)[1], table.length_m / 2
    (x, y), (vx, vy, spin) = np.moveaxis(place, -1, 0), np.moveaxis(motion, -1, 0)
    bounces, scores = np.zeros_like(x), np.zeros(x.shape, dtype=bool)
    passes, going = np.ones_like(x), vx > 0
    drag = puck.drag_1_s
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        for bounce in range(MOST_BOUNCES + 1):
            to_line = (line - x) / vx
            to_rail = (np.copysign(reach, vy) - y) / vy
            to_rail = np.where(np.isfinite(to_rail), np.maximum(to_rail, 0.0), np.inf)
            arrives = to_line <= to_rail
            sigma = np.where(arrives, to_line, to_rail)
            going &= drag * sigma < _ROLLS_OUT
            sigma = np.where(going, sigma, 0.0)
            if opponent is not None:
                past = _passes((x, y, vx, vy), sigma, opponent, puck.radius_m, bounce)
                past = 1 - _READS[bounce] * (1 - past)
                passes = np.where(going, np.minimum(passes, past), passes)
            left = 1 - drag * sigma
            lasted = -np.log(left) / drag if drag else sigma
            x, y = x + vx * sigma, y + vy * sigma
            # A post is not touched if it is a radius away from the path.
            room = table.goal_width_m / 2 - puck.radius_m * np.hypot(vx, vy) / np.abs(vx)
            scores |= going & arrives & (np.abs(y) < room)
            going &= ~arrives
            if bounce == MOST_BOUNCES:
                break
            bounces += going
            vx, vy, spin = vx * left, vy * left, spin * np.exp(-puck.spin_drag_1_s * lasted)
            body = Disc(0.0, 0.0, vx, vy, spin, puck.radius_m, puck.mass_kg, puck.inertia)
            strike(body, Disc(0.0, 0.0), np.zeros_like(vy), -np.sign(vy), puck.rail, np)
            vx, vy, spin = body.vx, body.vy, body.spin
            going &= vx > 0
    if opponent is not None:
        passes = np.where(bounces > 0, np.minimum(passes * opponent[2].banks, 1.0), passes)
    return Flights(scores, bounces, passes)


def _passes(
    start: tuple[Any, Any, Any, Any],
    sigma: Float[np.ndarray, "*n"],
    opponent: Opposed,
    radius: float,
    bounce: int,
) -> Float[np.ndarray, "*n"]:
    """Return the probability that an opponent does not cover straight paths in time."""
    x, y, vx, vy = start
    place, size, rival = opponent
    dx, dy = place[..., 0] - x, place[..., 1] - y
    square = np.maximum(vx * vx + vy * vy, _RESTS**2)
    moving = np.clip((dx * vx + dy * vy) / square, 0.0, sigma)
    apart = np.hypot(dx - vx * moving, dy - vy * moving)
    room = apart - size - radius
    if not bounce:
        return ndtr((room - rival.reach(moving)) / _DIRECT_ERROR)
    return ndtr((room - np.minimum(_PUSH * moving**2 / 2, _FASTEST * moving)) / _BANK_ERROR)


@cache
def _quantiles(count: int, dimensions: int) -> Float[np.ndarray, "n d"]:
    """Return points that fill a standard normal distribution evenly: a rank-one lattice."""
    # Powers of the root of x^(d+1) = x + 1 spread best (Roberts 2018).
    root = np.roots([1, *[0] * (dimensions - 1), -1, -1]).real.max()
    points = (0.5 + np.outer(np.arange(1, count + 1), root ** -np.arange(1, dimensions + 1))) % 1.0
    return ndtri(points)


@dataclass(frozen=True)
class ArrivalError:
    """Standard deviations of the craft's errors at a rendezvous."""

    #: Error of its centre along each axis [m].
    place: float = 0.0015
    #: Velocity.
    speed: float = 0.04


def chances(
    pitch: Pitch,
    model: PuckModel,
    contacts: Contacts,
    covariance: Float[np.ndarray, "n 6 6"],
    error: ArrivalError,
    opponent: Opposed | None = None,
    count: int = 64,
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Return the probability that contacts score, and the mean number of bounces.

    Each contact is evaluated with evenly spread errors of the puck's state, the craft's state, the
    law of contact and the law of the rails.

    Parameters
    ----------
    pitch : Pitch
        Sizes.
    model : PuckModel
        Table and puck, and the uncertainty of the rails.
    contacts : Contacts
        The contacts, shape (n,).
    covariance : array, shape (n, 6, 6)
        Covariance of the puck at the contacts: x, y, yaw and their rates.
    error : ArrivalError
        Errors of the craft.
    opponent : Opposed, optional
        See `flown`.
    count : int
        Number of trials per contact.
    """
    drawn = _quantiles(count, _DIMENSIONS)
    # A covariance computed from differences may be rank deficient.
    puck = np.einsum("nij,cj->nci", axes_of(covariance), drawn[:, :6])
    craft = drawn[:, 6:8] * error.place
    # The normal turns with the transverse part of the position difference.
    across = unit(contacts.normal + math.pi / 2)
    offset = np.einsum("nci,ni->nc", puck[..., :2] - craft, across)
    turned = np.arcsin(np.clip(offset / pitch.contact_distance, -_GRAZING, _GRAZING))
    sizes, spread = pitch.equipment.puck, model.spread

    def varied(law: Any, restitution: float, grip: float, axis: int) -> Any:
        """Return a law of contact with a restitution and a grip for each trial."""
        returned = np.clip(law.restitution + restitution * drawn[:, axis], 0.0, 1.0)
        gripped = np.clip(law.grip + grip * drawn[:, axis + 1], 0.0, 1.0)
        return law.model_copy(update={"restitution": returned, "grip": gripped})

    laws = {
        "craft": varied(sizes.craft, _RESTITUTION, _GRIP, 10),
        "rail": varied(sizes.rail, spread["rail.restitution"], spread["rail.grip"], 12),
    }
    known = pitch.equipment.model_copy(update={"puck": sizes.model_copy(update=laws)})
    tried = Contacts(
        place=contacts.place[:, None] + puck[..., :2],
        puck=contacts.puck[:, None] + puck[..., 3:],
        normal=contacts.normal[:, None] + turned,
        craft=contacts.craft[:, None] + drawn[:, 8:10] * error.speed,
    )
    after = struck(replace(pitch, equipment=known), tried)
    flights = flown(known, tried.place, after, opponent)
    return (flights.scores * flights.passes).mean(axis=1), flights.bounces.mean(axis=1)
