"""Short flights with noisy states, rates included."""

from dataclasses import replace

import numpy as np

from airpuck.model.model_file import published_model

from .synthetic_flights import fly

TRUTH = replace(published_model("M3"), frame="body")


def noisy(seed=0, duration=14.0, noise=0.002):
    flight = fly(TRUTH, duration, seed)
    rng = np.random.default_rng(seed + 100)
    return replace(flight, state=flight.state + noise * rng.normal(size=flight.state.shape))
