"""What computes the commands of a flight."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from airpuck.control.law import Step
from airpuck.control.reference import Reference, SetPoint
from airpuck.data.measurement import Kind, Measurement


@runtime_checkable
class Pilot(Protocol):
    """Computes commands: a `TrackingController`, or a class of one's own.

    A class that inherits from it need only have `step`. One that overrides `pose` gets the poses of
    the craft, one that overrides `measured` gets all measurements.
    """

    #: The reference that the craft tracks; by default the middle of the table.
    reference: Reference = SetPoint(0.0, 0.0, 0.0)
    #: What else it sees by motion capture: the ``puck``, the other side's ``mallet``.
    watches: tuple[Kind, ...] = ()

    def measured(self, measurement: Measurement) -> None:
        """Take note of a measurement; by default, hand the craft's poses to `pose`.

        Parameters
        ----------
        measurement : Measurement
            Poses of the craft and of what the pilot `watches`; those of sensors on board if the
            flight uses them.
        """
        if measurement.kind == "pose":
            self.pose(measurement.stamp, measurement.values)

    def pose(self, time: float, pose: Float[np.ndarray, " 3"]) -> None:
        """Take note of a pose of the craft.

        Parameters
        ----------
        time : float
            Its stamp [s].
        pose : array, shape (3,)
            x, y [m], yaw [rad].
        """

    def step(self, time: float) -> Step:
        """Compute the command to send now.

        Parameters
        ----------
        time : float
            Now, on the clock of the poses [s].

        Returns
        -------
        Step
            The command; ``Step(command)`` will do.
        """
        ...

    def sent(self, time: float, command: Float[np.ndarray, " n"]) -> None:
        """Take note of the command that was really sent.

        Parameters
        ----------
        time : float
            When [s].
        command : array, shape (n,)
            Motor commands.
        """
