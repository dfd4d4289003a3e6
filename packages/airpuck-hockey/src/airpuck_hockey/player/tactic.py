"""Inputs and outputs of a tactic: the interface between estimation and control.

A player works in its own frame: its goal is at x = -length / 2, its half is x < 0.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Literal, Protocol, get_args, runtime_checkable

import numpy as np
from jaxtyping import Float

from airpuck import AirHockey, InputError, PuckState
from airpuck.extend import (
    MinimalTimes,
    Preview,
    Reference,
    Target,
    asked,
    numbers,
    numbers_of,
    preview,
    unknown,
)
from airpuck_hockey.player.rival import Rival
from airpuck_hockey.puck.prediction import PuckBelief, PuckModel

#: Signs of x, y, yaw and their rates under a rotation by π.
_SIGNS = np.array([-1.0, -1.0, 1.0, -1.0, -1.0, 1.0])


@dataclass(frozen=True)
class Frame:
    """Conversion between the world's frame and a side's; the same in both directions.

    The left side uses the world's frame. The right side's frame is rotated by π about the centre
    of the table.
    """

    #: Sign of the x of the side's half, -1 or 1.
    side: int

    def point(self, x: float, y: float) -> tuple[float, float]:
        """Convert one point."""
        return -self.side * x, -self.side * y

    def points(self, points: Float[np.ndarray, "*n 2"]) -> Float[np.ndarray, "*n 2"]:
        """Convert points."""
        return points * float(-self.side)

    def states(self, values: Float[np.ndarray, "*n k"]) -> Float[np.ndarray, "*n k"]:
        """Convert poses, or poses with their rates."""
        if self.side < 0:
            return values.copy()
        found = values * _SIGNS[: values.shape[-1]]
        found[..., 2] += math.pi
        return found

    def puck(self, puck: PuckState | None) -> PuckState | None:
        """Convert the state of a puck."""
        return puck and PuckState(*self.states(np.array(puck)).tolist())

    def box(self, corners: Float[np.ndarray, "2 2"]) -> Float[np.ndarray, "2 2"]:
        """Convert the lowest and the highest corner of a box."""
        return corners if self.side < 0 else -corners[::-1]

    def reference(self, reference: Reference) -> Reference:
        """Convert a reference."""
        return reference if self.side < 0 else TurnedReference(reference, self)


class TurnedReference:
    """A reference in the frame of a side, converted to the world's; a `Reference`."""

    def __init__(self, reference: Reference, frame: Frame) -> None:
        self._own, self._frame = reference, frame

    def at(self, now: float, ahead: float) -> Target:
        """Return the target; see `Reference.at`."""
        target = self._own.at(now, ahead)
        return Target(self._frame.states(target.state), target.acceleration * _SIGNS[:3])

    def asked(self, now: float) -> Float[np.ndarray, " 6"]:
        """Return the state requested for now; see `airpuck.control.reference.asked`."""
        return self._frame.states(asked(self._own, now))

    def over(self, now: float, ahead: Float[np.ndarray, " N"]) -> Preview:
        """Return the targets at several times; see `airpuck.control.reference.preview`."""
        own = preview(self._own, now, ahead)
        return Preview(self._frame.states(own.states), own.accelerations * _SIGNS[:3], own.arrival)


#: Kinds of actions of a craft.
ActionKind = Literal["defend", "clear", "strike", "bank", "prepare", "home", "free", "wait"]
_KINDS = get_args(ActionKind)
_CHANCE = numbers.Range(0, 1, "it is a probability")


@dataclass(frozen=True, eq=False)
class Pitch:
    """Constants of a game.

    Attributes
    ----------
    equipment : AirHockey
        Table and puck.
    craft_radius, craft_mass, craft_inertia : float
        Properties of the craft's disc [m, kg, kg m²].
    opponent_radius : float
        Radius of the opponent's disc [m].
    fence : array, shape (2, 2)
        Where the craft's centre may be: lowest x and y, highest x and y [m].
    home : tuple of float
        Waiting position: x, y [m].
    delay : float
        Delay from a decision until the propellers begin to act on it [s].
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
        """Distance between the centres of craft and puck when they touch [m]."""
        return self.craft_radius + self.equipment.puck.radius_m

    @property
    def goal_line(self) -> float:
        """Position x of the opponent's goal [m]; the craft's own goal is at the negative of it."""
        return self.equipment.table.length_m / 2

    @cached_property
    def recoil(self) -> float:
        """Change of the craft's speed at a contact, as a fraction of the closing speed."""
        puck = self.equipment.puck
        return (1 + puck.craft.restitution) * puck.mass_kg / (puck.mass_kg + self.craft_mass)

    def inside(self, places: Float[np.ndarray, "*n 2"]) -> Any:
        """Return whether the craft's centre may be at given places."""
        (left, bottom), (right, top) = self.fence.tolist()
        x, y = places[..., 0], places[..., 1]
        return (x >= left) & (x <= right) & (y >= bottom) & (y <= top)

    def clipped(self, place: Float[np.ndarray, "*n 2"]) -> Float[np.ndarray, "*n 2"]:
        """Return the nearest allowed places of the craft's centre."""
        return np.clip(place, self.fence[0], self.fence[1])


@dataclass(frozen=True, eq=False)
class View:
    """A tactic's view of the game, in its own frame.

    Attributes
    ----------
    time : float
        Now [s].
    craft : array, shape (6,)
        Estimate of the craft's x, y, yaw and their rates.
    puck : PuckBelief or None
        State of the puck at its last pose; None if it is not seen (in a goal, hidden, lost).
    puck_model : PuckModel
        For `predict_puck` and `predict_crossing`.
    opponent : array, shape (4,), or None
        x, y, vx, vy of the opponent's disc, if it is seen.
    pitch : Pitch
        Table, dimensions, fence, home.
    times : MinimalTimes
        The craft's shortest times from one state to another.
    rival : Rival
        Current estimate of the opponent.

    Examples
    --------
    >>> class Watcher:
    ...     def decide(self, view: airpuck_hockey.View):
    ...         x, y, yaw = view.pitch.home  # in the craft's own frame
    ...         return airpuck_hockey.Intention("defend", airpuck.SetPoint(x, y, yaw))
    ...
    """

    time: float
    craft: Float[np.ndarray, " 6"]
    puck: PuckBelief | None
    puck_model: PuckModel
    opponent: Float[np.ndarray, " 4"] | None
    pitch: Pitch
    times: MinimalTimes
    rival: Rival = field(default_factory=Rival)


@dataclass(frozen=True, eq=False)
class Intention:
    """The output of a tactic.

    Attributes
    ----------
    kind : str
        ``defend``, ``clear``, ``strike``, ``bank``, ``prepare``, ``home``, ``free`` or ``wait``.
    reference : Reference
        Reference of the craft: a `Rendezvous` to touch the puck, a `SetPoint` otherwise.
    meet : tuple of float, optional
        Intended time of contact with the puck [s], and x, y of the puck's centre then [m].
    path : array, shape (N, 2), optional
        Expected path of the puck after that [m].
    chance : float, optional
        Probability of scoring.
    avoid : tuple of float, optional
        A disc that the craft's centre must avoid, such as one around the puck: x, y, radius [m].

    Raises
    ------
    InputError
        If the kind is unknown, or a value is not as described.

    Examples
    --------
    >>> intention = airpuck_hockey.Intention("defend", airpuck.SetPoint(-0.9, 0.0, 0.0))
    >>> intention.kind
    'defend'
    """

    kind: ActionKind
    reference: Reference
    meet: tuple[float, float, float] | None = None
    path: Float[np.ndarray, "N 2"] | None = None
    chance: float | None = None
    avoid: tuple[float, float, float] | None = None

    def __post_init__(self) -> None:
        if self.kind not in _KINDS:
            raise InputError(unknown(self.kind, _KINDS), field="kind")
        # Faster than isinstance, which looks up all members of a protocol.
        if not callable(getattr(self.reference, "at", None)):
            problem = (
                f"must be a reference, such as a SetPoint, not {type(self.reference).__name__}"
            )
            raise InputError(problem, field="reference")
        for name, disc in (("meet", self.meet), ("avoid", self.avoid)):
            if disc is not None:
                numbers_of(disc, (3,), name)
        if self.avoid is not None and self.avoid[2] <= 0:
            raise InputError("must have a radius above 0", field="avoid")
        if self.path is not None:
            numbers_of(self.path, (None, 2), "path")
        if self.chance is not None:
            _CHANCE.check(self.chance, "chance")


@runtime_checkable
class Tactic(Protocol):
    """Decides what the craft does; it may keep a memory.

    Every game begins with a new object.

    Examples
    --------
    >>> class Goalie(airpuck_hockey.Tactic):
    ...     def decide(self, view):
    ...         return airpuck_hockey.Intention("defend", airpuck.SetPoint(-0.9, 0.0, 0.0))
    ...
    >>> player = airpuck_hockey.Player(model, airpuck.AirHockey(), Goalie())
    """

    def decide(self, view: View) -> Intention:
        """Return the intention; called once per control period.

        Parameters
        ----------
        view : View
            The present view of the game.

        Returns
        -------
        Intention
            The intention.
        """
        ...
