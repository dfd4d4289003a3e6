"""What the tests of Gymnasium environments share."""

from typing import Any

import numpy as np

from airpuck.model.model_file import published_model
from airpuck.twin.settings import MotionCapture, OnBoard, default_twin_settings

PERIOD = 0.01
MODEL = published_model("M3")
SETTINGS = default_twin_settings()
#: The radio's delays stay random.
NOISELESS = SETTINGS.model_copy(
    update={
        "motion_capture": MotionCapture(
            position_noise_m=0.0, yaw_noise_rad=0.0, latency_jitter_s=0.0
        ),
        "on_board": OnBoard(rate_hz=0.0),
    }
)


def actions(count: int, seed: int = 0, size: int = 6) -> np.ndarray:
    """Draw commands."""
    return np.random.default_rng(seed).random((count, size))


def flown(env: Any, commands: Any, **reset: Any) -> list[Any]:
    """Return the results of a reset and of steps."""
    return [env.reset(**reset), *(env.step(command) for command in commands)]
