"""Craft, puck and the human's mallet on one table."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from jaxtyping import Float

from airpuck.craft.table import AirHockey, Contact, Mallet, Table
from airpuck.physics.puck import Disc, PuckState, strike
from airpuck.twin.plant import LONGEST_STEP, Plant
from airpuck.twin.puck import Moving, PuckOnTable

#: Longest step while the puck is near the craft [s]: within it, the path of a craft at full thrust
#: is straight to a micrometre.
_SHORT_STEP = 1e-3
#: What near is, beside what both move in a step [m].
_NEAR = 5e-3

State = Float[np.ndarray, " s"]


class HandMallet:
    """The human's mallet: it goes to where the hand wants it, as fast as a hand can.

    Parameters
    ----------
    mallet : Mallet
        Size and limits.
    table : Table
        What it stays on. It keeps to the half in which it starts.
    x, y : float
        Where its middle is at first [m].

    Attributes
    ----------
    target : tuple of float
        Where the hand wants it [m].
    x, y, vx, vy : float
        Where it is [m], and its velocity [m/s].
    """

    def __init__(self, mallet: Mallet, table: Table, x: float, y: float) -> None:
        self.radius = mallet.radius_m
        self._limits = mallet.speed_m_s, mallet.acceleration_m_s2
        self._side = math.copysign(1.0, x)
        self._reach = table.reach(mallet.radius_m)
        self.x, self.y = self.allowed(x, y)
        self.vx = self.vy = 0.0
        self.target = self.x, self.y

    def allowed(self, x: float, y: float) -> tuple[float, float]:
        """Return the nearest place on its half of the table.

        Parameters
        ----------
        x, y : float
            A place [m].

        Returns
        -------
        x, y : float
            Where the mallet's middle may be [m].
        """
        x_reach, y_reach = self._reach
        x = self._side * max(self.radius, min(self._side * x, x_reach))
        return x, max(-y_reach, min(y, y_reach))

    def moving(self, duration: float) -> Moving:
        """Return its way during a step: straight, at a speed from which it can still stop."""
        fastest, hardest = self._limits
        x, y = self.allowed(*self.target)
        dx, dy = x - self.x, y - self.y
        distance = math.hypot(dx, dy)
        # It ends a step at rest at the target, or so that it can stop there.
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

    def arrive(self, way: Moving, duration: float) -> None:
        """Be where its way has led; a wedged puck may have held it back."""
        self.vx, self.vy = (way.x - self.x) / duration, (way.y - self.y) / duration
        self.x, self.y = way.x, way.y


class Play:
    """Craft, puck and mallet as they move together.

    Parameters
    ----------
    play : AirHockey
        Table, puck and mallet; the settings of a twin.
    plant : Plant
        The craft.
    puck : PuckState
        The puck at first.
    mallet : tuple of float, optional
        Where the human's mallet is at first [m]; none by default.
    logs : bool
        Whether to keep all contacts.
    """

    def __init__(
        self,
        play: AirHockey,
        plant: Plant,
        puck: PuckState,
        mallet: tuple[float, float] | None,
        logs: bool,
    ) -> None:
        self._disc, self._dynamics = plant.disc, plant.dynamics
        rail = play.table
        self._rail = Contact(restitution=rail.restitution, grip=1.0, friction=rail.friction)
        self.puck = PuckOnTable(play, puck, logs=logs)
        self.mallet = None if mallet is None else HandMallet(play.mallet, play.table, *mallet)

    def advance(
        self, state: State, end: float, fly: Callable[[State, float], tuple[State, Any]]
    ) -> tuple[State, Any]:
        """Let time pass, at most until `end`; `PuckOnTable.time` says until when.

        `fly` moves the craft without a puck for a duration and says whether it met a rail; returned
        are its state and what `fly` said.
        """
        begin, longest = self.puck.time, self._longest(state)
        if end - begin > longest:
            end = begin + longest
        duration = end - begin
        after, met = fly(state, duration)
        craft = self._craft(state, after, duration)
        hand = None if self.mallet is None else self.mallet.moving(duration)
        hit = self.puck.run(end, (craft,) if hand is None else (craft, hand))
        duration = self.puck.time - begin
        if hit is craft:
            after, met = fly(state, duration) if duration > 0 else (state, False)
            gained = [
                craft.vx - craft.ax * duration,
                craft.vy - craft.ay * duration,
                craft.spin - craft.spinning_up * duration,
            ]
            after = np.concatenate([after[:3], after[3:6] + gained - state[3:6], after[6:]])
        elif (craft.x, craft.y) != (after[0], after[1]):
            after = np.concatenate([[craft.x, craft.y], after[2:]])
        if self.mallet is not None and hand is not None and duration > 0:
            self.mallet.arrive(hand, duration)
            after = self._off_the_mallet(after, hand)
        return after, met

    def pose(self, kind: str) -> Float[np.ndarray, " 3"]:
        """Return the true pose of the puck, NaN where it is in a goal, or of the mallet."""
        if kind == "mallet":
            assert self.mallet is not None
            return np.array([self.mallet.x, self.mallet.y, 0.0])
        return np.full(3, math.nan) if self.puck.goal else np.array(self.puck.state[:3])

    def _longest(self, state: State) -> float:
        """Return how long a step may be: shorter where the craft may soon hit the puck."""
        puck = self.puck.state
        x, y, _, vx, vy = state[:5].tolist()
        apart = math.hypot(puck.x - x, puck.y - y) - self._disc.radius - self.puck.radius
        moves = math.hypot(puck.vx - vx, puck.vy - vy) * LONGEST_STEP
        return LONGEST_STEP if apart > moves + _NEAR else _SHORT_STEP

    def _craft(self, state: State, after: State, duration: float) -> Moving:
        """Return the way of the craft during a step."""
        x, y, yaw, vx, vy, spin = state[:6].tolist()
        to_x, to_y, _, to_vx, to_vy, to_spin = after[:6].tolist()
        rx, ry = map(float, self._dynamics.center_of_mass)
        if self._dynamics.frame == "body":
            cos, sin = math.cos(yaw), math.sin(yaw)
            rx, ry = cos * rx - sin * ry, sin * rx + cos * ry
        return Moving(
            x,
            y,
            vx,
            vy,
            spin,
            self._disc.radius,
            self._disc.mass,
            self._disc.inertia,
            (rx, ry),
            to_x=to_x,
            to_y=to_y,
            ax=(to_vx - vx) / duration,
            ay=(to_vy - vy) / duration,
            spinning_up=(to_spin - spin) / duration,
            kind="craft",
        )

    def _off_the_mallet(self, state: State, mallet: Disc) -> State:
        """Push a craft back that overlaps the mallet; it bounces as off a rail."""
        craft = self._craft(state, state, 1.0)
        dx, dy = craft.x - mallet.x, craft.y - mallet.y
        distance = math.hypot(dx, dy)
        overlap = craft.radius + mallet.radius - distance
        if overlap <= 0 or not distance:
            return state
        nx, ny = dx / distance, dy / distance
        if (craft.vx - mallet.vx) * nx + (craft.vy - mallet.vy) * ny < 0:
            strike(craft, mallet, nx, ny, self._rail)
        moved = [craft.x + overlap * nx, craft.y + overlap * ny, state[2]]
        return np.concatenate([moved, [craft.vx, craft.vy, craft.spin], state[6:]])
