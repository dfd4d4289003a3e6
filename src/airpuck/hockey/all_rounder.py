"""The package's own tactic: the first of its strategies that has something to propose."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol, runtime_checkable

from airpuck.hockey.attack import Shoot
from airpuck.hockey.goalkeeper import Blind, Defend, Wait
from airpuck.hockey.interception import Outlook
from airpuck.hockey.possession import Catch, Free
from airpuck.hockey.searching import Searcher, Turns
from airpuck.hockey.tactic import Intention, View

#: In play a puck that is slower than this is shot as it comes [m/s].
_CAUGHT = 0.35


@runtime_checkable
class Strategy(Protocol):
    """Knows one thing to do."""

    def propose(self, view: View, outlook: Outlook) -> Intention | None:
        """Return what to do; None: nothing of this kind."""
        ...


class AllRounder:
    """Plays: shoots, defends, slows the puck down, frees it, waits: a `Tactic`.

    Parameters
    ----------
    strategies : sequence of Strategy, optional
        What it can do; of those that have something to propose, the first one does. By default
        `Shoot`, `Defend`, `Catch`, `Free`, `Shoot` whatever the chance, `Wait`.
    """

    def __init__(self, strategies: Sequence[Strategy] | None = None) -> None:
        clear = Shoot(least=0.0, clears=True)
        self.strategies = strategies or (
            Shoot(),
            Defend(),
            Catch(slowest=_CAUGHT),
            Free(),
            clear,
            Wait(),
        )
        self._blind, self._turns = Blind(), Turns()

    def decide(self, view: View) -> Intention:
        """Return what to do now; see `Tactic.decide`."""
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
        # What a search finds takes precedence over what comes later in the list.
        searcher = self._turns.give(view, outlook, searchers)
        found = searcher and searcher.propose(view, outlook)
        return found or intention or self._blind.propose(view)
