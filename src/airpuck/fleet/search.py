"""The search for a path: fast to the goal, and clear of all paths that others may fly.

Candidates begin on the craft's agreed path, accelerate once or twice at random, and then come to
rest at a target as fast as possible. All candidates are compared at once; the best of the last
search are varied in the next. Where the goal cannot be reached, a candidate rests elsewhere. Before
a flight, paths of all craft to their first goals are searched together.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from airpuck.craft.table import Table
from airpuck.fleet.path import Reach, Route, braked, pieces

#: Number of candidates of a search, of which this many vary the best ones of the last search.
_CANDIDATES, _VARIED = 72, 32
#: Candidates leave the agreed path at these times after the earliest possible one [s].
_LATER = np.array([0.0, 0.0, 0.3, 0.8])
#: Ways to share the push between x and y: angles [rad].
_SHARES = np.radians([8.0, 25.0, 45.0, 65.0, 82.0])
#: Steps of the final check of a candidate [s]; all are compared at every fourth.
_FINE, _COARSE = 0.025, 4
#: Longest first and second acceleration [s].
_LONGEST = 0.8
#: Longest path [s]; a slow craft may take that long across the table.
_HORIZON = 30.0
#: Cost of resting away from the goal, besides the time to get there from rest [s].
_AWAY = 1.0
#: Cost of blocking a path that has priority while at rest, per metre of missing clearance [s/m].
_BLOCKING = 100.0
#: Least saving of cost that justifies a new path [s].
SAVES = 0.05
#: The end of a path and a goal that are closer than this are the same [m, rad].
SAME = 1e-6
#: Number of candidates that are checked in fine steps.
_CHECKED = 6


class Taken(NamedTuple):
    """A path that another body may follow, the distance to keep from it [m], and until when [s]."""

    path: Route
    distance: float
    until: float = math.inf


class Sampled(NamedTuple):
    """Paths of others at common times, which reach until all of them rest."""

    times: Float[np.ndarray, " T"]
    places: Float[np.ndarray, "T M 2"]
    distances: Float[np.ndarray, "T M"]
    pushes: Float[np.ndarray, " M"]

    @classmethod
    def of(cls, taken: Sequence[Taken], since: float, until: float) -> Sampled:
        """Sample paths from a time until they and another one rest."""
        until = max([until, *(one.path.end for one in taken)])
        times = since + _FINE * np.arange(math.ceil((until - since) / _FINE) + 2)
        distances = np.zeros((len(times), len(taken)))
        places = np.zeros((*distances.shape, 2))
        for k, one in enumerate(taken):
            places[:, k] = one.path.places(times)
            distances[times <= one.until, k] = one.distance
        return cls(times, places, distances, np.array([one.path.push for one in taken]))

    def clear_of(self, path: Route) -> bool:
        """Return whether a path keeps its distances, between the times, too.

        Between two times, relative positions differ from a straight line by at most a t²/8.
        """
        apart = path.places(self.times)[:, None] - self.places
        step = np.diff(apart, axis=0)
        along = -np.einsum("tmi,tmi->tm", apart[:-1], step)
        length = np.maximum(np.einsum("tmi,tmi->tm", step, step), 1e-18)
        nearest = apart[:-1] + np.clip(along / length, 0.0, 1.0)[..., None] * step
        square = np.einsum("tmi,tmi->tm", nearest, nearest)
        least = self.distances[:-1] + (path.push + self.pushes) * _FINE**2 / 8
        return bool((square >= least**2)[self.distances[:-1] > 0].all())


class Recipe(NamedTuple):
    """What distinguishes candidates: when they leave, how they accelerate, and where they rest."""

    later: Float[np.ndarray, " C"]
    pushes: Float[np.ndarray, "C 2 2"]
    lasting: Float[np.ndarray, "C 2"]
    target: Float[np.ndarray, "C 2"]

    def of(self, rows: np.ndarray) -> Recipe:
        """Return some of the candidates."""
        return Recipe(*(field[rows] for field in self))


class _Laid(NamedTuple):
    """The pieces of all candidates in x and y, from the states in which they leave."""

    begin: float
    pose: Float[np.ndarray, "C 3"]
    rate: Float[np.ndarray, "C 3"]
    durations: Float[np.ndarray, "C 2 S"]
    accelerations: Float[np.ndarray, "C 2 S"]


class Search:
    """Looks for paths of one craft.

    Parameters
    ----------
    reach : Reach
        What the craft can do.
    border : array, shape (2,)
        Largest |x| and |y| of its path [m].
    seed : int
        Of its random candidates.
    """

    def __init__(self, reach: Reach, border: Float[np.ndarray, " 2"], seed: int) -> None:
        self.reach, self.border = reach, border
        self._random = np.random.default_rng(seed)
        self._best: Recipe | None = None

    def cost(self, path: Route, goal: Float[np.ndarray, " 3"], now: float) -> float:
        """Return when the craft will have arrived, at the earliest [s]."""
        rest = path.rest
        away = float(np.hypot(*(goal - rest)[:2]))
        turned = soonest(abs(goal[2] - rest[2]), self.reach.turn, self.reach.spin)
        end = max(path.end, now)
        if away < 1e-6:
            return end + turned
        return end + max(soonest(away, self.reach.push, self.reach.speed), turned) + _AWAY

    def path(
        self,
        agreed: Route,
        begin: float,
        goal: Float[np.ndarray, " 3"],
        taken: Sequence[Taken],
        *,
        keeps: float,
        corridor: Taken | None = None,
    ) -> Route | None:
        """Return a path that leaves the agreed one after a time, or None if none is better.

        Parameters
        ----------
        agreed : Route
            The path that the craft flies now.
        begin : float
            Earliest time to leave it [s].
        goal : array, shape (3,)
            Where to rest, if possible.
        taken : sequence of Taken
            Paths to keep clear of.
        keeps : float
            Cost to improve on.
        corridor : Taken, optional
            A path that its place of rest should be clear of, all along.
        """
        recipe = self._recipes(agreed, begin, goal)
        laid = self._laid(agreed, begin, recipe)
        ends = begin + recipe.later + laid.durations.sum(axis=2).max(axis=1)
        away = np.hypot(*(recipe.target - goal[:2]).T)
        later = _AWAY + soonest(away, self.reach.push, self.reach.speed)
        costs = ends + (away > 1e-9) * later
        others = Sampled.of(taken, begin, min(float(ends.max()), begin + _HORIZON))
        free = self._free(laid, begin + recipe.later, agreed, others) & self._is_slow(laid)
        if corridor is not None:
            costs += in_the_way(corridor, recipe.target)
        costs[~free | (ends > begin + _HORIZON)] = np.inf
        order = np.argsort(costs)
        self._best = recipe.of(order[: min(10, int(free.sum()))]) if free.any() else None
        for index in order[:_CHECKED]:
            if not costs[index] < keeps:
                return None
            found = self._path(agreed, begin + float(recipe.later[index]), laid, int(index), goal)
            if self._is_within(found, others):
                return found
        return None

    def is_free(self, path: Route, taken: Sequence[Taken], since: float) -> bool:
        """Return whether a path keeps clear of others and of the border from a time on."""
        return self._is_within(path, Sampled.of(taken, since, path.end))

    def _is_within(self, path: Route, others: Sampled) -> bool:
        """Return whether a path keeps clear of others and of the border."""
        most = np.abs(path.places(others.times)).max(axis=0)
        inside = (most <= self.border + path.push * _FINE**2 / 8).all()
        return bool(inside) and others.clear_of(path)

    def _recipes(self, agreed: Route, begin: float, goal: Float[np.ndarray, " 3"]) -> Recipe:
        """Draw candidates."""
        random, count, push = self._random, _CANDIDATES, self.reach.push
        angle = random.uniform(0, 2 * np.pi, (count, 2))
        size = push * random.choice([0.0, 0.6, 1.0], (count, 2))
        pushes = size[..., None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        lasting = _LONGEST * random.random((count, 2)) ** 2
        lasting[: len(_LATER)] = 0.0
        lasting[count // 2 :, 1] = 0.0
        later = np.resize(_LATER, count)
        target = np.tile(goal[:2], (count, 1))
        near = agreed.rest[:2] + 0.3 * random.normal(size=(count, 2))
        between = goal[:2] + random.random((count, 1)) * (agreed.rest[:2] - goal[:2])
        spread = between + 0.15 * random.normal(size=(count, 2))
        target[2::6], target[5::6] = near[2::6], spread[5::6]
        recipe = Recipe(later, pushes, lasting, np.clip(target, -self.border, self.border))
        return recipe if self._best is None else self._varied(recipe, goal)

    def _varied(self, recipe: Recipe, goal: Float[np.ndarray, " 3"]) -> Recipe:
        """Replace the last candidates by variations of the best paths of the previous search."""
        random, best = self._random, self._best
        assert best is not None
        own = best.of(np.resize(np.arange(len(best.later)), _VARIED))
        pushes = own.pushes + 0.3 * self.reach.push * random.normal(size=own.pushes.shape)
        size = np.hypot(pushes[..., 0], pushes[..., 1])[..., None]
        pushes = pushes * np.minimum(1.0, self.reach.push / np.maximum(size, 1e-9))
        lasting = np.abs(own.lasting + 0.1 * random.normal(size=own.lasting.shape))
        later = np.abs(own.later + 0.1 * random.normal(size=own.later.shape))
        target = own.target + 0.05 * random.normal(size=own.target.shape)
        at_goal = np.hypot(*(own.target - goal[:2]).T) < 0.05
        target[at_goal] = goal[:2]
        varied = Recipe(later, pushes, lasting, np.clip(target, -self.border, self.border))
        pairs = zip(recipe, varied, strict=True)
        return Recipe(*(np.concatenate([old[:-_VARIED], new]) for old, new in pairs))

    def _laid(self, agreed: Route, begin: float, recipe: Recipe) -> _Laid:
        """Return the pieces of all candidates, in x and y, from the time at which they leave."""
        start = agreed.moved(begin + recipe.later)
        place, rate = start.pose[:, :2], start.rate[:, :2]
        lasting = recipe.lasting[:, None, :]
        pushes = np.swapaxes(recipe.pushes, 1, 2)
        for piece in range(2):
            d, a = recipe.lasting[:, piece, None], recipe.pushes[:, piece]
            place, rate = place + (rate + a * d / 2) * d, rate + a * d
        offset = place - recipe.target
        shares = np.stack([np.cos(_SHARES), np.sin(_SHARES)])  # (2, K)
        # A craft at rest goes straight.
        straight = np.abs(offset) / np.maximum(np.hypot(*offset.T)[:, None], 1e-9)
        split = np.concatenate(
            [np.tile(shares, (len(offset), 1, 1)), np.maximum(straight, 0.05)[..., None]], axis=2
        )
        split = split / np.hypot(split[:, :1], split[:, 1:])
        durations, accelerations = braked(
            offset[..., None], rate[..., None], self.reach.push * split, self.reach.speed * split
        )
        fastest = durations.sum(axis=3).max(axis=1).argmin(axis=1)
        chosen = np.arange(len(offset)), slice(None), fastest
        return _Laid(
            begin,
            start.pose,
            start.rate,
            np.concatenate([np.broadcast_to(lasting, pushes.shape), durations[chosen]], axis=2),
            np.concatenate([pushes, accelerations[chosen]], axis=2),
        )

    def _is_slow(self, laid: _Laid) -> np.ndarray:
        """Return which candidates keep to the craft's speed."""
        # A speed is largest where an acceleration changes.
        ends = np.cumsum(laid.durations, axis=2)
        since = ends.reshape(len(ends), -1, 1, 1) - (ends - laid.durations)[:, None]
        within = np.clip(since, 0.0, laid.durations[:, None])
        rates = laid.rate[:, None, :2] + np.sum(laid.accelerations[:, None] * within, axis=3)
        return (np.hypot(rates[..., 0], rates[..., 1]) <= self.reach.speed + 1e-6).all(axis=1)

    def _free(
        self, laid: _Laid, leaves: Float[np.ndarray, " C"], agreed: Route, others: Sampled
    ) -> np.ndarray:
        """Return which candidates are free at coarse steps."""
        times = others.times[::_COARSE]
        elapsed = times[:, None] - leaves
        place = _places(laid, np.maximum(elapsed, 0.0))
        early = elapsed < 0
        if early.any():
            place = np.where(early[..., None], agreed.places(times)[:, None], place)
        free = np.all(np.abs(place) <= self.border + 1e-6, axis=(0, 2))
        for k in range(others.places.shape[1]):
            apart = place - others.places[::_COARSE, None, k]
            least = others.distances[::_COARSE, None, k] ** 2
            free &= (np.einsum("tci,tci->tc", apart, apart) >= least).all(axis=0)
        return free

    def _path(
        self, agreed: Route, leaves: float, laid: _Laid, index: int, goal: Float[np.ndarray, " 3"]
    ) -> Route:
        """Return one candidate, with its yaw, as a continuation of the agreed path."""
        start = agreed.moved(np.array([leaves]))
        durations = np.zeros((3, laid.durations.shape[2]))
        accelerations = np.zeros_like(durations)
        durations[:2], accelerations[:2] = laid.durations[index], laid.accelerations[index]
        off, spin = start.pose[0, 2:] - goal[2], start.rate[0, 2:]
        turns, turned = braked(off, spin, np.array([self.reach.turn]), self.reach.spin)
        durations[2, :3], accelerations[2, :3] = turns[0], turned[0]
        then = Route(leaves, start.pose[0], start.rate[0], durations, accelerations)
        return agreed.followed(laid.begin - 1.0, leaves, then)


def _places(laid: _Laid, since: Float[np.ndarray, "T C"]) -> Float[np.ndarray, "T C 2"]:
    """Return x and y of many paths at times since each began."""
    durations, accelerations = laid.durations, laid.accelerations
    begins, rates = pieces(laid.rate[:, :2], durations, accelerations)
    place = np.broadcast_to(laid.pose[:, :2], (*since.shape, 2)).copy()
    for piece in range(durations.shape[2]):
        within = np.clip(since[..., None] - begins[..., piece], 0.0, durations[..., piece])
        place += (rates[..., piece] + accelerations[..., piece] / 2 * within) * within
    return place


def soonest(distance: Any, push: float, fastest: float) -> Any:
    """Return the least time from rest to rest [s]."""
    slow = distance * push < fastest**2
    return np.where(slow, 2 * np.sqrt(distance / push), distance / fastest + fastest / push)


def apart(path: Route, other: Taken, since: float) -> bool:
    """Return whether two paths keep their distance from a time on, for ever."""
    return Sampled.of([other], since, path.end).clear_of(path)


def in_the_way(corridor: Taken, places: Float[np.ndarray, "C 2"]) -> Float[np.ndarray, " C"]:
    """Return the cost of resting in the way of a whole path; zero where that is clear [s]."""
    times = np.linspace(corridor.path.begin, corridor.path.end, 60)
    along = corridor.path.places(times)[:, None]
    nearest = np.hypot(*np.moveaxis(along - places, -1, 0)).min(axis=0)
    return _BLOCKING * np.maximum(corridor.distance - nearest, 0.0)


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
