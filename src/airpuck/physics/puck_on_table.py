"""A puck among rails, goals and moving discs, simulated from event to event.

`puck_paths` does the same for many untouched pucks at once, over arrays, each with numbers of its
own: a prediction with its uncertainty needs twenty flights, which take twice as long one by one.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from airpuck.boundary.errors import InputError
from airpuck.craft.table import AirHockey, Contact
from airpuck.physics.puck import (
    STILL,
    Disc,
    Meeting,
    PuckState,
    coast,
    sigma_of,
    sigma_to_circle,
    strike,
    time_of,
    walls_of,
)

#: Kinds of contact of a puck.
Met = Literal["rail", "post", "goal", "mallet", "craft"]
#: Below this speed, disc and puck do not bounce but stay together [m/s].
RESTING = 0.01
#: Discs that approach more slowly than this do not meet [m/s].
_CLOSING = 1e-9
#: A puck with more contacts than this within this time [s] is wedged: it stops for a while [s].
MOST, WITHIN, _STOPPED = 20, 1e-3, 4e-3
#: Discs that overlap by less are not separated [m].
_ROUNDING = 1e-9
#: Number of attempts to move a puck out of overlap, also along a rail.
_PASSES = 8
#: The immovable body that a wedged disc bounces off.
_WEDGED = Contact(restitution=0.0, grip=0.0, friction=0.0)

#: The numbers that differ between the pucks of `puck_paths`.
PUCK_NUMBERS = ("drag_1_s", "spin_drag_1_s", "rail.restitution", "rail.grip")
#: A smaller drag has no effect; with none, the distance would be 0 / 0 [1/s].
_NO_DRAG = 1e-12


class Touch(NamedTuple):
    """A contact of the puck."""

    #: [s].
    time: float
    #: With what.
    met: Met
    #: Impulse along the normal [N s]; 0 in a goal.
    impulse: float
    #: The puck just before the contact.
    before: PuckState
    #: Index of the disc that it hit among the discs given to `PuckOnTable.run`; None for the table.
    disc: int | None = None


@dataclass(slots=True)
class Moving(Disc):
    """A disc that moves in a straight line to a given place by the end of a step."""

    #: Its place at the end of the step [m].
    to_x: float = 0.0
    to_y: float = 0.0
    #: Its acceleration until then [m/s², m/s², rad/s²].
    ax: float = 0.0
    ay: float = 0.0
    spinning_up: float = 0.0
    kind: Literal["mallet", "craft"] = "mallet"


class PuckOnTable:
    """A puck that moves, bounces and may end in a goal.

    Parameters
    ----------
    play : AirHockey
        Table and puck; a twin's settings contain both.
    state : PuckState
        Initial position.
    time : float, default 0
        Initial time [s].
    logs : bool, default True
        Whether to record all contacts.

    Attributes
    ----------
    state : PuckState
        Now.
    time : float
        Now [s].
    goal : int
        The goal it is in, by the sign of its x; 0: in play.
    touches : list of Touch
        Its contacts since the start.
    """

    def __init__(
        self, play: AirHockey, state: PuckState, time: float = 0.0, *, logs: bool = True
    ) -> None:
        self._puck = puck = play.puck
        self._laws = {"mallet": puck.mallet, "craft": puck.craft}
        self._body = Disc(0.0, 0.0, radius=puck.radius_m, mass=puck.mass_kg, inertia=puck.inertia)
        self._walls = walls_of(play)
        self._logs = logs
        self.time, self.radius = time, puck.radius_m
        self.touches: list[Touch] = []
        self.place(state)

    def place(self, state: PuckState) -> None:
        """Place the puck, or bring it back into play.

        Parameters
        ----------
        state : PuckState
            Position and motion; positions beyond a rail are moved to the rail.

        Raises
        ------
        InputError
            If a number is not finite.
        """
        # NumPy scalars are slow.
        state = PuckState(*map(float, state))
        if not math.isfinite(sum(state)):
            raise InputError("must be finite numbers", field="puck")
        x, y = self._walls.nearest(state.x, state.y)
        self.goal = 0
        self._free_from = -math.inf
        self._contacts, self._counted_from = 0, self.time
        self._move_on(state._replace(x=x, y=y))

    @property
    def next_meeting(self) -> float:
        """Next time the puck meets the table if no disc is in its way, to a nanosecond [s]."""
        return self._wall_time

    def run(self, end: float, discs: Sequence[Moving] = ()) -> Moving | None:
        """Advance to `end`, or until the puck hits a disc that can move.

        Parameters
        ----------
        end : float
            When to stop [s].
        discs : sequence of Moving
            The moving discs. They are moved, and a hit changes the velocity of discs that can move.

        Returns
        -------
        Moving or None
            The disc that was hit at `time`, before the end; None at the end.
        """
        passed: set[int] = set()
        while self.time < end and not self.goal:
            held = self.time < self._free_from
            stop = min(end, self._free_from) if held else end
            reach = sigma_of(self._puck.drag_1_s, stop - self.time)
            share = reach / sigma_of(self._puck.drag_1_s, end - self.time)
            wall = None
            if not held and self._wall_time <= stop:
                wall = self._walls.first(self.state)
                wall = wall if wall.sigma <= reach else None
            sigma = wall.sigma if wall else reach
            hit, sigma = self._first_disc(discs, passed, reach, share, sigma)
            self._advance(discs, stop, share, sigma, reach, at_end=not wall and hit is None)
            if hit is not None:
                if self._bounce_off(discs[hit], hit, held):
                    if discs[hit].mass < math.inf:
                        return discs[hit]
                else:
                    passed.add(hit)
            elif wall is not None:
                self._meet(wall)
        if self.time < end:
            for disc in discs:
                disc.x, disc.y = disc.to_x, disc.to_y
            self.time = end
        self._separate(discs)
        return None

    def _first_disc(
        self, discs: Sequence[Moving], passed: set[int], reach: float, share: float, sigma: float
    ) -> tuple[int | None, float]:
        """Return the index of the disc that the puck meets before σ, and when."""
        x, y, _, vx, vy, _ = self.state
        found = None
        for index, disc in enumerate(discs):
            if index in passed:
                continue
            dx, dy, apart = x - disc.x, y - disc.y, self._body.radius + disc.radius
            ux = vx - (disc.to_x - disc.x) * share / reach
            uy = vy - (disc.to_y - disc.y) * share / reach
            if abs(dx) - apart > abs(ux) * sigma or abs(dy) - apart > abs(uy) * sigma:
                continue
            met = sigma_to_circle(dx, dy, ux, uy, apart)
            if met <= sigma:
                found, sigma = index, met
        return found, sigma

    def _advance(
        self,
        discs: Sequence[Moving],
        stop: float,
        share: float,
        sigma: float,
        reach: float,
        *,
        at_end: bool,
    ) -> None:
        """Move puck and discs by σ."""
        part = share * sigma / reach
        lasted = stop - self.time if at_end else time_of(self._puck.drag_1_s, sigma)
        for disc in discs:
            disc.vx, disc.vy = disc.vx + disc.ax * lasted, disc.vy + disc.ay * lasted
            disc.spin += disc.spinning_up * lasted
            if at_end and share == 1:
                disc.x, disc.y = disc.to_x, disc.to_y
            else:
                disc.x += (disc.to_x - disc.x) * part
                disc.y += (disc.to_y - disc.y) * part
        self.state = coast(self._puck, self.state, lasted)
        self.time = stop if at_end else min(self.time + lasted, stop)

    def _meet(self, wall: Meeting) -> None:
        """Bounce off the table, or enter a goal."""
        if wall.boundary == "goal":
            self.goal = 1 if self.state.x > 0 else -1
            self._log("goal", 0.0)
            return
        self._strike(Disc(0.0, 0.0), wall.nx, wall.ny, self._puck.rail, wall.boundary)

    def _bounce_off(self, disc: Moving, index: int, held: bool) -> bool:
        """Bounce off a disc unless it is moving away; return whether the puck bounced."""
        nx, ny = _direction(disc, self.state.x, self.state.y)
        closing = -((self.state.vx - disc.vx) * nx + (self.state.vy - disc.vy) * ny)
        if closing < _CLOSING:
            return False
        if held:
            if math.isinf(disc.mass):
                return False
            strike(Disc(0.0, 0.0), disc, nx, ny, _WEDGED)
            return True
        law = self._laws[disc.kind]
        if closing < RESTING:
            law = law.model_copy(update={"restitution": 0.0})
        self._strike(disc, nx, ny, law, disc.kind, index)
        return True

    def _strike(
        self, other: Disc, nx: float, ny: float, law: Contact, met: Met, index: int | None = None
    ) -> None:
        """Change the motion of the puck, and of the disc it meets."""
        body, state = self._body, self.state
        body.vx, body.vy, body.spin = state.vx, state.vy, state.spin
        self._log(met, strike(body, other, nx, ny, law), index)
        if self.time - self._counted_from > WITHIN:
            self._contacts, self._counted_from = 0, self.time
        self._contacts += 1
        if self._contacts > MOST:
            self._free_from = self.time + _STOPPED
            body.vx = body.vy = body.spin = 0.0
        self._move_on(state._replace(vx=body.vx, vy=body.vy, spin=body.spin))

    def _move_on(self, state: PuckState) -> None:
        """Take a new state, and compute when the puck will meet the table."""
        self.state = state
        sigma = self._walls.first(state).sigma
        # Slightly early, since rounding accumulates from step to step until then.
        self._wall_time = self.time + time_of(self._puck.drag_1_s, sigma) - 1e-9

    def _separate(self, discs: Sequence[Moving]) -> None:
        """Separate puck and discs that overlap; this happens if disc paths are not quite straight.

        The puck moves aside. If it cannot because it is wedged, it stops and the disc moves.
        """
        x, y, moving = self.state.x, self.state.y, True
        if self.goal or not any(self._overlap(disc, x, y) > 0 for disc in discs):
            return
        for disc in (*discs,) * _PASSES:
            overlap, (nx, ny) = self._overlap(disc, x, y), _direction(disc, x, y)
            if overlap > 0:
                x, y = self._walls.nearest(x + overlap * nx, y + overlap * ny)
        for disc in discs:
            overlap, (nx, ny) = self._overlap(disc, x, y), _direction(disc, x, y)
            if overlap > 0:
                disc.x, disc.y = disc.x - overlap * nx, disc.y - overlap * ny
                moving = moving and overlap < _ROUNDING
        if not moving:
            self._free_from = self.time + _STOPPED
            self.state = PuckState(*self.state[:3])
        self._move_on(self.state._replace(x=x, y=y))

    def _overlap(self, disc: Disc, x: float, y: float) -> float:
        """Return by how much a puck and a disc overlap [m]."""
        return self._body.radius + disc.radius - math.hypot(x - disc.x, y - disc.y)

    def _log(self, met: Met, impulse: float, disc: int | None = None) -> None:
        """Record a contact; `state` is the state before it."""
        if self._logs:
            self.touches.append(Touch(self.time, met, impulse, self.state, disc))


def _direction(disc: Disc, x: float, y: float) -> tuple[float, float]:
    """Return the unit vector from a disc to the puck; any direction if they coincide."""
    dx, dy = x - disc.x, y - disc.y
    distance = math.hypot(dx, dy)
    return (dx / distance, dy / distance) if distance else (1.0, 0.0)


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
    meets = [
        (moves[:, 1], rail[:, 1]),
        (moves[:, 1] & behind, within),
        (moves[:, 0] & beside, rail[:, 0]),
        (moves[:, 0] & (inner[:, 0] >= 0), inner[:, 0]),
    ]
    posts = _sigma_to_posts(apart, speed[:, None], radius)
    candidates = np.column_stack([*(np.where(when, then, np.inf) for when, then in meets), posts])
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
