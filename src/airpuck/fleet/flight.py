"""Flights of a fleet on the twin."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from airpuck.boundary.results import Result
from airpuck.control.law import Pilot, Step
from airpuck.data.measurement import Measurement
from airpuck.fleet.agreement import Message
from airpuck.fleet.path import Following
from airpuck.fleet.pilot import FleetPilot, Sighting, sighted
from airpuck.fleet.scenario import Fleet, Network
from airpuck.flight.loop import control
from airpuck.physics.rigid_body import pose_difference
from airpuck.twin.play import World
from airpuck.twin.twin import Twin

#: A craft has arrived within this distance and angle of its goal [m, rad].
NEAR, TURNED = 0.02, 0.1
#: A flight ends after all craft have been at their goals for this time [s].
_RESTS = 0.3


@dataclass(frozen=True, eq=False)
class FleetFlight(Result):
    """A flight of several craft.

    Attributes
    ----------
    names : tuple of str
        The craft.
    radii : array, shape (n,)
        Their radii [m].
    margins : array, shape (n,)
        Largest distances from the paths that the models' uncertainties allow [m].
    time : array, shape (N,)
        Times of the frames [s].
    poses : array, shape (N, n, 3)
        True poses.
    paths : array, shape (N, n, 2)
        Positions on their agreed paths, at the same times.
    arrived : dict of str to float
        When each craft reached its last goal for good [s]; infinite if it did not.
    died : dict of str to float
        When craft died [s].
    contacts : tuple of (float, str, str, float)
        Time, both craft, and closing speed of each contact [s; m/s].
    computing_s : array, shape (K,)
        Computing time of every step of every craft.

    Examples
    --------
    >>> from airpuck.fleet.scenario import FleetCraft
    >>> alone = FleetCraft(name="h0", start=(0.0, 0.0, 0.0))
    >>> fleet = airpuck.Fleet(airpuck.Scenario(craft=(alone,), duration_s=0.1))
    >>> isinstance(airpuck.fly_together(fleet), airpuck.FleetFlight)
    True
    """

    JSON = (
        "names settled_s=settled arrived_s=arrived died_s=died contacts least_gap_m=least_gap "
        "strayed_m=strayed margin_m=margins"
    )

    names: tuple[str, ...]
    radii: Float[np.ndarray, " n"]
    margins: Float[np.ndarray, " n"]
    time: Float[np.ndarray, " N"]
    poses: Float[np.ndarray, "N n 3"]
    paths: Float[np.ndarray, "N n 2"]
    arrived: Mapping[str, float]
    died: Mapping[str, float]
    contacts: tuple[tuple[float, str, str, float], ...]
    computing_s: Float[np.ndarray, " K"]

    @property
    def settled(self) -> float:
        """When the last live craft arrived [s]; infinite if one did not."""
        return max((t for name, t in self.arrived.items() if name not in self.died), default=0.0)

    @property
    def gaps(self) -> Float[np.ndarray, "N n n"]:
        """Distances between the craft's edges, infinite for a craft and itself [m]."""
        apart = self.poses[:, :, None, :2] - self.poses[:, None, :, :2]
        room = self.radii[:, None] + self.radii
        return np.hypot(apart[..., 0], apart[..., 1]) - room + np.diag(np.full(len(room), np.inf))

    @property
    def least_gap(self) -> float:
        """Smallest distance between the edges of two live craft [m]."""
        live = [k for k, name in enumerate(self.names) if name not in self.died]
        return float(self.gaps[:, live][:, :, live].min(initial=math.inf))

    @property
    def strayed(self) -> Float[np.ndarray, " n"]:
        """Largest distance of each craft from its path [m]."""
        off = self.poses[..., :2] - self.paths
        return np.hypot(off[..., 0], off[..., 1]).max(axis=0)


class _Air:
    """Messages between craft on the twin: late, lost, or both."""

    def __init__(self, network: Network, names: tuple[str, ...], seed: int) -> None:
        self._network, self._random = network, np.random.default_rng([seed, 7])
        self._coming: dict[str, list[tuple[float, Message]]] = {name: [] for name in names}

    def tell(self, message: Message) -> None:
        """Send a message to all others."""
        low, high = self._network.delay_s
        for name, coming in self._coming.items():
            if name != message.sender and self._random.random() >= self._network.loss:
                coming.append((message.time + self._random.uniform(low, high), message))

    def heard(self, name: str, now: float) -> list[Message]:
        """Return what has arrived at a craft, in order of arrival."""
        arrived = sorted(
            (one for one in self._coming[name] if one[0] <= now), key=lambda one: one[0]
        )
        self._coming[name] = [one for one in self._coming[name] if one[0] > now]
        return [message for _, message in arrived]


class _OnTwin(Pilot):
    """A pilot of the fleet with its craft and its connection to the others, until it dies."""

    def __init__(
        self, pilot: FleetPilot, twin: Twin, air: _Air, seen: dict[str, Sighting], dies: float
    ) -> None:
        self.pilot, self.twin, self.dies = pilot, twin, dies
        self._air, self._seen, self._name = air, seen, pilot.member.name
        self._off, self.sent = pilot.member.model.vehicle.idle, pilot.sent
        #: Time, true pose, and place on the path, each period.
        self.noted: list[tuple[float, Float[np.ndarray, " 3"], Float[np.ndarray, " 2"]]] = []

    @property
    def reference(self) -> Following:  # type: ignore[override]
        """The agreed path."""
        return self.pilot.reference

    def measured(self, measurement: Measurement) -> None:
        """Receive a pose, which motion capture shows to all."""
        if measurement.kind == "pose":
            before = self._seen.get(self._name)
            self._seen[self._name] = sighted(before, measurement.stamp, measurement.values)
        self.pilot.measured(measurement)

    def step(self, time: float) -> Step:
        """Let the pilot act, if its craft lives."""
        if time >= self.dies:
            return Step(self._off, "unsafe")
        self.pilot.heard(self._air.heard(self._name, time), time)
        self.pilot.saw(self._seen)
        return self.pilot.step(time)

    def note(self, now: float) -> None:
        """Take note of where the craft is, and where its path leads it."""
        # The true pose dates from the twin's last event.
        place = self.reference.at(self.twin.world.time, 0.0).state[:2]
        self.noted.append((now, self.twin.state[:3].copy(), place))

    def is_there(self) -> bool:
        """Return whether the craft is at its last goal."""
        return _there(self.twin.state[:3], self.pilot.member.goals[-1])


def fly_together(
    fleet: Fleet, seed: int = 0, pilot: Callable[..., FleetPilot] = FleetPilot
) -> FleetFlight:
    """Fly a scenario on the twin.

    Parameters
    ----------
    fleet : Fleet
        Craft, goals, obstacles, network and deaths.
    seed : int, default 0
        Of sensors, radios, messages and searches.
    pilot : callable, optional
        Makes the pilot of a craft; takes what `FleetPilot` takes.

    Returns
    -------
    FleetFlight
        Motions and contacts.

    Examples
    --------
    >>> from airpuck.fleet.scenario import FleetCraft
    >>> alone = FleetCraft(name="h0", start=(0.0, 0.0, 0.0), goal=(0.1, 0.0, 0.0))
    >>> fleet = airpuck.Fleet(airpuck.Scenario(craft=(alone,), duration_s=0.1))
    >>> flight = airpuck.fly_together(fleet, seed=1)
    >>> isinstance(flight, airpuck.FleetFlight), flight.arrived["h0"]  # on its way
    (True, inf)
    """
    world, air = World(fleet.settings), _Air(fleet.scenario.network, fleet.names, seed)
    dies = {death.craft: death.time_s for death in fleet.scenario.deaths}
    seen: dict[str, Sighting] = {}
    pilots = []
    for k, one in enumerate(fleet.members):
        own = 1000 * seed + k
        x, y, yaw = one.start.pose.tolist()
        twin = Twin(one.truth, fleet.settings, seed=own, pose=(x, y, yaw), world=world)
        flies = pilot(fleet, one.name, air.tell, seed=own)
        pilots.append(_OnTwin(flies, twin, air, seen, dies.get(one.name, math.inf)))
    return _flight(fleet, pilots, _flown(fleet, pilots), world)


def _flown(fleet: Fleet, pilots: Sequence[_OnTwin]) -> list[float]:
    """Fly until all have arrived, or the time is over; return all computing times [s]."""
    took, since = [], math.inf
    last = max(float(one.times[-1]) for one in fleet.members)
    loops = [
        control(one, one.twin, fleet.scenario.duration_s, one.pilot.member.tuning.period_s)
        for one in pilots
    ]
    for actions in zip(*loops, strict=True):
        now = actions[0].time
        took += [action.took for action in actions]
        for one in pilots:
            one.note(now)
        there = now >= last and all(one.is_there() for one in pilots if now < one.dies)
        since = min(since, now) if there else math.inf
        if now - since > _RESTS:
            break
    return took


def _there(pose: Float[np.ndarray, " 3"], goal: Float[np.ndarray, " 3"]) -> bool:
    """Return whether a craft is at its goal."""
    x, y, turned = pose_difference(np, pose, goal)
    return bool(math.hypot(x, y) <= NEAR and abs(turned) <= TURNED)


def _flight(
    fleet: Fleet, pilots: Sequence[_OnTwin], took: Sequence[float], world: World
) -> FleetFlight:
    """Gather what happened."""
    time = np.array([time for time, *_ in pilots[0].noted])
    poses = np.array([[pose for _, pose, _ in one.noted] for one in pilots])
    paths = np.array([[path for *_, path in one.noted] for one in pilots])
    arrived = {}
    for name, member, flown in zip(fleet.names, fleet.members, poses, strict=True):
        away = np.flatnonzero([not _there(pose, member.goals[-1]) for pose in flown])
        after = int(away[-1]) + 1 if len(away) else 0
        arrived[name] = float(time[after]) if after < len(time) else math.inf
    owner = {id(one.twin.craft): name for one, name in zip(pilots, fleet.names, strict=True)}
    met = [(t, owner[id(a)], owner[id(b)], speed) for t, a, b, speed in world.met]
    died = {name: one.dies for name, one in zip(fleet.names, pilots, strict=True)}
    return FleetFlight(
        fleet.names,
        np.array([one.reach.radius for one in fleet.members]),
        np.array([one.reach.margin for one in fleet.members]),
        time,
        poses.swapaxes(0, 1),
        paths.swapaxes(0, 1),
        arrived,
        {name: when for name, when in died.items() if when <= time[-1]},
        tuple(met),
        np.array(took),
    )
