"""What a player learns of its opponent during a game: stance, reaction and speed."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

# Before anything is seen; guesses except for the reaction, an adult's to a visual stimulus
# (Kosinski, "A literature review on reaction time", 2008).
_REACTION, _SPEED, _WAITS, _FOLLOWS = 0.2, 2.5, 0.2, 0.3
#: Acceleration of a hand with a mallet: the default limit of the table file [m/s²].
_ACCELERATION = 40.0
#: Weights of these assumptions: in observed reactions; in seconds of waiting; in m² s.
_REACTIONS, _SECONDS, _SQUARES = 2.0, 0.5, 0.005
#: An opponent slower than this stands still; a faster change of velocity is a reaction [m/s].
STILL, _REACTS = 0.2, 0.4
#: A hand is not faster; poses that jump look faster [m/s].
_FASTEST = 8.0
#: Reactions outside these times are coincidences [s].
_SOONEST, _LATEST = 0.08, 0.5
#: Longest time between two sightings that counts as waiting, and as one motion of the puck [s].
_GAP = 0.05
#: Weight of the assumption that bank shots score as expected [goals], and the largest factor by
#: which they may score more. Guesses.
_BANKS, _MOST_BANKS = 0.2, 1.5
#: A puck that vanishes this near to the opponent's goal line is in the goal [m].
_IN_GOAL = 0.15
#: Number of recent returns that are remembered; weight of the assumption that none is quick, in
#: returns; a puck that comes more slowly than this counts as this fast [m/s]. Guesses.
_RETURNS, _NO_RETURNS, _SLOWEST = 12, 2, 0.2


@dataclass(frozen=True)
class Rival:
    """Current estimate of an opponent."""

    #: Delay until it moves towards a shot [s].
    reaction: float = _REACTION
    #: Its largest speed [m/s].
    speed: float = _SPEED
    #: Distance from its goal line at which it waits [m].
    waits: float = _WAITS
    #: Its y while it waits, as a fraction of the puck's y.
    follows: float = _FOLLOWS
    #: Times from when the puck left for its half until the puck could be in the player's goal,
    #: sorted [s].
    returns: tuple[float, ...] = ()
    #: Goals of bank shots, as a fraction of the expected ones.
    banks: float = 1.0

    def is_quicker(self, time: Any) -> Any:
        """Return the probability that a shot comes back to the goal sooner than after a time."""
        return np.searchsorted(self.returns, time) / (len(self.returns) + _NO_RETURNS)

    def reach(self, time: Any) -> Any:
        """Return how far it gets in a time after a shot [m]."""
        left = np.maximum(time - self.reaction, 0.0)
        speeding_up = self.speed / _ACCELERATION
        short = _ACCELERATION * left**2 / 2
        return np.where(left < speeding_up, short, self.speed * (left - speeding_up / 2))


class RivalWatcher:
    """Estimates a `Rival` from the poses of the opponent's disc.

    Parameters
    ----------
    goal_line : float
        Position x of the opponent's goal [m].
    """

    def __init__(self, goal_line: float) -> None:
        self._goal_line = goal_line
        self._speed = _SPEED
        #: Sums over reactions [s], and their weight.
        self._reactions, self._count = _REACTIONS * _REACTION, _REACTIONS
        #: Sums over the time that it waited: of its distance, and of y against the puck's y.
        self._waited, self._time = _SECONDS * _WAITS, _SECONDS
        self._products, self._squares = _SQUARES * _FOLLOWS, _SQUARES
        self._last = -math.inf
        #: Last returns; whether the puck is in the other half, and when it got there and was seen.
        self._returns: deque[float] = deque(maxlen=_RETURNS)
        self._away, self._left, self._puck, self._x = False, -math.inf, -math.inf, 0.0
        #: Whether the last shot was a bank shot; goals of bank shots, and those expected.
        self._banked, self._goals, self._expected = False, _BANKS, _BANKS
        #: Time at which the puck was shot, and the opponent's velocity then.
        self._shot: tuple[float, Float[np.ndarray, " 2"]] | None = None

    @property
    def rival(self) -> Rival:
        """Current estimate of the opponent."""
        return Rival(
            self._reactions / self._count,
            self._speed,
            self._waited / self._time,
            self._products / self._squares,
            tuple(sorted(self._returns)),
            min(self._goals / self._expected, _MOST_BANKS),
        )

    def puck(self, time: float, x: float, vx: float) -> None:
        """Receive a sighting of the puck: its x, and its velocity along x."""
        if time - self._puck > _GAP:
            self._left = -math.inf
            self._goals += self._banked and self._x > self._goal_line - _IN_GOAL
            self._banked = False
        elif x > 0 and not self._away:
            self._left = time
        elif x <= 0 and self._away and self._left > -math.inf:
            self._returns.append(time - self._left + self._goal_line / max(-vx, _SLOWEST))
        self._away, self._puck, self._x = x > 0, time, x

    def shot(self, time: float, opponent: Float[np.ndarray, " 4"], banked: float = 0.0) -> None:
        """Begin to wait for the reaction to a shot, if the opponent stands still.

        A bank shot has a chance of scoring, which includes the present share of goals.
        """
        self._banked = banked > 0
        self._expected += banked / self.rival.banks
        if math.hypot(*opponent[2:]) < STILL:
            self._shot = time, opponent[2:]

    def seen(
        self, time: float, opponent: Float[np.ndarray, " 4"], puck: tuple[float, float]
    ) -> None:
        """Receive a sighting of the opponent: x, y, vx, vy, and the position of the puck."""
        speed = math.hypot(*opponent[2:])
        if speed < _FASTEST:
            self._speed = max(self._speed, speed)
        passed, self._last = time - self._last, time
        if puck[0] < 0 and speed < STILL and passed < _GAP:
            self._time += passed
            self._waited += passed * (self._goal_line - float(opponent[0]))
            self._squares += passed * puck[1] ** 2
            self._products += passed * puck[1] * float(opponent[1])
        if self._shot is not None:
            since, before = self._shot
            if math.dist(opponent[2:], before) > _REACTS:
                if _SOONEST < time - since < _LATEST:
                    self._reactions += time - since
                    self._count += 1
                self._shot = None
            elif time - since > _LATEST:
                self._shot = None
