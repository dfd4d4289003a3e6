"""Strategies that search for contacts and keep the best one, and the order of their searches."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence

from airpuck_hockey.player.interception import Outlook, PlannedContact, path_is_clear
from airpuck_hockey.player.tactic import Intention, View

#: After a longer break between two decisions a plan is out of date [s]; five periods, in which the
#: puck's velocity becomes known again after a hit.
_INTERRUPTED = 0.05


class Searcher(ABC):
    """A strategy that searches for a contact, and keeps the best one while it remains feasible."""

    #: Number of decisions between searches.
    every: int

    def __init__(self) -> None:
        self._plan: PlannedContact | None = None
        #: The path to the start of a contact that cannot be reached directly.
        self._approach: Intention | None = None
        self._last_proposal = -math.inf

    @abstractmethod
    def applies(self, view: View, outlook: Outlook) -> bool:
        """Return whether this strategy applies to the puck."""

    @abstractmethod
    def search(self, view: View, outlook: Outlook) -> None:
        """Search for a contact, and plan it if it is better than the present plan."""

    def wants_search(self, view: View, outlook: Outlook) -> bool:
        """Return whether this strategy would accept another contact."""
        return self._plan is None and self.applies(view, outlook)

    def propose(self, view: View, outlook: Outlook) -> Intention | None:
        """Return the planned contact, or the path to where one is possible; None without either."""
        interrupted = view.time > self._last_proposal + _INTERRUPTED
        self._last_proposal = view.time
        if interrupted or not self.applies(view, outlook):
            self.forget()
        if self._plan is not None:
            self._plan = self.updated(view, outlook, self._plan)
        return self._approach if self._plan is None else self._plan.intention(view, outlook)

    def forget(self) -> None:
        """Drop the plan."""
        self._plan = self._approach = None

    def updated(self, view: View, outlook: Outlook, plan: PlannedContact) -> PlannedContact | None:
        """Return the plan for the puck's present motion; None if it is no longer feasible."""
        return plan if plan.holds(view, outlook) else None

    def adopt(self, view: View, outlook: Outlook, contacts: Sequence[PlannedContact]) -> None:
        """Plan the first contact whose path is clear, or else how to get to the first one."""
        self._approach = None
        plan = first_clear(view, outlook, contacts)
        if plan is not None:
            self._plan = plan
        elif self._plan is None and contacts:
            self._approach = contacts[0].approach(view, outlook)


def first_clear(
    view: View, outlook: Outlook, contacts: Sequence[PlannedContact]
) -> PlannedContact | None:
    """Return the first contact that the craft reaches without touching the puck earlier."""
    return next((each for each in contacts if path_is_clear(view, outlook, each)), None)


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
