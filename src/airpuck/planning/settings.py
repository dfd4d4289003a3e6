"""The limits of a plan."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

from airpuck.boundary import numbers
from airpuck.boundary.settings import Setting, Settings


@dataclass(frozen=True)
class Limits(Settings):
    """Limits that a plan respects.

    Attributes
    ----------
    reserve : float, default 0
        Fraction of every motor's thrust that is reserved for feedback, below 1.
    spin : float, default 15
        Largest spin [rad/s].
    speed : float, default 3
        Largest velocity along x and along y [m/s].
    margin : float, default 0
        Distance that the craft keeps from the rails and from discs [m].
    smoothing : float, default 0
        Weight κ of ∫ u'² dt, the squared rates of the commands until the motors idle. This term
        is added to the minimised time [s²]. A late packet does less harm if commands change
        gradually. For flights use 2e-4.

    Raises
    ------
    InputError
        If a value is out of range.

    Examples
    --------
    >>> limits = airpuck.Limits(reserve=0.1, speed=1.0)  # a tenth of the thrust for feedback
    >>> limits.spin
    15.0
    """

    HEADING: ClassVar = "Limits of the plan"

    reserve: Annotated[
        float, Setting("Fraction of thrust reserved for feedback.", numbers.RESERVE, "R")
    ] = 0.0
    spin: Annotated[float, Setting("Largest spin.", numbers.SPIN_LIMIT, "W")] = 15.0
    speed: Annotated[float, Setting("Largest speed along x and y.", numbers.SPEED_LIMIT, "V")] = 3.0
    margin: Annotated[
        float, Setting("Distance to keep from rails and discs.", numbers.CLEARANCE, "M")
    ] = 0.0
    smoothing: Annotated[
        float,
        Setting("Weight of the commands' squared rates; 2e-4 for flights.", numbers.SMOOTHING, "S"),
    ] = 0.0
