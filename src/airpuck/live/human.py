"""The human at the twin's table: moves the mallet on the right, and serves by the rules."""

from __future__ import annotations

import math

import numpy as np

from airpuck.hockey.game import Side, serve
from airpuck.hockey.hand import HUMANS, GuidedHand, ScriptedHand
from airpuck.hockey.rules import Referee, Rules
from airpuck.live.process import Inbox, Process
from airpuck.twin.twin import Twin

#: In place of a skill.
PAGE = "page"
#: Where the mallet is at first [m].
BEGINS = 0.85
#: Time from the call to fetching a stuck puck, or the opponent's [s].
_FETCHED = 0.2
#: The mallet follows a target for this long after its message [s].
_HOLDS = 0.25


class Human:
    """A human on the right of a twin that has a puck and a mallet.

    A script of some skill, or who is at a page (`PAGE`): then the graph says where the mallet is
    wanted.
    """

    def __init__(self, twin: Twin, process: Process, skill: str, seed: int) -> None:
        world = twin.world
        assert world.puck is not None
        assert world.mallet is not None
        self._world, self._twin, self._events = world, twin, process.events
        self._puck, self._random = world.puck, np.random.default_rng([seed, 21])
        self._side = Side(1, "human", world.mallet)
        self._hand = GuidedHand()
        #: Where the graph wants the mallet; None where a script moves it.
        self.targets: Inbox | None = None
        if skill == PAGE:
            self.targets, self._side.hand = Inbox(process, "mallet_target"), self._hand
        else:
            self._side.hand = ScriptedHand(twin.settings, HUMANS[skill])
        self._wanted_at = -math.inf
        # The server of the puck keeps neither score nor time.
        usual = Rules()
        changes = {"foul_s": usual.foul_s + _FETCHED, "stuck_s": usual.stuck_s + _FETCHED}
        rules = usual.model_copy(update={**changes, "limit_s": math.inf, "goals": math.inf})
        self._referee = Referee(rules, twin.settings, 1 if self._puck.state.x > 0 else -1)

    def act(self, now: float) -> None:
        """See puck and craft, move the mallet, and put the puck where it belongs."""
        self._follow(now)
        puck, craft = self._puck, self._twin.state
        seen = None if puck.goal else puck.state
        self._side.act(now, seen, (float(craft[0]), float(craft[1])))
        speed = math.hypot(puck.state.vx, puck.state.vy)
        for kind, side in self._referee.judge(now, puck.state.x, speed, puck.goal):
            if kind == "serve":
                where = "right" if side > 0 else "left"
                self._events.log("info", f"the puck is served on the {where}")
                serve(self._world, side, self._random)

    def _follow(self, now: float) -> None:
        """Store the mallet's target; old or non-finite targets are ignored."""
        for stamp, (x, y, _) in self.targets.take() if self.targets else ():
            if not (math.isfinite(x) and math.isfinite(y)):
                text = "refused: a place for the mallet that is not finite"
                self._events.log("warning", text)
            elif now - stamp < _HOLDS:
                self._hand.wanted, self._wanted_at = (float(x), float(y)), stamp
        if now - self._wanted_at > _HOLDS:
            self._hand.wanted = None
