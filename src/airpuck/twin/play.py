"""The joint motion of all discs on a table: puck, craft, and mallets."""

from __future__ import annotations

import itertools
import math
from typing import Protocol

import numpy as np
from jaxtyping import Float

from airpuck.boundary.errors import InputError
from airpuck.boundary.numbers import check_finite
from airpuck.craft.table import AirHockey, Contact, Mallet, Table
from airpuck.physics.puck import PuckState, strike
from airpuck.physics.puck_on_table import Moving, PuckOnTable
from airpuck.twin.craft import Craft
from airpuck.twin.plant import LONGEST_STEP

#: A shorter step is a rounding error of times and gives no speed [s].
_NO_TIME = 1e-9


class HandMallet:
    """The human's mallet: it follows the hand's target at the speed of a hand.

    Parameters
    ----------
    mallet : Mallet
        Dimensions and limits.
    table : Table
        The table. The mallet keeps to the half in which it starts.
    x, y : float
        Initial position of its centre [m].

    Attributes
    ----------
    target : tuple of float
        Target of the hand [m].
    x, y, vx, vy : float
        Position [m] and velocity [m/s].
    """

    def __init__(self, mallet: Mallet, table: Table, x: float, y: float) -> None:
        self.radius = mallet.radius_m
        self._limits = mallet.speed_m_s, mallet.acceleration_m_s2
        self._side = math.copysign(1.0, x)
        self._reach = table.reach(mallet.radius_m)
        self.x, self.y = self.allowed(x, y)
        self.vx = self.vy = 0.0
        self._target = self.x, self.y

    @property
    def target(self) -> tuple[float, float]:
        """Target of the hand [m]; setting it checks that it is finite."""
        return self._target

    @target.setter
    def target(self, place: tuple[float, float]) -> None:
        x, y = place
        check_finite(target=x + y)
        self._target = x, y

    def allowed(self, x: float, y: float) -> tuple[float, float]:
        """Return the nearest position on its half of the table.

        Parameters
        ----------
        x, y : float
            A position [m].

        Returns
        -------
        x, y : float
            The nearest position that the mallet's centre can reach [m].
        """
        x_reach, y_reach = self._reach
        x = self._side * max(self.radius, min(self._side * x, x_reach))
        return x, max(-y_reach, min(y, y_reach))

    def next_change(self, now: float) -> float:
        """Return infinity: a hand's motion has no events of its own."""
        return math.inf

    def longest_step(self, puck: PuckOnTable) -> float:
        """Return the longest allowed step [s]; a straight path needs no shorter one."""
        return LONGEST_STEP

    def pose(self) -> Float[np.ndarray, " 3"]:
        """Return its pose; it does not turn."""
        return np.array([self.x, self.y, 0.0])

    @property
    def place(self) -> tuple[float, float]:
        """The position of its centre [m]."""
        return self.x, self.y

    def disc(self) -> Moving:
        """Return it as a disc that others can hit now."""
        return Moving(self.x, self.y, self.vx, self.vy, radius=self.radius)

    def moving(self, duration: float, now: float = 0.0) -> Moving:
        """Return its path in a step: straight, at a speed from which it can still stop."""
        fastest, hardest = self._limits
        x, y = self.allowed(*self.target)
        dx, dy = x - self.x, y - self.y
        distance = math.hypot(dx, dy)
        # At the end of a step it rests at the target, or is still able to stop there.
        reserve = hardest * duration
        speed = min(fastest, math.sqrt(reserve**2 / 4 + 2 * hardest * distance) - reserve / 2)
        speed = min(speed, distance / duration) / distance if distance else 0.0
        wanted_x, wanted_y = speed * dx - self.vx, speed * dy - self.vy
        change = math.hypot(wanted_x, wanted_y)
        share = min(1.0, reserve / change) if change else 0.0
        vx, vy = self.vx + share * wanted_x, self.vy + share * wanted_y
        to_x, to_y = self.allowed(self.x + vx * duration, self.y + vy * duration)
        return Moving(
            self.x,
            self.y,
            (to_x - self.x) / duration,
            (to_y - self.y) / duration,
            radius=self.radius,
            to_x=to_x,
            to_y=to_y,
        )

    def arrive(self, way: Moving, duration: float, hit: bool = False) -> None:
        """Move to the end of the path; a wedged puck may have held it back."""
        if duration > _NO_TIME:
            self.vx, self.vy = (way.x - self.x) / duration, (way.y - self.y) / duration
        self.x, self.y = way.x, way.y


class WorldObserver(Protocol):
    """Takes measurements at its own times."""

    @property
    def due(self) -> float:
        """Time of its next measurement [s]."""
        ...

    def observe(self, time: float) -> None:
        """Take a measurement if it is due."""
        ...


class World:
    """A puck and the discs that play with it, on one table, simulated from event to event.

    Parameters
    ----------
    play : AirHockey
        Table, puck and mallet; a twin's settings contain all three.
    puck : PuckState, optional
        Initial state of the puck; by default there is no puck.
    logs : bool, default True
        Whether to record all contacts of the puck.

    Attributes
    ----------
    puck : PuckOnTable or None
        The puck.
    bodies : list of Craft or HandMallet
        The discs.
    observers : list of WorldObserver
        Sensors; each is called at the times that it requests.
    time : float
        Time of the last event [s].
    """

    def __init__(
        self, play: AirHockey, puck: PuckState | None = None, *, logs: bool = True
    ) -> None:
        rail = play.table
        self._rail = Contact(restitution=rail.restitution, grip=1.0, friction=rail.friction)
        self.puck = None if puck is None else PuckOnTable(play, puck, logs=logs)
        self.bodies: list[Craft | HandMallet] = []
        self.observers: list[WorldObserver] = []
        self.time = 0.0
        #: Contacts of discs other than the puck: when [s], which two, their closing speed [m/s].
        self.met: list[tuple[float, Craft | HandMallet, Craft | HandMallet, float]] = []

    def other(self, body: Craft | HandMallet) -> Craft | HandMallet:
        """Return the disc on the other side."""
        found = next((each for each in self.bodies if each is not body), None)
        if found is None:
            raise InputError("has only one disc; add a second one", field="world")
        return found

    @property
    def mallet(self) -> HandMallet | None:
        """The human's mallet, if there is one."""
        return next((body for body in self.bodies if isinstance(body, HandMallet)), None)

    def run(self, time: float) -> None:
        """Advance to the last event that is not after a time [s]."""
        while True:
            following = min(observer.due for observer in self.observers)
            for body in self.bodies:
                following = min(following, body.next_change(self.time))
            if following > time:
                break
            self._advance(following)
            for observer in self.observers:
                observer.observe(following)

    def puck_pose(self) -> Float[np.ndarray, " 3"]:
        """Return the true pose of the puck, NaN where it is in a goal."""
        assert self.puck is not None
        return np.full(3, math.nan) if self.puck.goal else np.array(self.puck.state[:3])

    def _advance(self, time: float) -> None:
        """Move all discs to a time; there must be no event in between."""
        while self.time < time:
            duration = min(time - self.time, LONGEST_STEP)
            # The last piece ends at the exact time, not a rounding error before it.
            end = time if duration == time - self.time else self.time + duration
            if self.puck is not None:
                for body in self.bodies:
                    end = min(end, self.time + body.longest_step(self.puck))
                duration = end - self.time
            self._step(end, duration)
            self._part()

    def _step(self, end: float, duration: float) -> None:
        """Advance to a time, or until the puck hits a disc that can move."""
        begin, hit = self.time, None
        ways = [body.moving(duration, begin) for body in self.bodies]
        if self.puck is None:
            for way in ways:
                way.x, way.y = way.to_x, way.to_y
            self.time = end
        else:
            hit = self.puck.run(end, ways)
            self.time = self.puck.time
            duration = duration if self.time == end else self.time - begin
        for body, way in zip(self.bodies, ways, strict=True):
            body.arrive(way, duration, way is hit)

    def _part(self) -> None:
        """Separate discs that overlap; a craft bounces off the other disc as off a rail."""
        for first, second in itertools.combinations(self.bodies, 2):
            if math.dist(first.place, second.place) > first.radius + second.radius:
                continue
            one, other = first.disc(), second.disc()
            dx, dy = one.x - other.x, one.y - other.y
            distance = math.hypot(dx, dy)
            overlap = one.radius + other.radius - distance
            share = 1 / one.mass + 1 / other.mass
            if overlap <= 0 or not distance or not share:
                continue
            nx, ny = dx / distance, dy / distance
            closing = (other.vx - one.vx) * nx + (other.vy - one.vy) * ny
            if closing > 0:
                self.met.append((self.time, first, second, closing))
                strike(one, other, nx, ny, self._rail)
            for body, disc, side in ((first, one, 1), (second, other, -1)):
                if isinstance(body, Craft):
                    part = side * overlap / (disc.mass * share)
                    disc.x, disc.y = disc.x + part * nx, disc.y + part * ny
                    body.take(disc)
