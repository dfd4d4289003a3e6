"""The structure of a model: what the recordings show, and errors that say what it cannot."""

from dataclasses import replace

import numpy as np
import pytest

import airpuck
from airpuck.model.model_file import published_model

from ..apparatus.synthetic_flights import fly

#: Commands at which thrusts are compared.
SPEEDS = np.array([0.25, 0.5, 0.75, 1.0])


@pytest.mark.slow
def test_errors_of_thrusts_contain_a_level_that_only_the_shape_at_rest_tells():
    """Curves like square roots: all forces that balance each other are off by one constant."""
    truth = replace(published_model("M3"), frame="body", indexing="start")
    v, powers = np.linspace(0.0, 1.0, 201), np.arange(1, 10)
    shape = np.linalg.lstsq(v[:, None] ** powers, np.sqrt(v + 0.01) - 0.1, rcond=None)[0]
    curves = 0.6 * np.ones((6, 1)) * shape
    truth = replace(truth, parameters=replace(truth.parameters, thrust=curves))
    found = airpuck.study(fly(truth, duration=24.0)).model

    def thrusts(model: airpuck.Model) -> np.ndarray:
        coefficients = np.asarray(model.parameters.thrust)
        return coefficients @ SPEEDS ** np.arange(1, coefficients.shape[1] + 1)[:, None]

    off = thrusts(found) - thrusts(truth)
    error = np.array(
        [
            [float(found.standard_error(lambda m, i=i, k=k: thrusts(m)[i, k])) for k in range(4)]
            for i in range(6)
        ]
    )
    # Six to ten times as large as by chance.
    assert np.mean(off) < -0.01 and np.std(off) < 0.5 * abs(np.mean(off))
    assert np.all(np.abs(off) < 2.5 * error)
    assert np.median(error) < 0.06 * 0.6
