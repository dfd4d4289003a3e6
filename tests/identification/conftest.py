"""Flights and fits that several files of this folder share."""

from dataclasses import replace

import numpy as np
import pytest

from airpuck.data.trajectory import Trajectory
from airpuck.identification.fit import identify
from airpuck.identification.fit_result import Fit

from ..apparatus.disturbed_flights import noisy
from ..apparatus.once import once
from ..apparatus.robust_fits import MODEL
from ..apparatus.synthetic_flights import fly


@pytest.fixture(scope="session")
def clean() -> Trajectory:
    flight = fly(MODEL, duration=12.0)
    rng = np.random.default_rng(0)
    noise = rng.normal(size=flight.state.shape) * [1e-5, 1e-5, 1e-4, 1e-3, 1e-3, 1e-2]
    return replace(flight, state=flight.state + noise)


@once
def fit_of_noisy() -> Fit:
    return identify(noisy())


@pytest.fixture(scope="session")
def fit() -> Fit:
    return fit_of_noisy()
