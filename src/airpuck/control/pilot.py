"""Pilots: objects that compute the commands of a flight."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from airpuck.control.law import Step
from airpuck.control.reference import Reference, SetPoint
from airpuck.data.measurement import Measurement, MeasurementKind


@runtime_checkable
class Pilot(Protocol):
    """Computes commands: a `TrackingController`, or a user's class.

    A class that inherits from it only needs `step`. Override `pose` to receive the poses of the
    craft, or `measured` to receive all measurements.

    Examples
    --------
    >>> class Off(airpuck.Pilot):
    ...     def step(self, time):
    ...         return airpuck.Step(np.zeros(6))
    ...
    >>> log = airpuck.fly(Off(), airpuck.Twin(model), duration=0.05)
    >>> log.command.shape
    (5, 6)
    """

    #: The reference that the craft tracks; by default the middle of the table.
    reference: Reference = SetPoint(0.0, 0.0, 0.0)
    #: Other bodies that it sees by motion capture: the ``puck``, the other side's ``mallet``.
    watches: tuple[MeasurementKind, ...] = ()

    def measured(self, measurement: Measurement) -> None:
        """Receive a measurement; by default, pass the craft's poses to `pose`.

        Parameters
        ----------
        measurement : Measurement
            Poses of the craft and of the bodies that the pilot `watches`; readings of on-board
            sensors if the flight uses them.
        """
        if measurement.kind == "pose":
            self.pose(measurement.stamp, measurement.values)

    def pose(self, time: float, pose: Float[np.ndarray, " 3"]) -> None:
        """Receive a pose of the craft.

        Parameters
        ----------
        time : float
            Time stamp of the pose [s].
        pose : array, shape (3,)
            x, y [m], yaw [rad].
        """

    def step(self, time: float) -> Step:
        """Compute the command to send now.

        Parameters
        ----------
        time : float
            Current time, on the clock of the poses [s].

        Returns
        -------
        Step
            The command; ``Step(command)`` is enough.
        """
        ...

    def sent(self, time: float, command: Float[np.ndarray, " n"]) -> None:
        """Receive the command that was actually sent.

        Parameters
        ----------
        time : float
            When [s].
        command : array, shape (n,)
            Motor commands.
        """
