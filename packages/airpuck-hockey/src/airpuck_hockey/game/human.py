"""A human opponent on the graph: a scripted hand, or the person at a page."""

from __future__ import annotations

import math

import numpy as np

from airpuck import Twin
from airpuck.extend import Inbox, Process, numbers
from airpuck_hockey.game.game import Side, serve
from airpuck_hockey.game.hand import HUMANS, GuidedHand, ScriptedHand
from airpuck_hockey.game.rules import Referee, Rules

#: Value to use instead of a skill: the person at a page moves the mallet.
PAGE = "page"
#: Time from the referee's call until a stuck puck, or the opponent's, is put back [s].
_FETCHED = 0.2
#: Time for which the mallet follows a target after its message [s].
_HOLDS = 0.25


class Human:
    """A human on the right of a twin that has a puck and a mallet.

    A script with some skill, or the person at a page (`PAGE`): then the graph gives the mallet's
    target.
    """

    def __init__(self, twin: Twin, process: Process, skill: str, seed: int) -> None:
        world = twin.world
        assert world.puck is not None
        assert world.mallet is not None
        self._world, self._twin, self._events = world, twin, process.events
        self._puck, self._random = world.puck, np.random.default_rng([seed, 21])
        self._side = Side(1, "human", world.mallet)
        self._hand = GuidedHand()
        #: Target of the mallet on the graph; None if a script moves it.
        self.targets: Inbox | None = None
        if skill == PAGE:
            self.targets, self._side.hand = Inbox(process, "mallet_target"), self._hand
        else:
            self._side.hand = ScriptedHand(twin.settings, HUMANS[skill])
        self._wanted_at = -math.inf
        # The server of the puck keeps neither score nor time.
        usual = Rules()
        rules = Rules(None, None, usual.foul_s + _FETCHED, usual.stuck_s + _FETCHED)
        self._referee = Referee(rules, twin.settings, 1 if self._puck.state.x > 0 else -1)

    def act(self, now: float) -> None:
        """Observe puck and craft, move the mallet, and serve the puck."""
        self._follow(now)
        puck, craft = self._puck, self._twin.state
        self._side.act(now, None if puck.goal else puck.state, (float(craft[0]), float(craft[1])))
        speed = math.hypot(puck.state.vx, puck.state.vy)
        for kind, side in self._referee.judge(now, puck.state.x, speed, puck.goal):
            if kind == "serve":
                where = "right" if side > 0 else "left"
                self._events.log("info", f"the puck is served on the {where}")
                serve(self._world, side, self._random)

    def _follow(self, now: float) -> None:
        """Store the mallet's target; old or non-finite targets are ignored."""
        for stamp, (x, y, _) in self.targets.take() if self.targets else ():
            if not (abs(x) <= numbers.COORDINATE.high and abs(y) <= numbers.COORDINATE.high):
                text = "rejected a position of the mallet that is far from the table"
                self._events.log("warning", text)
            elif now - stamp < _HOLDS:
                self._hand.wanted, self._wanted_at = (float(x), float(y)), stamp
        if now - self._wanted_at > _HOLDS:
            self._hand.wanted = None
