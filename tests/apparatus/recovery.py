"""Whether an identification recovers the twin's parameters: one measure for all flights."""

import numpy as np
import pytest

from airpuck.model.parameters import Parameters
from airpuck.physics.thrust import thrust


def assert_recovered(found: Parameters, truth: Parameters) -> None:
    """Compare parameters identified from at least half a minute of excitation with the truth."""
    grid = np.tile(np.linspace(0.03, 1, 98), (len(truth.thrust), 1))
    true = thrust(truth.thrust, grid)
    apart = np.sqrt(np.mean((thrust(found.thrust, grid) - true) ** 2, axis=1))
    assert (apart < 0.04 * np.sqrt(np.mean(true**2, axis=1))).all()
    assert found.motor_time_constant == pytest.approx(truth.motor_time_constant, rel=0.08)
    assert found.inertia == pytest.approx(truth.inertia, rel=0.03)
    assert found.angle_offset == pytest.approx(truth.angle_offset, abs=0.01)
    np.testing.assert_allclose(found.center_of_mass, truth.center_of_mass, atol=0.5e-3)
