"""The package's own tactic: the first strategy with a proposal acts."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from airpuck.extend import checked_class
from airpuck_hockey.player.attack import SPEEDS, Shoot
from airpuck_hockey.player.defence import Blind, Catch, Defend, Free, Wait
from airpuck_hockey.player.interception import Outlook, Searcher
from airpuck_hockey.player.tactic import Intention, View

#: A slower puck is shot without being caught first [m/s].
_CAUGHT = 0.35


@runtime_checkable
class Strategy(Protocol):
    """One thing that a player can do."""

    def propose(self, view: View, outlook: Outlook) -> Intention | None:
        """Return an intention; None if the strategy does not apply."""
        ...


class Turns:
    """Gives the only search of a decision to one of several searchers.

    Two searches would take most of a control period. The searcher whose turn is most overdue gets
    it, whatever their order, so that none waits forever.
    """

    def __init__(self) -> None:
        self._decision = 0
        #: The decision of each searcher's last turn.
        self._last: dict[Searcher, int] = {}

    def give(self, view: View, outlook: Outlook, searchers: Iterable[Searcher]) -> Searcher | None:
        """Let one of the searchers search; return which, or None if none is due."""
        self._decision += 1
        waiting = [each for each in searchers if each.wants_search(view, outlook)]
        # Among equally overdue searchers, the longest wait decides.
        chosen = min(waiting, key=self._urgency, default=None)
        if chosen is None or self._urgency(chosen)[0] > self._decision:
            return None
        chosen.search(view, outlook)
        self._last[chosen] = self._decision
        return chosen

    def _urgency(self, searcher: Searcher) -> tuple[float, float, int]:
        """Return the decision at which a searcher is due, its last turn and its interval."""
        last = self._last.get(searcher, -math.inf)
        return last + searcher.every, last, searcher.every


@checked_class
class AllRounder:
    """Shoots, defends, catches and frees the puck, and waits; a `Tactic`.

    Parameters
    ----------
    strategies : sequence of Strategy, optional
        By priority: the first strategy with a proposal acts. By default `Shoot`, `Defend`,
        `Catch`, `Free`, `Shoot` whatever the chance, `Wait`.

    Examples
    --------
    >>> tactic = airpuck_hockey.AllRounder([airpuck_hockey.Shoot(least=0.3)])
    >>> isinstance(tactic, airpuck_hockey.Tactic)
    True
    """

    def __init__(self, strategies: Sequence[Strategy] | None = None) -> None:
        self.strategies = strategies or _strategies(SPEEDS)
        self._blind, self._turns = Blind(), Turns()

    def decide(self, view: View) -> Intention:
        """Return the intention; see `Tactic.decide`."""
        if view.puck is None:
            return self._blind.propose(view)
        outlook = Outlook(view)
        self._blind.seen(view, outlook)
        intention, searchers = None, []
        for strategy in self.strategies:
            if isinstance(strategy, Searcher):
                searchers.append(strategy)
            intention = strategy.propose(view, outlook)
            if intention is not None:
                break
        # The result of a search takes precedence over strategies later in the list.
        searcher = self._turns.give(view, outlook, searchers)
        found = searcher and searcher.propose(view, outlook)
        return found or intention or self._blind.propose(view)


def predecessor() -> AllRounder:
    """Return the tactic with the slower shots of earlier versions."""
    return AllRounder(_strategies(np.array([0.6, 1.3, 2.1])))


def _strategies(speeds: Float[np.ndarray, " L"]) -> Sequence[Strategy]:
    """Return the strategies by priority, with the craft's speeds for shots [m/s]."""
    shoot, clear = Shoot(speeds=speeds), Shoot(least=0.0, speeds=speeds, clears=True)
    return shoot, Defend(), Catch(slowest=_CAUGHT), Free(), clear, Wait()
