"""Inputs and outputs of a tactic: the interface between estimation and control.

A player thinks in its own frame: its goal is at x = -length / 2, its half is x < 0.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from airpuck.control.reference import Reference
from airpuck.craft.table import AirHockey
from airpuck.hockey.minimal_time import MinimalTimes
from airpuck.hockey.prediction import PuckBelief, PuckModel

#: What a craft can be about to do.
Kind = Literal["defend", "clear", "strike", "bank", "prepare", "home", "free", "wait"]


@dataclass(frozen=True, eq=False)
class Pitch:
    """What does not change during a game.

    Attributes
    ----------
    equipment : AirHockey
        Table and puck.
    craft_radius, craft_mass, craft_inertia : float
        The own disc [m, kg, kg m²].
    opponent_radius : float
        The other's disc [m].
    fence : array, shape (2, 2)
        Where the craft's centre may be: lowest x and y, highest x and y [m].
    home : tuple of float
        Where it waits: x, y [m].
    delay : float
        From a decision until the propellers begin to act on it [s].
    acceleration : float
        Mean acceleration of the craft over a short distance [m/s²].
    """

    equipment: AirHockey
    craft_radius: float
    craft_mass: float
    craft_inertia: float
    opponent_radius: float
    fence: Float[np.ndarray, "2 2"]
    home: tuple[float, float]
    delay: float
    acceleration: float

    @cached_property
    def contact_distance(self) -> float:
        """Distance of the middles of craft and puck when they touch [m]."""
        return self.craft_radius + self.equipment.puck.radius_m

    @property
    def goal_line(self) -> float:
        """Where the other's goal is along x [m]; the own one is at the negative of that."""
        return self.equipment.table.length_m / 2

    @cached_property
    def recoil(self) -> float:
        """What the craft's speed changes by at a contact, as a share of the closing speed."""
        puck = self.equipment.puck
        return (1 + puck.craft.restitution) * puck.mass_kg / (puck.mass_kg + self.craft_mass)

    def inside(self, places: Float[np.ndarray, "*n 2"]) -> Any:
        """Return whether the craft's middle may be at places."""
        (left, bottom), (right, top) = self.fence.tolist()
        x, y = places[..., 0], places[..., 1]
        return (x >= left) & (x <= right) & (y >= bottom) & (y <= top)

    def clipped(self, place: Float[np.ndarray, "*n 2"]) -> Float[np.ndarray, "*n 2"]:
        """Return the places nearest to some where the craft's middle may be."""
        return np.clip(place, self.fence[0], self.fence[1])


@dataclass(frozen=True, eq=False)
class View:
    """What a tactic sees, in its own frame.

    Attributes
    ----------
    time : float
        Now [s].
    craft : array, shape (6,)
        Estimate of the own x, y, yaw and their rates.
    puck : PuckBelief or None
        As of its last pose; None: not seen (in a goal, hidden, lost).
    puck_model : PuckModel
        For `predict_puck` and `predict_crossing`.
    opponent : array, shape (4,), or None
        x, y, vx, vy of the other's disc, where it is seen.
    pitch : Pitch
        Table, sizes, fence, home.
    times : MinimalTimes
        The craft's shortest times from one state to another.
    """

    time: float
    craft: Float[np.ndarray, " 6"]
    puck: PuckBelief | None
    puck_model: PuckModel
    opponent: Float[np.ndarray, " 4"] | None
    pitch: Pitch
    times: MinimalTimes


@dataclass(frozen=True, eq=False)
class Intention:
    """The output of a tactic.

    Attributes
    ----------
    kind : str
        ``defend``, ``clear``, ``strike``, ``bank``, ``prepare``, ``home``, ``free`` or ``wait``.
    reference : Reference
        What the craft is to track: a `Rendezvous` to touch the puck, a `SetPoint` otherwise.
    meet : tuple of float, optional
        When it means to touch the puck [s], and x, y of the puck's middle then [m].
    path : array, shape (N, 2), optional
        Where it expects the puck to go after that [m].
    chance : float, optional
        Probability of scoring.
    avoid : tuple of float, optional
        A disc that the craft's middle keeps out of, such as one around the puck: x, y, radius [m].
    """

    kind: Kind
    reference: Reference
    meet: tuple[float, float, float] | None = None
    path: Float[np.ndarray, "N 2"] | None = None
    chance: float | None = None
    avoid: tuple[float, float, float] | None = None


@runtime_checkable
class Tactic(Protocol):
    """Decides what the craft does; it may keep a memory.

    Every game begins with a new object.
    """

    def decide(self, view: View) -> Intention:
        """Return what to do now; called once a control period.

        Parameters
        ----------
        view : View
            What is seen.

        Returns
        -------
        Intention
            The intention.
        """
        ...
