"""The air-hockey table: rails, goals, puck, mallet, and the frame of the motion capture on it."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import Annotated

import pydantic

from airpuck.boundary.files import Fraction, NonNegative, Positive, Section, read_toml, write_toml

#: Largest size of a table or hall; a longer one is in millimetres [m].
SideLength = Annotated[float, pydantic.Field(gt=0, le=1000)]


class Table(Section):
    """A rectangular table, centred at the origin of the world frame, x along its length.

    Attributes
    ----------
    length_m, width_m : float
        Distance between opposite rails along x and along y.
    restitution : float
        Fraction of the craft's normal speed that a rail returns; 1: elastic.
    friction : float
        Coulomb coefficient of friction between the craft and the rails.
    goal_width_m : float
        Width of the openings in the middle of both short rails, at most the table's width. Only the
        puck fits through.

    Examples
    --------
    >>> airpuck.Table(length_m=2.5).reach(radius=0.05)  # of a craft's centre, along x and y [m]
    (1.2, 0.5)
    """

    length_m: SideLength = 2.2
    width_m: SideLength = 1.1
    restitution: Fraction = 0.7
    friction: NonNegative = 0.1
    goal_width_m: Positive = 0.40

    def reach(self, radius: float) -> tuple[float, float]:
        """Return how far from the centre of the table the centre of a disc can get.

        Parameters
        ----------
        radius : float
            Radius of the disc [m].

        Returns
        -------
        x, y : float
            Half the free length and width [m].
        """
        return self.length_m / 2 - radius, self.width_m / 2 - radius


class Contact(Section):
    """How a puck bounces off another object.

    With the default grip, a homogeneous puck without spin keeps 0.84 of its speed along a rail.
    """

    #: Fraction of the normal speed that is returned; 1: elastic.
    restitution: Fraction
    #: Fraction of the slip that is removed if the cone of friction allows it; 1: no slip remains,
    #: 0: smooth.
    grip: Fraction = 0.48
    #: Coulomb coefficient of friction.
    friction: NonNegative = 0.3


class Puck(Section):
    """The puck: size, drag on the air cushion, and bounces off rails, mallet and craft.

    The defaults are assumptions for any table. Published identifications of the Robot Air Hockey
    Challenge's puck give 31.65 mm, 10 g and a drag of 0.2 1/s. At a rail it keeps 0.79 of its
    normal speed and 0.84 of its speed along the rail; at a mallet it keeps 0.80. Friction is a
    guess. Numbers without a standard error were not identified on this table (`assumed`).

    Attributes
    ----------
    radius_m, mass_kg : float
        Radius and mass of the disc.
    inertia_kg_m2 : float, optional
        About the vertical axis through the centre; the default is a homogeneous disc.
    drag_1_s : float
        Deceleration per unit of speed.
    spin_drag_1_s : float
        The same for the rotation; a viscous film under a homogeneous disc slows both alike.
    rail, mallet, craft : Contact
        Bounces; goal posts behave like rails.
    standard_error : mapping of str to float
        Standard errors of the identified numbers, by name: ``drag_1_s``, ``rail.restitution``.
    """

    radius_m: Positive = 0.03165
    mass_kg: Positive = 0.010
    inertia_kg_m2: Positive | None = None
    drag_1_s: NonNegative = 0.2
    spin_drag_1_s: NonNegative = 0.2
    rail: Contact = Contact(restitution=0.79)
    mallet: Contact = Contact(restitution=0.80)
    craft: Contact = Contact(restitution=0.80)
    standard_error: Mapping[str, NonNegative] = {}

    @pydantic.model_validator(mode="after")
    def _errors_of_numbers(self) -> Puck:
        for name in self.standard_error:
            if name not in self._numbers():
                raise ValueError(
                    f"standard_error.{name} does not name a puck parameter; use one of "
                    + ", ".join(self._numbers())
                )
        return self

    @property
    def inertia(self) -> float:
        """Moment of inertia about the vertical axis through the centre [kg m²]."""
        return self.inertia_kg_m2 or self.mass_kg * self.radius_m**2 / 2

    @property
    def kept_along_rail(self) -> float:
        """Fraction of its speed along a rail that a puck without spin keeps where it grips."""
        return 1 - self.rail.grip / (1 + self.mass_kg * self.radius_m**2 / self.inertia)

    @property
    def assumed(self) -> tuple[str, ...]:
        """Names of the numbers that were not identified on this table."""
        return tuple(name for name in self._numbers() if name not in self.standard_error)

    @classmethod
    def _numbers(cls) -> list[str]:
        """Return the names of all numbers."""
        names = []
        for name, field in cls.model_fields.items():
            if field.annotation is Contact:
                names += [f"{name}.{key}" for key in Contact.model_fields]
            elif name != "standard_error":
                names.append(name)
        return names


class Mallet(Section):
    """The human's mallet: a disc moved by a hand; collisions do not move it."""

    #: Radius of the disc.
    radius_m: Positive = 0.04815
    #: Largest speed of a hand.
    speed_m_s: Positive = 4.0
    #: Largest acceleration of a hand.
    acceleration_m_s2: Positive = 40.0


class AirHockey(Section):
    """A table to play on: the contents of a table file.

    Settings of a twin have the same sections, so a table file also works for ``--twin``.

    Attributes
    ----------
    table : Table
        Rails and goals.
    puck : Puck
        The puck.
    mallet : Mallet
        The human's mallet.

    Examples
    --------
    >>> play = airpuck.AirHockey()
    >>> play.table.length_m, play.puck.radius_m
    (2.2, 0.03165)
    """

    table: Table = Table()
    puck: Puck = Puck()
    mallet: Mallet = Mallet()

    @pydantic.model_validator(mode="after")
    def _puck_fits(self) -> AirHockey:
        check_play(self.table, self.puck, self.mallet)
        return self

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the table file as TOML.

        Parameters
        ----------
        path : path-like
            The file to write.
        """
        assumed = ", ".join(self.puck.assumed)
        header = f"An air-hockey table.\nAssumed, not identified on this table: puck {assumed}."
        write_toml(path, self.model_dump(mode="json", exclude_none=True), header=header)


def check_play(table: Table, puck: Puck, mallet: Mallet) -> None:
    """Raise ValueError if dimensions are inconsistent."""
    if 2 * puck.radius_m >= min(table.goal_width_m, table.width_m):
        raise ValueError(
            f"puck.radius_m = {puck.radius_m:g} does not fit through a goal of "
            f"table.goal_width_m = {table.goal_width_m:g}"
        )
    if 2 * (puck.radius_m + mallet.radius_m) >= min(table.length_m, table.width_m):
        raise ValueError(
            f"mallet.radius_m = {mallet.radius_m:g} leaves a puck no room on the table"
        )


def read_table(path: str | os.PathLike[str]) -> AirHockey:
    """Read a table file.

    Parameters
    ----------
    path : path-like
        A TOML file with any of the tables ``[table]``, ``[puck]``, ``[mallet]``; omitted fields
        keep their defaults.

    Returns
    -------
    AirHockey
        The table.

    Raises
    ------
    InputError
        If the file cannot be read or a field is wrong.

    Examples
    --------
    >>> from pathlib import Path
    >>> _ = Path("table.toml").write_text("puck.mass_kg = 0.012")
    >>> airpuck.read_table("table.toml").puck.mass_kg
    0.012
    """
    return read_toml(path, AirHockey, base=AirHockey())
