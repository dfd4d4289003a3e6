"""Limits of a craft's motion that may change in flight: a fence, discs, half planes."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, fields

from airpuck.boundary import numbers
from airpuck.boundary.errors import InputError


@dataclass(frozen=True)
class _Limit:
    """A limit of the position of the craft's centre.

    A hard limit is never exceeded by a plan: if it cannot be kept, there is no plan. A soft one is
    exceeded by as little as possible.
    """

    def __post_init__(self) -> None:
        for field in fields(self):
            numbers.COORDINATE.check(getattr(self, field.name), field.name)


@dataclass(frozen=True)
class Fence(_Limit):
    """A rectangle that the craft's centre must not leave; the craft can stop before its edge.

    Parameters
    ----------
    low_x, low_y, high_x, high_y : float
        Lowest and highest coordinates of the craft's centre [m].
    hard : bool, default False
        Whether plans never exceed the limit; otherwise they may, by as little as possible.

    Raises
    ------
    InputError
        If a number is out of range, or the rectangle is empty.

    Examples
    --------
    >>> airpuck.Fence(-0.9, -0.4, 0.9, 0.4).high_x
    0.9
    """

    low_x: float
    low_y: float
    high_x: float
    high_y: float
    hard: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        if not (self.low_x < self.high_x and self.low_y < self.high_y):
            raise InputError("must be lowest x and y, then highest x and y [m]", field="Fence")


@dataclass(frozen=True)
class KeepOut(_Limit):
    """A disc to keep out of.

    Parameters
    ----------
    x, y : float
        Its centre [m].
    radius : float
        Smallest distance of the craft's centre from it [m].
    hard : bool, default False
        As for `Fence`.

    Raises
    ------
    InputError
        If a number is out of range.

    Examples
    --------
    >>> airpuck.KeepOut(0.2, 0.0, radius=0.15).hard
    False
    """

    x: float
    y: float
    radius: float
    hard: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        numbers.DISTANCE.check(self.radius, "radius")

    @property
    def row(self) -> tuple[float, float, float, float, float]:
        """A point, a direction away from it (zero: from wherever the craft is), and a distance."""
        return self.x, self.y, 0.0, 0.0, self.radius


@dataclass(frozen=True)
class HalfPlane(_Limit):
    """The side of a straight line on which the craft's centre must be.

    Parameters
    ----------
    x, y : float
        A point of the line [m].
    direction : float
        Direction from the line to the allowed side, from the x axis [rad].
    hard : bool, default False
        As for `Fence`.

    Raises
    ------
    InputError
        If a number is out of range.

    Examples
    --------
    >>> airpuck.HalfPlane(0.2, 0.0, direction=np.pi).row[2]
    -1.0
    """

    x: float
    y: float
    direction: float
    hard: bool = False

    @property
    def row(self) -> tuple[float, float, float, float, float]:
        """As `KeepOut.row`."""
        return self.x, self.y, math.cos(self.direction), math.sin(self.direction), 0.0


#: A limit that a law is given at every moment.
Limit = Fence | KeepOut | HalfPlane


def checked_limits(given: Iterable[Limit]) -> tuple[Limit, ...]:
    """Return limits as a tuple; raise InputError for anything else, or for fences far apart."""
    several = isinstance(given, Iterable)
    limits = tuple(given) if several else ()
    if not (several and all(isinstance(one, Limit) for one in limits)):
        raise InputError("must be a list of Fence, KeepOut and HalfPlane objects", field="limits")
    fences = [one for one in limits if isinstance(one, Fence)]
    for low, high in (("low_x", "high_x"), ("low_y", "high_y")):
        ends = [getattr(one, high) for one in fences]
        if any(getattr(one, low) > min(ends) for one in fences):
            raise InputError("must leave a place that is within all fences", field="limits")
    return limits
