"""The rules of air hockey: score, whose puck it is, and when a game is over."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal, NamedTuple

from airpuck.extend import Setting, Settings, numbers

if TYPE_CHECKING:
    from airpuck import AirHockey

#: In play, waiting for the puck after a goal, or over.
Phase = Literal["play", "goal", "over"]
#: A puck slower than this counts as at rest [m/s].
_RESTS = 0.05


@dataclass(frozen=True)
class Rules(Settings):
    """The rules of a game.

    Attributes
    ----------
    goals : int or None
        Goals needed to win; None: goals do not end the game.
    limit_s : float or None
        Time limit of a game; then the leader wins, and equal scores are a draw. None: no limit.
    foul_s : float
        Time on one side after which the puck goes to the other side.
    stuck_s : float
        Time at rest on the centre line after which the puck is served again.
    pause_s : float
        Time from a goal to the next serve.

    Raises
    ------
    InputError
        If a number is out of range.

    Examples
    --------
    >>> rules = airpuck_hockey.Rules(goals=3, limit_s=60.0)
    >>> rules.goals
    3
    """

    HEADING: ClassVar = ""

    goals: Annotated[int | None, Setting("Goals needed to win.", numbers.GOALS, "N")] = 7
    limit_s: Annotated[
        float | None, Setting("Time limit of a game.", numbers.GAME_TIME, "S", "--limit")
    ] = 300.0
    foul_s: Annotated[
        float, Setting("Time on one side that counts as a foul.", numbers.GAME_TIME, "S")
    ] = 15.0
    stuck_s: Annotated[float, Setting("Time at rest until a serve.", numbers.GAME_TIME, "S")] = 3.0
    pause_s: Annotated[float, Setting("Time from a goal to a serve.", numbers.PAUSE, "S")] = 1.0


class Ruling(NamedTuple):
    """A decision of the referee."""

    #: A goal, a foul, a puck that is stuck, a serve, the end.
    kind: Literal["goal", "foul", "stuck", "serve", "over"]
    #: Side that scored, committed the foul, serves or has won; 0 for neither.
    side: int


class Referee:
    """Keeps the score and applies the rules.

    Parameters
    ----------
    rules : Rules
        The rules.
    equipment : AirHockey
        Table and puck.
    first : int
        Who serves first, -1 (left) or 1.

    Attributes
    ----------
    score : tuple of int
        Goals of left and right.
    phase : str
        ``play``, ``goal``, ``over``.
    server : int
        The side that served last, or will serve next.
    """

    def __init__(self, rules: Rules, equipment: AirHockey, first: int) -> None:
        self.rules = rules
        self.score = (0, 0)
        self.phase: Phase = "play"
        self.server = first
        self._centre = equipment.puck.radius_m
        self._resumes = 0.0
        self._side, self._side_since = first, 0.0
        self._stuck_since: float | None = None

    def judge(self, time: float, x: float, speed: float, goal: int) -> list[Ruling]:
        """Apply the rules to the present state of the puck.

        Parameters
        ----------
        time : float
            Now [s].
        x, speed : float
            Position and velocity of the puck [m, m/s].
        goal : int
            The goal it is in, by the sign of x; 0: none.

        Returns
        -------
        list of Ruling
            Rulings in order; usually empty.
        """
        if self.phase == "over":
            return []
        found: list[Ruling] = []
        left, right = self.score
        if self.phase == "play" and goal:
            left, right = self.score = left + (goal > 0), right + (goal < 0)
            self.phase, self.server, self._resumes = "goal", goal, time + self.rules.pause_s
            found.append(Ruling("goal", -goal))
        goals, limit = self.rules.goals or math.inf, self.rules.limit_s or math.inf
        if max(self.score) >= goals or time >= limit:
            self.phase = "over"
            found.append(Ruling("over", (right > left) - (left > right)))
        elif self.phase == "goal":
            if time >= self._resumes:
                found.append(self.serve(time, self.server))
        elif broken := self._broken(time, x, speed):
            found += [broken, self.serve(time, -broken.side or -self.server)]
        return found

    def serve(self, time: float, side: int) -> Ruling:
        """Resume with a puck on a side, as the referee does, or someone who puts it into play."""
        self.phase, self.server = "play", side
        self._side, self._side_since, self._stuck_since = side, time, None
        return Ruling("serve", side)

    def _broken(self, time: float, x: float, speed: float) -> Ruling | None:
        """Return a foul, or a ruling that the puck is stuck."""
        side = (x > 0) - (x < 0)
        if side != self._side:
            self._side, self._side_since = side, time
        if side and time - self._side_since >= self.rules.foul_s:
            return Ruling("foul", side)
        if abs(x) > self._centre or speed > _RESTS:
            self._stuck_since = None
        elif self._stuck_since is None:
            self._stuck_since = time
        elif time - self._stuck_since >= self.rules.stuck_s:
            return Ruling("stuck", 0)
        return None
