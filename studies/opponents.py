"""Families of scripted opponents with human limits, to play against by name.

    airpuck match --right studies/opponents.py:Counter

The package's own hands are in `airpuck_hockey.game.hand`.
"""

from __future__ import annotations

import math
from dataclasses import replace

from airpuck import AirHockey, PuckState
from airpuck_hockey.game.hand import (
    KEEPERS,
    LOOK,
    STEP,
    Dexterity,
    HumanHand,
    Point,
    Striker,
)

# Numbers without a source are guesses.
#: Run-up of a stroke at an approaching puck [m], and its mean speed as a fraction of full speed.
_RUN_UP, _HITS_AT = 0.12, 0.7
#: A puck nearer to the goal line than this is only blocked [m].
_TOO_DEEP = 0.15
#: A wild hitter waits this far from its goal line [m].
_FORWARD = 0.35
#: The opponent counts as moving if its y changes by more than this between decisions [m].
_MOVES = 0.002


class Counter(Striker):
    """A counter-attacker: a striker who also returns an approaching puck in one touch."""

    def decided(self, time: float, own: Point) -> Point:
        """Meet an approaching puck with a stroke, if there is time; see `HumanHand.decided`."""
        return self._returned(time, own) or super().decided(time, own)

    def _returned(self, time: float, own: Point) -> Point | None:
        """Return where to begin the stroke at an approaching puck, or begin it."""
        fastest = self._dexterity.speed_m_s
        run_up = _RUN_UP / (_HITS_AT * fastest)
        for ahead, puck in self._approaching():
            nx, ny = self._direction(puck)
            back = self._together + _RUN_UP
            start = puck.x - back * nx, puck.y - back * ny
            if abs(start[0]) > self._reach[0] or abs(start[1]) > self._reach[1]:
                continue
            left = ahead - run_up
            if left < math.dist(own, start) / (_HITS_AT * fastest) - LOOK:
                continue
            if left > LOOK:
                return start
            self._stroke = time + ahead + LOOK, nx, ny
            return puck.x, puck.y
        return None

    def _approaching(self) -> list[tuple[float, PuckState]]:
        """Return when an approaching puck can be met [s from now], and its state then."""
        deep = -self._line + _TOO_DEEP + self._together
        return [
            (number * STEP, puck)
            for number, puck in enumerate(self._goes_by)
            if deep < puck.x < 0.0 and puck.vx < 0.0
        ]


class Banker(Striker):
    """A bank shooter: aims at the mirror image of the goal in the rail away from the craft."""

    def aims(self) -> tuple[float, ...]:
        """Aim over a side rail first; see `HumanHand.aims`."""
        corner, centre, *banks = super().aims()
        return *sorted(banks, key=lambda y: y * self._opponent[1]), corner, centre


class WrongFoot(Striker):
    """A striker who aims at the corner that the moving craft leaves."""

    def aims(self) -> tuple[float, ...]:
        """Aim against the opponent's motion; see `HumanHand.aims`."""
        if abs(self._opponent_moves) < _MOVES:
            return super().aims()
        return -math.copysign(self._corner, self._opponent_moves), *super().aims()


class Wild(HumanHand):
    """A wild hitter: rushes at every puck in its half, aims badly, and never guards its goal."""

    waits_m = _FORWARD

    def __init__(self, equipment: AirHockey, dexterity: Dexterity, seed: int = 0) -> None:
        fastest, badly = KEEPERS["hard"].speed_m_s, 2 * dexterity.aim_rad
        super().__init__(equipment, replace(dexterity, speed_m_s=fastest, aim_rad=badly), seed)

    def decided(self, time: float, own: Point) -> Point:
        """Strike, or wait for the puck; see `HumanHand.decided`."""
        if self._goes_by[0].x >= 0.0:
            self._aim_anew()
            return self._waiting()
        fastest = self._dexterity.speed_m_s
        for number, puck in enumerate(self._goes_by):
            dx, dy = puck.x - own[0], puck.y - own[1]
            away = math.hypot(dx, dy) - self._together
            if dx > abs(dy) and away <= _HITS_AT * fastest * number * STEP:
                angle = math.atan2(dy, dx) + self._aim
                nx, ny = math.cos(angle), math.sin(angle)
                self._stroke = time + number * STEP + LOOK, nx, ny
                return puck.x + self._together * nx, puck.y + self._together * ny
        return self._struck(time, own)
