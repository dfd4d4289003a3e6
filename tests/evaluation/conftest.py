"""Models learned from made-up flights, shared by the tests of this folder."""

import pytest

from airpuck.identification.fit import identify

from ..apparatus.models import scaled
from ..apparatus.noisy_flights import TRUTH, noisy
from ..apparatus.once import once


@once
def three_flights():
    same = [noisy(duration=30.0, seed=seed) for seed in (1, 2)]
    return [*same, noisy(scaled(TRUTH, [1, 1, 0.9, 1, 1, 1]), 30.0, seed=3)]


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
