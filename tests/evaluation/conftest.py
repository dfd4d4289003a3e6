"""Models learned from made-up flights, shared by the tests of this folder."""

from dataclasses import replace

import numpy as np
import pytest

from airpuck.identification.fit import identify

from ..apparatus.noisy_flights import TRUTH, noisy
from ..apparatus.once import once


@once
def three_flights():
    weak = np.array(TRUTH.parameters.thrust)
    weak[2] *= 0.9
    weakened = replace(TRUTH, parameters=replace(TRUTH.parameters, thrust=weak))
    same = [noisy(duration=30.0, seed=seed) for seed in (1, 2)]
    return [*same, noisy(weakened, 30.0, seed=3)]


@once
def three_models():
    return [identify(flight, "M3").model for flight in three_flights()]


@pytest.fixture(scope="session")
def flights():
    """Two flights of one craft, and one with a motor that lost a tenth of its thrust."""
    return three_flights()


@pytest.fixture(scope="session")
def fits():
    """M3 of each flight."""
    return three_models()
