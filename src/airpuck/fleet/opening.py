"""Paths of all craft to their first goals, planned before the flight begins.

Each craft computes all paths from the scenario alone, so all know the same ones.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from airpuck.craft.table import Table
from airpuck.fleet.path import Route
from airpuck.fleet.search import SAME, Reach, Search, Taken

#: Number of orders of the craft, and of searches for each craft in an order.
_ORDERS, _SEARCHES = 24, 4
#: No other order is tried once the last craft arrives within this multiple of the time that it
#: would need alone.
_GOOD = 1.02
#: When the paths begin: a craft knows no pose before, and its first commands are late [s].
_BEGIN = 0.05
#: Chance to vary the best order, and to shuffle it.
_BEST, _SHUFFLED = 0.5, 0.3


class Journey(NamedTuple):
    """What a craft can do, its path at rest, and its first goal."""

    reach: Reach
    start: Route
    goal: Float[np.ndarray, " 3"]


def opening(journeys: Sequence[Journey], obstacles: Sequence[Taken], table: Table) -> list[Route]:
    """Return paths that are clear of each other; all rest unless every craft reaches its goal.

    The paths are planned one after another, beginning with the longest flight. Then the craft that
    arrives last, or finds no path, moves to the front of the order.
    """
    random = np.random.default_rng(0)
    searches = [Search(one.reach, np.array(table.reach(one.reach.room)), 0) for one in journeys]
    alone = [s.cost(j.start, j.goal, _BEGIN) for s, j in zip(searches, journeys, strict=True)]
    order = sorted(range(len(journeys)), key=lambda k: -alone[k])
    found, best, least = [one.start for one in journeys], order, math.inf
    for _ in range(_ORDERS):
        paths, last = _in_order(order, journeys, searches, obstacles)
        ends = paths[last].end if last in paths else math.inf
        if ends < least:
            best, least, found = order, ends, [paths[k] for k in range(len(journeys))]
        if least <= _GOOD * max(alone):
            break
        order = list(best if random.random() < _BEST else order)
        if random.random() < _SHUFFLED:
            random.shuffle(order)
        order.remove(last)
        order.insert(int(random.integers(2)), last)
    return found


def _in_order(
    order: Sequence[int],
    journeys: Sequence[Journey],
    searches: Sequence[Search],
    obstacles: Sequence[Taken],
) -> tuple[dict[int, Route], int]:
    """Plan one craft after another; return the paths, and which arrives last or has none."""
    paths = dict[int, Route]()
    for k in order:
        one, search, room = journeys[k], searches[k], journeys[k].reach.room
        taken = [Taken(still, distance + room) for still, distance, _ in obstacles]
        taken += [Taken(path, room + journeys[j].reach.room) for j, path in paths.items()]
        path, cost = None, math.inf
        for _ in range(_SEARCHES):
            better = search.path(one.start, _BEGIN, one.goal, taken, keeps=cost)
            if better is not None:
                path, cost = better, search.cost(better, one.goal, _BEGIN)
        if path is None or np.abs(path.rest - one.goal).max() > SAME:
            return paths, k
        paths[k] = path
    return paths, max(paths, key=lambda k: paths[k].end)
