"""A measurement from a sensor, as links deliver it and pilots receive it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float

from airpuck.boundary.errors import InputError, unknown

#: The sensors: motion capture of the craft, the puck and the other side's disc; the on-board
#: inertial unit and optical mouse sensor.
MeasurementKind = Literal["pose", "imu", "mouse", "puck", "mallet"]
#: Length of their values.
_SIZES: dict[MeasurementKind, int] = {"pose": 3, "imu": 6, "mouse": 2, "puck": 3, "mallet": 3}


@dataclass(frozen=True, eq=False)
class Measurement:
    """A measurement of a sensor.

    Attributes
    ----------
    kind : str
        Which sensor: ``pose``, ``imu``, ``mouse``, ``puck``, ``mallet``.
    stamp : float
        Time of the measurement, on the sensor's clock [s].
    values : array, shape (k,)
        Pose (also of the puck and the mallet): x, y [m], yaw [rad]. IMU: acceleration along the
        body's x, y, z [m/s²], angular velocity about them [rad/s]. Mouse: velocity along the body's
        x, y [m/s].

    Raises
    ------
    InputError
        If the kind is unknown, or the values are too few or too many. They need not be finite.

    Examples
    --------
    >>> pose = airpuck.Measurement("pose", 0.25, np.array([0.1, -0.2, 1.0]))
    >>> pose.stamp
    0.25
    """

    kind: MeasurementKind
    stamp: float
    values: Float[np.ndarray, " k"]

    def __post_init__(self) -> None:
        # Numbers that are not finite pass: a pilot in flight has to bear them.
        if self.kind not in _SIZES:
            raise InputError(unknown(self.kind, _SIZES), field="kind")
        if len(self.values) != _SIZES[self.kind]:
            problem = f"must be {_SIZES[self.kind]} numbers for {self.kind}"
            raise InputError(problem, field="values")
