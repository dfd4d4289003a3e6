"""A made-up flight with the noise of the motion capture."""

from dataclasses import replace

import numpy as np

from airpuck.data.trajectory import Trajectory
from airpuck.model.model_file import Model, published_model

from .synthetic_flights import fly

#: Standard deviations of x, y [m] and yaw [rad].
POSE_NOISE = (4.5e-5, 4.5e-5, 6.5e-4)
#: The published M3 with its centre of mass fixed to the body.
TRUTH = replace(published_model("M3"), frame="body", indexing="start")


def noisy(model: Model = TRUTH, duration: float = 4.0, seed: int = 0) -> Trajectory:
    """A random flight with white noise on the poses; rates and accelerations stay exact.

    Without its first 0.3 s, in which motors start from rest whatever the commands.
    """
    flight = fly(model, duration + 0.3, seed)
    flight = flight.slice(0.3 / (duration + 0.3), 1)
    noise = np.random.default_rng([seed, 7]).normal(size=(len(flight), 3)) * POSE_NOISE
    state = flight.state.copy()
    state[:, :3] += noise
    return replace(flight, state=state)
