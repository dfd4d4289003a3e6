"""The pilot of one craft of a fleet: agrees on paths with the others, and follows its own."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from airpuck.control.law import Pilot, Step
from airpuck.control.tracking import TrackingController
from airpuck.fleet.agreement import Message
from airpuck.fleet.path import SMOOTHED, Following, Route
from airpuck.fleet.scenario import Fleet
from airpuck.fleet.search import SAME, SAVES, Search, Taken, in_the_way

#: Time between two searches, and between two messages [s].
_SEARCHES, _TELLS = 0.06, 0.02
#: Time for which others are given to accept a proposal, besides the craft's own delays [s].
_ANSWERS = 0.22
#: The rest of a path that is shorter than this is not improved any more [s].
_LATE = 0.6
#: A craft that finds no path to its goal for this time asks others to make way [s].
_PATIENT = 0.6
#: A craft is off its path beyond this multiple of its margin; it is treated as coasting for this
#: time [s], with this additional distance [m].
_OFF, _COASTS, _UNSURE = 2.5, 1.5, 0.03
#: A path may come this much closer to such a craft than this one is before it [m].
_NEARER = 1e-3
#: Speed below which a craft that coasts counts as resting [m/s].
_RESTS = 0.03
#: Poses this far apart give a velocity [s].
_APART = 0.02


@dataclass(frozen=True)
class Sighting:
    """The latest pose of a craft by motion capture, and its velocity."""

    time: float
    pose: Float[np.ndarray, " 3"]
    velocity: Float[np.ndarray, " 2"]


def sighted(before: Sighting | None, time: float, pose: Float[np.ndarray, " 3"]) -> Sighting:
    """Return what is known after another pose."""
    if before is None:
        return Sighting(time, pose, np.zeros(2))
    if time - before.time < _APART:
        return before
    return Sighting(time, pose, (pose[:2] - before.pose[:2]) / (time - before.time))


class FleetPilot(Pilot):
    """Steers one craft among others.

    Parameters
    ----------
    fleet : Fleet
        The scenario.
    name : str
        The craft.
    tell : callable
        Sends a message to the others.
    seed : int
        Of its search.
    start : float or None
        When the flight begins; None: `begin` says so later [s].
    """

    def __init__(
        self,
        fleet: Fleet,
        name: str,
        tell: Callable[[Message], None],
        *,
        seed: int = 0,
        start: float | None = 0.0,
    ) -> None:
        member, table = fleet.member(name), fleet.settings.table
        self.member, self._tell = member, tell
        self._fleet, self._start = fleet, start
        self.agreement = fleet.agreement(name, start)
        self._following = Following(self.agreement.agreed.path)
        self.controller = TrackingController(
            member.model, self._following, member.tuning, table=table
        )
        self.measured, self.sent = self.controller.measured, self.controller.sent
        room = member.reach.room
        self._search = Search(member.reach, np.array(table.reach(room)), seed)
        self._still = [one._replace(distance=one.distance + room) for one in fleet.obstacles]
        self._ahead = member.model.transport_delay + 2 * member.tuning.period_s
        self._seen: dict[str, Sighting] = {}
        self._next_search = _SEARCHES * np.random.default_rng(seed).random()
        self._next_message = 0.0
        self._stuck_since: float | None = None
        self._yields: tuple[float, str] | None = None

    @property
    def reference(self) -> Following:  # type: ignore[override]
        """The agreed path."""
        return self._following

    def begin(self, start: float) -> None:
        """Let the flight begin at a time [s]; until then all rest."""
        self._start = start
        self.agreement = self._fleet.agreement(self.member.name, start)
        self._following.path = self.agreement.agreed.path

    def heard(self, messages: Iterable[Message], now: float) -> None:
        """Receive messages of the others."""
        for message in messages:
            self.agreement.receive(message, now)

    def saw(self, seen: Mapping[str, Sighting]) -> None:
        """Receive the latest poses of the others by motion capture."""
        self._seen = dict(seen)

    def step(self, time: float) -> Step:
        """Agree, search, and compute the command; see `Pilot.step`."""
        agreement = self.agreement
        if agreement.settle(time, self._ahead):
            self._following.path = agreement.agreed.path
        if self._start is not None and time >= max(self._next_search, self._start):
            self._next_search = max(self._next_search + _SEARCHES, time)
            if agreement.proposal is None:
                self._look(time)
        if time >= self._next_message:
            self._next_message = max(self._next_message + _TELLS, time)
            self._tell(agreement.message(time))
        return self.controller.step(time)

    def _look(self, now: float) -> None:
        """Search for a better path, and propose it."""
        agreement, search, goal = self.agreement, self._search, self._goal(now)
        path = agreement.agreed.path
        own = search.cost(path, goal, now)
        there = np.abs(path.rest - goal).max() < SAME
        agreement.arrival = own
        way = self._way_to_make(now)
        missing = 0.0 if way is None else float(in_the_way(way, path.rest[None, :2])[0])
        begin = now + self._ahead + _ANSWERS
        loose = self._loose(now, begin)
        threatened = bool(loose) and not search.is_free(path, list(loose.values()), now)
        if there and not missing and not threatened and path.end < now + _LATE:
            self._stuck_since = agreement.wish = None
            return
        dead = agreement.silent(now) & set(loose)
        taken = [*agreement.taken(without=dead), *self._still, *loose.values()]
        # The longer it has waited, the less a path needs to be worth.
        waited = 0.0 if self._stuck_since is None else now - self._stuck_since
        keeps = math.inf if threatened else own + missing + waited - SAVES
        found = search.path(path, begin, goal, taken, keeps=keeps, corridor=way)
        if found is not None:
            agreement.propose(found, begin)
        arrives = found is not None and np.abs(found.rest - goal).max() < SAME
        self._wish(now, arrives or (there and not missing), missing > 0 and found is None, begin)

    def _goal(self, now: float) -> Float[np.ndarray, " 3"]:
        """Return the goal at a time."""
        assert self._start is not None
        return self.member.goal(now - self._start)

    def _wish(self, now: float, served: bool, cornered: bool, begin: float) -> None:
        """Ask the others to make way, if there has been no path for some time."""
        agreement = self.agreement
        if served:
            self._stuck_since = agreement.wish = None
            return
        self._stuck_since = now if self._stuck_since is None else self._stuck_since
        if cornered and self._yields is not None:
            rank = self._yields
        elif now - self._stuck_since > _PATIENT and self._yields is None:
            rank = (self._stuck_since, agreement.name)
        else:
            agreement.wish = None
            return
        path, goal = agreement.agreed.path, self._goal(now)
        wish = self._search.path(path, begin, goal, self._still, keeps=math.inf)
        agreement.wish = None if wish is None else (rank, wish)

    def _way_to_make(self, now: float) -> Taken | None:
        """Return the path for which this craft must make way: the wish of the highest rank."""
        wishes = sorted(self.agreement.wishes(now), key=lambda wish: wish[0])
        own = self.agreement.wish
        self._yields = None
        if not wishes or (own is not None and own[0] <= wishes[0][0]):
            return None
        self._yields = wishes[0][0]
        return Taken(wishes[0][1], 2 * self._search.reach.room)

    def _loose(self, now: float, begin: float) -> dict[str, Taken]:
        """Return the predicted paths of craft that do not follow their own."""
        found, silent = {}, self.agreement.silent(now)
        times, own = np.linspace(now, begin, 9), self.agreement.agreed.path
        for name, reach, path in self.agreement.followed():
            seen = self._seen.get(name)
            if seen is None:
                continue
            expected = path.places(np.array([seen.time - SMOOTHED / 2]))[0]
            off = math.dist(expected, seen.pose[:2]) > _OFF * reach.margin
            if off or (name in silent and now < path.end):
                rests = math.hypot(*seen.velocity) < _RESTS
                rate = np.append(np.zeros(2) if rests else seen.velocity, 0.0)
                lasting, none = np.full((3, 1), _COASTS), np.zeros((3, 1))
                distance = self._search.reach.room + reach.room + _UNSURE
                until = math.inf if rests else seen.time + _COASTS
                path = Route(seen.time, seen.pose, rate, lasting, none)
                # Of a craft that is too close already, a path can only lead away.
                gap = float(np.hypot(*(own.places(times) - path.places(times)).T).min())
                distance = min(distance, gap - _NEARER)
                found[name] = Taken(path, distance, until)
        return found
