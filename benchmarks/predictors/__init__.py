"""Methods that predict a craft's pose, all on the same data; see `benchmarks.prediction`.

A method is a function of the recording it learns from and the craft, which returns a `Predictor`.
To add your own, write such a function and enter it in `benchmarks.prediction.METHODS`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from airpuck import Trajectory, Vehicle
from airpuck.data.windows import Windows


@dataclass(frozen=True)
class Predictor:
    """What a method has learned.

    Attributes
    ----------
    predict : callable
        Takes windows with W starts. Returns the pose at the end of each, shape (3, W): x, y [m],
        yaw [rad] in the frame of the table. It may use every state up to the present, and the
        commands up to the end.
    parameters : int
        Number of learned numbers.
    """

    predict: Callable[[Windows], np.ndarray]
    parameters: int


Method = Callable[[Trajectory, Vehicle], Predictor]


def to_body(yaw: np.ndarray, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rotate vectors of the table's frame into the craft's."""
    cos, sin = np.cos(yaw), np.sin(yaw)
    return cos * x + sin * y, cos * y - sin * x


def to_table(yaw: np.ndarray, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rotate vectors of the craft's frame into the table's."""
    return to_body(-yaw, x, y)
