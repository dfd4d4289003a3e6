"""Scorekeeping from poses alone: goals are inferred from where the puck was last seen."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from airpuck import AirHockey, Measurement, Pilot, PuckState
from airpuck.extend import Action, Process, Spectator, numbers
from airpuck_hockey.game.rules import Referee, Rules, Ruling
from airpuck_hockey.puck.prediction import goal_within
from airpuck_hockey.puck.puck_filter import PuckFilter

#: Consecutive poses that agree with the prediction before the puck's motion is trusted.
_SURE = 3
#: A puck that was about to score and is unseen for longer has scored [s].
_GONE = 0.2
#: Times to the goal at which nothing can stop a puck: anywhere, and in the mouth of the goal, where
#: it meets neither rails nor discs [s].
_AT_ONCE, _IN_THE_MOUTH = 0.02, 0.6
#: Distance beyond the rail's line from which on a puck is in the mouth of the goal, and by which
#: poses may be off elsewhere [m].
_MOUTH, _OFF = 1e-3, 0.02
#: A puck that reappears farther away than it could have moved, at twice its speed and at
#: this speed, was put there by hand [m/s]; tolerance of the distance [m].
_SENT_BACK, _NEAR = 5.0, 0.05
#: A repeated pose of a puck that moved faster than this is not a measurement [m/s].
_MOVING = 0.1
#: A longer gap without any pose means that the cameras were blind [s].
_BLIND = 0.1
#: A puck that is unseen for longer may have been carried anywhere [s].
_LOST = 1.0


class _Leaving(NamedTuple):
    """A puck that is about to be in a goal."""

    #: The goal, by the sign of x.
    goal: int
    #: Time and position of the last sighting, and the velocity [s, m, m/s].
    time: float
    x: float
    y: float
    speed: float


class Scorekeeper:
    """Applies the rules to a puck of which only poses are known.

    A goal is scored if a puck was about to enter with nothing to stop it, and one of two things
    follows. Either it is not seen for 0.2 s by cameras that see other objects, or it reappears
    where it could not have got to unaided: someone put it back into play. After a goal nothing
    counts until the puck is seen in play. Poses that freeze, jump, are not finite or off the table
    are ignored; blind cameras prove nothing.

    Parameters
    ----------
    equipment : AirHockey
        Table and puck.
    rules : Rules, optional
        By default first to seven; the time limit and the pause before a serve are not used.

    Attributes
    ----------
    games : int
        Number of the present game, from 1: after the end, the next puck in play begins another.
    calls : Counter
        Number of rulings by kind and side, in all games.
    """

    def __init__(self, equipment: AirHockey, rules: Rules | None = None) -> None:
        # The person who puts the puck back decides when.
        self._equipment = equipment
        self._rules = replace(rules or Rules(), pause_s=numbers.PAUSE.high, limit_s=None)
        self._filter = PuckFilter(equipment)
        self._line = equipment.table.length_m / 2
        self.games = 1
        self.calls: Counter[tuple[str, int]] = Counter()
        self._referee = Referee(self._rules, equipment, first=-1)
        #: Whether the puck has yet to be seen in play.
        self._away = True
        self._known = 0
        self._leaving: _Leaving | None = None
        #: The goal it was in before it reappeared elsewhere; 0: none.
        self._returned = 0
        self._newest: Float[np.ndarray, " 3"] | None = None
        #: Time and position of a jump [s, m].
        self._landed = (-math.inf, 0.0, 0.0)
        #: The last frame of the cameras [s].
        self._frame = -math.inf

    @property
    def score(self) -> tuple[int, int]:
        """Goals of left and right in this game."""
        return self._referee.score

    def frame(self, time: float) -> None:
        """Record that the cameras see something.

        Parameters
        ----------
        time : float
            When [s].
        """
        if math.isfinite(time) and time > self._frame:
            if time - self._frame > _BLIND:
                self._leaving = None
            self._frame = time

    def puck(self, time: float, pose: Float[np.ndarray, " 3"]) -> None:
        """Receive a pose of the puck.

        Parameters
        ----------
        time : float
            Time stamp of the pose [s].
        pose : array, shape (3,)
            x, y [m], yaw [rad].
        """
        before = self._filter.belief
        if not self._is_measured(pose):
            return
        self.frame(time)
        self._newest = pose
        self._filter.pose(time, pose)
        # A game may last for hours.
        self._filter.events.clear()
        belief = self._filter.belief
        if belief is None or belief is before:
            return
        # A restarted filter has no knowledge of the velocity.
        self._known = 1 if belief.covariance[3, 3] > 1.0 else self._known + 1
        x, y = belief.mean[:2].tolist()
        if self._known == 1:
            self._landed = time, x, y
        if self._known < _SURE:
            return
        if self._leaving is not None and self._carried(self._leaving):
            self._returned = self._leaving.goal
        self._leaving = self._about_to_be_in()

    def judge(self) -> list[Ruling]:
        """Return the rulings since the last call.

        Returns
        -------
        list of Ruling
            Goals, fouls, a stuck puck, the end of a game; usually empty.
        """
        belief = self._filter.belief
        if belief is None:
            return []
        x, speed = float(belief.mean[0]), float(np.hypot(*belief.mean[3:5]))
        goal, age = self._returned, self._frame - belief.time
        if self._leaving is not None and age > _GONE:
            goal = self._leaving.goal
        found: list[Ruling] = []
        if goal:
            self._returned, self._leaving = 0, None
            found = self._referee.judge(self._frame, x, speed, goal)
            self._away = True
        elif age > _LOST:
            self._away = True
        elif self._known >= _SURE and age <= _BLIND and abs(x) < self._rail + _MOUTH:
            if self._away:
                self._resume(belief.time, 1 if x > 0 else -1)
            found = self._referee.judge(belief.time, x, speed, 0)
        # The side that has the puck serves.
        found = [ruling for ruling in found if ruling.kind != "serve"]
        self.calls.update(found)
        return found

    @property
    def _rail(self) -> float:
        """Largest distance from the centre of a puck that is not in the mouth of a goal [m]."""
        return self._line - self._equipment.puck.radius_m

    def _resume(self, time: float, side: int) -> None:
        """Resume with a puck that someone has put into play; after the end, in another game."""
        if self._referee.phase == "over":
            self._referee = Referee(self._rules, self._equipment, side)
            self.games += 1
        self._referee.serve(time, side)
        self._away = False

    def _is_measured(self, pose: Float[np.ndarray, " 3"]) -> bool:
        """Return whether a pose is possible for a puck on the table or in the mouth of a goal."""
        if not np.isfinite(pose).all():
            return False
        table, radius = self._equipment.table, self._equipment.puck.radius_m
        x, y = np.abs(pose[:2]).tolist()
        in_front = y < table.goal_width_m / 2
        far = self._line + radius if in_front else self._rail + _OFF
        if x >= far or y > table.width_m / 2 - radius + _OFF:
            return False
        belief = self._filter.belief
        same = self._newest is not None and np.array_equal(pose, self._newest)
        return not (same and belief is not None and np.hypot(*belief.mean[3:5]) > _MOVING)

    def _about_to_be_in(self) -> _Leaving | None:
        """Return whether the puck is about to enter a goal and nothing can stop it any more."""
        belief = self._filter.belief
        if belief is None or self._away:
            return None
        state = PuckState(*belief.mean.tolist())
        horizon = _IN_THE_MOUTH if abs(state.x) > self._rail + _MOUTH else _AT_ONCE
        if abs(state.x + state.vx * horizon) < self._line:
            return None
        goal = goal_within(self._equipment, state, horizon)
        if not goal:
            return None
        return _Leaving(goal, belief.time, state.x, state.y, math.hypot(state.vx, state.vy))

    def _carried(self, leaving: _Leaving) -> bool:
        """Return whether the puck reappeared too far from the goal to have moved there unaided."""
        time, x, y = self._landed
        distance = math.hypot(x - leaving.x, y - leaving.y)
        fastest = max(2 * leaving.speed, _SENT_BACK)
        return time > leaving.time and distance > _NEAR + fastest * (time - leaving.time)


#: Players on the left and on the right.
NAMES = ("airpuck", "human")
#: Message of a ruling; filled in with the score, the player concerned, and the other.
_SAID = {
    "goal": "goal for {1}, {0}",
    "foul": "foul by {1}, the puck stayed too long on its side; {2} serves, {0}",
    "stuck": "the puck is stuck at the centre line; serve it again, {0}",
    "over": "{1} wins {0}; the next serve begins another game",
}


class Score(Spectator):
    """Keeps the score of a flight that plays, and reports changes; a `Spectator`."""

    def __init__(self, equipment: AirHockey) -> None:
        self.keeper = Scorekeeper(equipment)
        #: Rulings of the latest period.
        self.rulings: list[Ruling] = []
        self._sight: str | None = None
        self._new: list[Measurement] = []

    def begin(self, process: Process, pilot: Pilot) -> None:
        """Receive the participants; see `Spectator`."""
        self._events, self._pilot = process.events, pilot

    def measured(self, measurement: Measurement) -> None:
        """Store a pose until the command has left; see `Spectator`."""
        self._new.append(measurement)

    def after(self, action: Action) -> None:
        """Log rulings, and whether the puck is visible; see `Spectator`."""
        self.rulings = []
        # Poses of several bodies come body by body.
        for one in sorted(self._new, key=lambda one: one.stamp):
            if one.kind == "puck":
                self.keeper.puck(one.stamp, one.values)
            else:
                self.keeper.frame(one.stamp)
            # Process frame by frame, even if several have arrived at once.
            self.rulings += self.keeper.judge()
        self._new.clear()
        left, right = self.keeper.score
        for kind, side in self.rulings:
            names = NAMES[:: -1 if side > 0 else 1]
            said = _SAID[kind].format(f"{left} : {right}", *names)
            self._events.log("info", said, kind=said)
        sight = getattr(self._pilot, "sight", self._sight)
        if sight != self._sight:
            self._sight = sight
            level = "warning" if sight in ("frozen", "lost") else "info"
            self._events.log(level, f"the puck is {sight}", kind="puck")

    def to_json(self) -> dict[str, Any]:
        """Return score, games, and goals and fouls in all games; see `Spectator`."""
        calls = self.keeper.calls
        return {
            "score": list(self.keeper.score),
            "games": self.keeper.games,
            **{f"{kind}s": [calls[kind, -1], calls[kind, 1]] for kind in ("goal", "foul")},
        }
