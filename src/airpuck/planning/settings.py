"""The limits of a plan."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

from airpuck.boundary import numbers
from airpuck.boundary.settings import Setting, Settings


@dataclass(frozen=True)
class Limits(Settings):
    """What a plan may use.

    Attributes
    ----------
    reserve : float, default 0
        Share of every motor's thrust that is kept for feedback, below 1.
    spin : float, default 15
        Largest spin [rad/s].
    speed : float, default 3
        Largest velocity along x and along y [m/s].
    margin : float, default 0
        Distance that the craft keeps from the rails and from discs [m].
    smoothing : float, default 0
        Weight κ of ∫ |u'|² dt, the squared rates of the commands until the motors idle, which is
        added to the time that is minimised [s²]. A packet that comes late does less harm to a
        gentle switch. For flights, 2e-4.

    Raises
    ------
    InputError
        If a value is out of range.
    """

    HEADING: ClassVar = "Limits of the plan"

    reserve: Annotated[
        float, Setting("Share of thrust kept for feedback.", numbers.RESERVE, "R")
    ] = 0.0
    spin: Annotated[float, Setting("Largest spin.", numbers.SPIN_LIMIT, "W")] = 15.0
    speed: Annotated[
        float, Setting("Largest speed along x and along y.", numbers.SPEED_LIMIT, "V")
    ] = 3.0
    margin: Annotated[
        float, Setting("Distance to keep from rails and discs.", numbers.CLEARANCE, "M")
    ] = 0.0
    smoothing: Annotated[
        float,
        Setting("Weight of the commands' squared rates; 2e-4 for flights.", numbers.SMOOTHING, "S"),
    ] = 0.0
