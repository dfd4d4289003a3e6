"""One measurement of a sensor: what links give and pilots take."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float

#: The sensors: poses of the craft, of the puck and of the other side's disc by motion capture; the
#: inertial unit and the optical mouse sensor on board.
Kind = Literal["pose", "imu", "mouse", "puck", "mallet"]


@dataclass(frozen=True, eq=False)
class Measurement:
    """A measurement of a sensor.

    Attributes
    ----------
    kind : str
        Which sensor: ``pose``, ``imu``, ``mouse``, ``puck``, ``mallet``.
    stamp : float
        When it was measured, on the sensor's clock [s].
    values : array, shape (k,)
        Pose, of the puck and the mallet, too: x, y [m], yaw [rad]. IMU: acceleration along the
        body's x, y, z [m/s²], spin about them [rad/s]. Mouse: velocity along the body's x, y [m/s].
    """

    kind: Kind
    stamp: float
    values: Float[np.ndarray, " k"]
