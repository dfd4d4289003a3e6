"""A measurement from a sensor, as links deliver it and pilots receive it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float

#: The sensors: motion capture of the craft, the puck and the other side's disc; the on-board
#: inertial unit and optical mouse sensor.
Kind = Literal["pose", "imu", "mouse", "puck", "mallet"]


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

    Examples
    --------
    >>> pose = airpuck.Measurement("pose", 0.25, np.array([0.1, -0.2, 1.0]))
    >>> pose.stamp
    0.25
    """

    kind: Kind
    stamp: float
    values: Float[np.ndarray, " k"]
