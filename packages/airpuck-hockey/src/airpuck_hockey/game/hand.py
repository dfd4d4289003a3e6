"""Hands that move a mallet: scripted opponents with human limits, and the person at the page."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from airpuck import AirHockey, PuckState
from airpuck.extend import PuckOnTable
from airpuck_hockey.player.tactic import Frame

# Numbers without a source are guesses. How far ahead a scripted hand predicts the puck, and the
# step of the prediction [s].
_AHEAD, STEP = 0.8, 0.04
#: Distance from the own goal line at which a human waits, and at which a keeper stands [m].
_HOME, _IN_GOAL = 0.25, 0.10
#: A puck in the other half counts as approaching if it is faster than this [m/s].
_COMES = 0.3
#: A stroke begins this far behind the puck, and aims this far beyond it [m].
_BACK, _THROUGH = 0.10, 0.15
#: Distance from its start at which a stroke begins [m], and its duration [s].
_READY, _STROKE = 0.002, 0.3
#: Average speed on the path to the start of a stroke, as a fraction of the full speed.
_GETS_THERE = 0.6
#: Time between decisions, and time for which the error of sight is held [s].
LOOK, _ERRS = 0.03, 1.0
#: Clearance of a shot to the post, and from the rail to the aim of a bank shot [m].
_POST, _BANK = 0.02, 0.02
#: Room that a stroke needs behind the puck [m].
_ROOM = 0.03
#: Clearance when going round the puck, and length of the first leg back [m].
_ROUND, _LEG = 0.01, 0.15
#: Shorter distances have no direction [m].
_NO_DISTANCE = 1e-9
#: Directions of a stroke if rails block all directions towards the goal [rad].
_AWAY = (0.6, -0.6, 1.2, -1.2, 1.5, -1.5)
#: x, y [m].
Point = tuple[float, float]


class Hand(Protocol):
    """Moves a mallet: a script, or the person at the page."""

    def target(self, time: float, own: Point, puck: PuckState | None, opponent: Point) -> Point:
        """Return the target of the mallet.

        All arguments are in the hand's own frame: its goal is at negative x.

        Parameters
        ----------
        time : float
            Now [s].
        own : tuple of float
            Position of the mallet [m].
        puck : PuckState or None
            State of the puck; None while it is in a goal.
        opponent : tuple of float
            Position of the opponent's disc [m].

        Returns
        -------
        x, y : float
            Position that the mallet should reach as fast as possible [m].
        """
        ...


@dataclass(frozen=True)
class Dexterity:
    """Limits of a scripted hand.

    Attributes
    ----------
    reaction_s : float
        Delay with which puck and opponent are seen.
    noise_m : float
        Standard deviation of the seen position of the puck.
    aim_rad : float
        Standard deviation of the direction of strokes.
    speed_m_s : float
        Largest speed of the mallet.
    velocity_error : float, default 0
        Relative standard deviation of the seen speed of the puck.
    heading_rad : float, default 0
        Standard deviation of the seen direction of its motion.
    bounce_rad : float, default 0
        Standard deviation of its direction after each predicted bounce.
    """

    reaction_s: float
    noise_m: float
    aim_rad: float
    speed_m_s: float
    velocity_error: float = 0.0
    heading_rad: float = 0.0
    bounce_rad: float = 0.0


#: Limits by level. Reaction times to a visual stimulus are 0.18 to 0.25 s in adults (Kosinski, "A
#: literature review on reaction time", 2008); ``hard`` anticipates. The best observers discriminate
#: speeds that differ by 7 % and directions that differ by 1.8° (De Bruyn and Orban, Vision Research
#: 28, 1988): the errors of ``hard``, except at a bounce. All other numbers are guesses.
HUMANS = {
    "easy": Dexterity(0.30, 0.025, 0.30, 1.5, 0.15, 0.06, 0.15),
    "medium": Dexterity(0.22, 0.012, 0.15, 2.5, 0.10, 0.04, 0.10),
    "hard": Dexterity(0.16, 0.006, 0.08, 4.0, 0.07, 0.03, 0.07),
}
#: The same for keepers and strikers, who do not anticipate.
KEEPERS = {**HUMANS, "hard": Dexterity(0.20, 0.005, 0.15, 4.0, 0.07, 0.03, 0.07)}


class GuidedHand:
    """A hand on the right that a person guides, for example at a page; a `Hand`."""

    def __init__(self) -> None:
        #: Target of the mallet in the world's frame [m]; None keeps it where it is.
        self.wanted: Point | None = None

    def target(self, time: float, own: Point, puck: PuckState | None, opponent: Point) -> Point:
        """Return the target of the mallet; see `Hand.target`."""
        return own if self.wanted is None else Frame(1).point(*self.wanted)


class HumanHand(ABC):
    """A scripted hand with human limits; a `Hand`.

    It sees puck and opponent with a delay, and the puck with an error. It predicts the puck over
    bounces, and moves the mallet within its speed. A subclass decides where the mallet goes.

    Parameters
    ----------
    equipment : AirHockey
        Table, puck and mallet.
    dexterity : Dexterity
        Its limits.
    seed : int, default 0
        Seed of its errors.
    """

    #: Distance from its own goal line at which it waits [m]; its y as a fraction of the puck's; a
    #: faster puck is stopped, a slower one is struck [m/s].
    waits_m, follows, too_fast_m_s = _HOME, 0.5, 1.2

    def __init__(self, equipment: AirHockey, dexterity: Dexterity, seed: int = 0) -> None:
        self._equipment, self._dexterity = equipment, dexterity
        self._random = np.random.default_rng(seed)
        self._line = equipment.table.length_m / 2
        self._home = -self._line + self.waits_m
        self._reach = equipment.table.reach(equipment.mallet.radius_m)
        self._together = equipment.mallet.radius_m + equipment.puck.radius_m
        # Full speed is only reached towards a target at least this far away.
        self._leash = dexterity.speed_m_s**2 / (2 * equipment.mallet.acceleration_m_s2)
        self._seen: deque[tuple[float, PuckState | None, Point]] = deque()
        self._looks, self._wanted = 0.0, (self._home, 0.0)
        self._goes_by: list[PuckState] = []
        self._opponent = (0.0, 0.0)
        self._errs, self._error = 0.0, (0.0, 0.0)
        # A separate generator, so that other errors do not depend on these.
        self._misjudging = np.random.default_rng([seed, 1])
        #: Errors of the seen speed [relative], its direction, and that after a bounce [rad].
        self._misjudged = (0.0, 0.0, 0.0)
        #: Last change of the opponent's y between decisions [m].
        self._opponent_moves = 0.0
        self._aim_anew()
        #: During a stroke: end time and direction.
        self._stroke: tuple[float, float, float] | None = None

    def target(self, time: float, own: Point, puck: PuckState | None, opponent: Point) -> Point:
        """Return the target of the mallet; see `Hand.target`."""
        self._seen.append((time, puck, opponent))
        while len(self._seen) > 1 and self._seen[1][0] <= time - self._dexterity.reaction_s:
            self._seen.popleft()
        if time >= self._looks:
            self._looks = time + LOOK
            if time >= self._errs:
                self._errs = time + _ERRS
                skill = self._dexterity
                x, y = self._random.normal(0.0, skill.noise_m, 2).tolist()
                self._error = x, y
                spreads = skill.velocity_error, skill.heading_rad, skill.bounce_rad
                faster, turned, bounced = self._misjudging.normal(0.0, spreads).tolist()
                self._misjudged = faster, turned, bounced
            before = self._opponent
            _, seen, self._opponent = self._seen[0]
            self._opponent_moves = self._opponent[1] - before[1]
            self._goes_by = self._foreseen(seen)
            if self._goes_by:
                self._wanted = self._through(time, own) or self.decided(time, own)
            else:
                self._stroke, self._wanted = None, (self._home, 0.0)
        dx, dy = self._wanted[0] - own[0], self._wanted[1] - own[1]
        share = min(1.0, self._leash / max(math.hypot(dx, dy), _NO_DISTANCE))
        return own[0] + share * dx, own[1] + share * dy

    def _foreseen(self, seen: PuckState | None) -> list[PuckState]:
        """Return the predicted states of the puck, from now on."""
        if seen is None:
            return []
        (x, y), (faster, turned, bounced) = self._error, self._misjudged
        believed = seen._replace(x=seen.x + x, y=seen.y + y)
        puck = PuckOnTable(self._equipment, _turned(believed, 1 + faster, turned))
        path, bounces = [], 0
        for k in range(round(_AHEAD / STEP)):
            puck.run(self._dexterity.reaction_s + k * STEP)
            if bounced and not puck.goal and len(puck.touches) > bounces:
                bounces = len(puck.touches)
                puck.place(_turned(puck.state, 1.0, bounced))
            path.append(puck.state)
        return path

    @abstractmethod
    def decided(self, time: float, own: Point) -> Point:
        """Return where the mallet should go, given the predicted puck."""

    def aims(self) -> tuple[float, ...]:
        """Return the y of the targets of a stroke on the opponent's line, best first [m]."""
        # The mirror image of the goal's centre in either rail: a bank shot.
        width = self._equipment.table.width_m
        return 0.0, width - _BANK, -width + _BANK

    @property
    def _corner(self) -> float:
        """Distance of a shot at a corner of the goal from the table's axis [m]."""
        equipment = self._equipment
        return equipment.table.goal_width_m / 2 - equipment.puck.radius_m - _POST

    def _aim_anew(self) -> None:
        """Draw a new aiming error."""
        self._aim = float(self._random.normal(0.0, self._dexterity.aim_rad))

    def _through(self, time: float, own: Point) -> Point | None:
        """Return the target of the present stroke; None: there is none, or it is over."""
        if self._stroke is None:
            return None
        (until, nx, ny), puck = self._stroke, self._goes_by[0]
        if time < until and puck.x - own[0] > -self._together:
            return puck.x + _THROUGH * nx, puck.y + _THROUGH * ny
        self._stroke = None
        return None

    def _guarded(self, own: Point) -> Point:
        """Return a place in front of the goal, on the puck's path."""
        line = max(-self._line + self._together, min(own[0], self._home))
        half = self._equipment.table.goal_width_m / 2
        for before, after in zip(self._goes_by, self._goes_by[1:], strict=False):
            if after.x <= line < before.x:
                share = (before.x - line) / (before.x - after.x)
                y = before.y + share * (after.y - before.y)
                return line, max(-half, min(y, half))
        return self._waiting()

    def _waiting(self) -> Point:
        """Return a place at home, on the side of the puck."""
        half = self._equipment.table.goal_width_m / 2
        return self._home, max(-half, min(self.follows * self._goes_by[0].y, half))

    def _struck(self, time: float, own: Point) -> Point:
        """Return where to begin a stroke, or begin it."""
        fastest = self._dexterity.speed_m_s
        puck = self._goes_by[-1]
        for number, later in enumerate(self._goes_by):
            away = math.hypot(later.x - own[0], later.y - own[1]) - self._together
            if later.x < 0.0 and away <= fastest * number * STEP * _GETS_THERE:
                puck = later
                break
        if puck.x > 0.0:
            return self._guarded(own)
        nx, ny = self._direction(puck)
        back = self._together + _BACK
        start = puck.x - back * nx, puck.y - back * ny
        start = max(-self._reach[0], start[0]), max(-self._reach[1], min(start[1], self._reach[1]))
        along = (puck.x - own[0]) * nx + (puck.y - own[1]) * ny
        aside = abs((puck.x - own[0]) * ny - (puck.y - own[1]) * nx)
        if math.dist(own, start) < _READY or (0 < along < 2 * back and aside < _READY):
            self._stroke = time + _STROKE, nx, ny
            return puck.x + _THROUGH * nx, puck.y + _THROUGH * ny
        if along < self._together and aside < self._together + _ROUND:
            # Move round the puck, not through it.
            side = math.copysign(1.0, own[1] - puck.y)
            free = puck.y + side * 2 * self._together
            if abs(free) > self._reach[1]:
                free = puck.y - side * 2 * self._together
            return max(-self._reach[0], own[0] - _LEG), free
        return start

    def _direction(self, puck: PuckState) -> Point:
        """Return the direction of a stroke: at the goal, or away from a rail that is too near."""
        lead = self._line - puck.x
        angles = [math.atan2(y - puck.y, lead) for y in self.aims()]
        back, angle = self._together + _ROOM, 0.0
        for angle in (*angles, *_AWAY):
            x, y = puck.x - back * math.cos(angle), puck.y - back * math.sin(angle)
            if x >= -self._reach[0] and abs(y) <= self._reach[1]:
                break
        angle += self._aim
        return math.cos(angle), math.sin(angle)


class ScriptedHand(HumanHand):
    """A scripted human: stops fast pucks, strikes slow ones, waits in front of its own goal."""

    def decided(self, time: float, own: Point) -> Point:
        """Strike, stop the puck, or wait; see `HumanHand.decided`."""
        puck = self._goes_by[0]
        fast = math.hypot(puck.vx, puck.vy) > self.too_fast_m_s
        if puck.vx < 0.0 and (fast or (puck.x > 0.0 and puck.vx < -_COMES)):
            return self._guarded(own)
        if puck.x < 0.0:
            return self._struck(time, own)
        self._aim_anew()
        return self._waiting()


class Keeper(HumanHand):
    """A keeper: stands in its goal where the puck will arrive."""

    waits_m = _IN_GOAL

    def decided(self, time: float, own: Point) -> Point:
        """Cover the position where the puck will pass; see `HumanHand.decided`."""
        return self._guarded((self._home, own[1]))


class Striker(Keeper):
    """A keeper that strikes slow pucks at the open corner."""

    def decided(self, time: float, own: Point) -> Point:
        """Strike a slow puck in its own half, otherwise keep the goal; see `HumanHand.decided`."""
        puck = self._goes_by[0]
        if puck.x < 0.0 and math.hypot(puck.vx, puck.vy) <= self.too_fast_m_s:
            return self._struck(time, own)
        self._aim_anew()
        return super().decided(time, own)

    def aims(self) -> tuple[float, ...]:
        """Aim at the corner away from the opponent first; see `HumanHand.aims`."""
        return -math.copysign(self._corner, self._opponent[1]), *super().aims()


def _turned(puck: PuckState, faster: float, angle: float) -> PuckState:
    """Return a puck with another speed and direction."""
    cos, sin = faster * math.cos(angle), faster * math.sin(angle)
    return puck._replace(vx=cos * puck.vx - sin * puck.vy, vy=sin * puck.vx + cos * puck.vy)


#: A machine: it sees late and inexactly like a person, but judges motion and bounces exactly.
_EXACT = {
    level: replace(skill, velocity_error=0.0, heading_rad=0.0, bounce_rad=0.0)
    for level, skill in KEEPERS.items()
}
#: Scripted hands and their levels, by name. All but ``wall`` have human limits.
HANDS: Mapping[str, tuple[type[HumanHand], Mapping[str, Dexterity]]] = {
    "human": (ScriptedHand, HUMANS),
    "keeper": (Keeper, KEEPERS),
    "striker": (Striker, KEEPERS),
    "wall": (Keeper, _EXACT),
}
