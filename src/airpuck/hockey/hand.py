"""Hands that move a mallet: the scripted human, whom players are measured against."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from airpuck.craft.table import AirHockey
from airpuck.physics.puck import PuckState
from airpuck.physics.puck_on_table import PuckOnTable

#: How far ahead a person looks at a puck [s], in steps of so much.
_AHEAD, _STEP = 0.8, 0.04
#: A person waits here, from the own line [m].
_HOME = 0.25
#: A puck that comes faster than this is stopped, a slower one is struck [m/s].
_TOO_FAST = 1.2
#: Behind the puck by so much a stroke begins, beyond it by so much it ends [m].
_BACK, _THROUGH = 0.10, 0.15
#: A stroke begins within this distance of where it should, and is over after a time [m, s].
_READY, _STROKE = 0.002, 0.3
#: A person decides anew this often, and errs the same way for so long [s].
_LOOK, _ERRS = 0.03, 1.0


class Hand(Protocol):
    """Moves a mallet: a script, or the person at the page."""

    def target(
        self,
        time: float,
        own: tuple[float, float],
        puck: PuckState | None,
        opponent: tuple[float, float],
    ) -> tuple[float, float]:
        """Return where the mallet is wanted.

        Everything is in the hand's own frame: its goal is at negative x.

        Parameters
        ----------
        time : float
            Now [s].
        own : tuple of float
            Where the mallet is [m].
        puck : PuckState or None
            The puck; None while it is in a goal.
        opponent : tuple of float
            Where the other's disc is [m].

        Returns
        -------
        x, y : float
            Where the mallet should go, as fast as it can [m].
        """
        ...


@dataclass(frozen=True)
class Skill:
    """What a scripted human can do.

    Attributes
    ----------
    reaction_s : float
        How much later things are seen.
    noise_m : float
        Standard deviation of where the puck is thought to be.
    aim_rad : float
        The same of the direction of strokes.
    speed_m_s : float
        How fast the hand is moved.
    """

    reaction_s: float
    noise_m: float
    aim_rad: float
    speed_m_s: float


#: By name.
SKILLS = {
    "easy": Skill(0.30, 0.025, 0.30, 1.5),
    "medium": Skill(0.22, 0.012, 0.15, 2.5),
    "hard": Skill(0.16, 0.006, 0.08, 4.0),
}


class GuidedHand:
    """A hand on the right that somebody else guides, at a page for example; a `Hand`."""

    def __init__(self) -> None:
        #: Where the mallet is wanted, in the world's frame [m]; None: where it is.
        self.wanted: tuple[float, float] | None = None

    def target(
        self,
        time: float,
        own: tuple[float, float],
        puck: PuckState | None,
        opponent: tuple[float, float],
    ) -> tuple[float, float]:
        """Return where the mallet is wanted; see `Hand.target`."""
        return own if self.wanted is None else (-self.wanted[0], -self.wanted[1])


class ScriptedHand:
    """A scripted human: defends, strikes at the goal, clears; a `Hand`.

    It sees the puck late and not quite where it is, thinks on where it goes over its bounces, and
    moves the mallet no faster than it can.

    Parameters
    ----------
    play : AirHockey
        Table, puck and mallet.
    skill : Skill
        How well it plays.
    seed : int, default 0
        Of its errors.
    """

    def __init__(self, play: AirHockey, skill: Skill, seed: int = 0) -> None:
        self._play, self._skill = play, skill
        self._random = np.random.default_rng(seed)
        self._line = play.table.length_m / 2
        self._home = -self._line + _HOME
        self._reach = play.table.reach(play.mallet.radius_m)
        self._together = play.mallet.radius_m + play.puck.radius_m
        # Full speed is only reached towards a place that is this far.
        self._leash = skill.speed_m_s**2 / (2 * play.mallet.acceleration_m_s2)
        self._seen: deque[tuple[float, PuckState | None]] = deque()
        self._looks, self._wanted = 0.0, (self._home, 0.0)
        self._goes_by: list[PuckState] = []
        self._errs, self._error = 0.0, (0.0, 0.0)
        self._aim = float(self._random.normal(0.0, skill.aim_rad))
        #: While a stroke lasts: until when, and along which direction.
        self._stroke: tuple[float, float, float] | None = None

    def target(
        self,
        time: float,
        own: tuple[float, float],
        puck: PuckState | None,
        opponent: tuple[float, float],
    ) -> tuple[float, float]:
        """Return where the mallet is wanted; see `Hand.target`."""
        self._seen.append((time, puck))
        while len(self._seen) > 1 and self._seen[1][0] <= time - self._skill.reaction_s:
            self._seen.popleft()
        if time >= self._looks:
            self._looks = time + _LOOK
            if time >= self._errs:
                self._errs = time + _ERRS
                x, y = self._random.normal(0.0, self._skill.noise_m, 2).tolist()
                self._error = x, y
            self._goes_by = self._foreseen(self._seen[0][1])
            self._wanted = self._decided(time, own)
        dx, dy = self._wanted[0] - own[0], self._wanted[1] - own[1]
        share = min(1.0, self._leash / max(math.hypot(dx, dy), 1e-9))
        return own[0] + share * dx, own[1] + share * dy

    def _foreseen(self, seen: PuckState | None) -> list[PuckState]:
        """Return where the puck is thought to be, from now on."""
        if seen is None:
            return []
        x, y = self._error
        puck = PuckOnTable(self._play, seen._replace(x=seen.x + x, y=seen.y + y), logs=False)
        way = []
        for k in range(round(_AHEAD / _STEP)):
            puck.run(self._skill.reaction_s + k * _STEP)
            way.append(puck.state)
        return way

    def _decided(self, time: float, own: tuple[float, float]) -> tuple[float, float]:
        """Return where the mallet should go: to strike, to stop the puck, or home."""
        if not self._goes_by:
            self._stroke = None
            return self._home, 0.0
        puck = self._goes_by[0]
        if self._stroke is not None:
            until, nx, ny = self._stroke
            if time < until and puck.x - own[0] > -self._together:
                return puck.x + _THROUGH * nx, puck.y + _THROUGH * ny
            self._stroke = None
        fast = math.hypot(puck.vx, puck.vy) > _TOO_FAST
        if puck.vx < 0.0 and (fast or (puck.x > 0.0 and puck.vx < -0.3)):
            return self._guarded(own)
        if puck.x < 0.0:
            return self._struck(time, own)
        self._aim = float(self._random.normal(0.0, self._skill.aim_rad))
        half = self._play.table.goal_width_m / 2
        return self._home, max(-half, min(0.5 * puck.y, half))

    def _guarded(self, own: tuple[float, float]) -> tuple[float, float]:
        """Return a place before the goal that the puck will pass."""
        line = max(-self._line + self._together, min(own[0], self._home))
        half = self._play.table.goal_width_m / 2
        for before, after in zip(self._goes_by, self._goes_by[1:], strict=False):
            if after.x <= line < before.x:
                share = (before.x - line) / (before.x - after.x)
                y = before.y + share * (after.y - before.y)
                return line, max(-half, min(y, half))
        y = self._goes_by[0].y * 0.5
        return self._home, max(-half, min(y, half))

    def _struck(self, time: float, own: tuple[float, float]) -> tuple[float, float]:
        """Return where to begin a stroke, or begin it."""
        fastest = self._skill.speed_m_s
        puck = self._goes_by[-1]
        for number, later in enumerate(self._goes_by):
            way = math.hypot(later.x - own[0], later.y - own[1]) - self._together
            if later.x < 0.0 and way <= fastest * number * _STEP * 0.6:
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
        if along < self._together and aside < self._together + 0.01:
            # Round the puck, not through it.
            side = math.copysign(1.0, own[1] - puck.y)
            free = puck.y + side * 2 * self._together
            if abs(free) > self._reach[1]:
                free = puck.y - side * 2 * self._together
            return max(-self._reach[0], own[0] - 0.15), free
        return start

    def _direction(self, puck: PuckState) -> tuple[float, float]:
        """Return the direction of a stroke: at the goal, or away from a rail that is too near."""
        width = self._play.table.width_m
        lead = self._line - puck.x
        angles = [math.atan2(y - puck.y, lead) for y in (0.0, width - 2e-2, -width + 2e-2)]
        back, angle = self._together + 0.03, 0.0
        for angle in (*angles, 0.6, -0.6, 1.2, -1.2, 1.5, -1.5):
            x, y = puck.x - back * math.cos(angle), puck.y - back * math.sin(angle)
            if x >= -self._reach[0] and abs(y) <= self._reach[1]:
                break
        angle += self._aim
        return math.cos(angle), math.sin(angle)
