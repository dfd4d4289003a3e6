"""Adam, the paper's optimiser."""

import numpy as np
import pytest

from airpuck.craft.vehicle import default_vehicle
from airpuck.data.windows import make_windows
from airpuck.estimate.encoder import PaperEncoder
from airpuck.identification.adam import Adam
from airpuck.identification.levenberg_marquardt import LevenbergMarquardt
from airpuck.identification.objective import PredictionLoss
from airpuck.model.model_file import published_model
from airpuck.model.rungs import RUNGS

from ..synthetic import fly

VEHICLE = default_vehicle()


@pytest.fixture(scope="module")
def loss():
    windows = make_windows(fly(published_model("M3"), duration=4.0), stride=2)
    return PredictionLoss(windows, VEHICLE, PaperEncoder())


def test_approaches_the_minimum(loss):
    start = RUNGS["M3"].initial(VEHICLE)
    free = RUNGS["M3"].mask(start)
    adam = Adam(learning_rate=3e-3, inertia_factor=3e-4, epochs=40, batch_size=64)
    outcome = adam.minimize(loss, start, free)
    best = LevenbergMarquardt().minimize(loss, start, free)
    initial = outcome.history[0].loss
    assert outcome.loss - best.loss < 0.05 * (initial - best.loss)
    assert outcome.history[-1].test_loss == pytest.approx(outcome.loss, rel=0.5)


def test_a_first_step_goes_down_the_gradient_at_the_learning_rate(loss):
    start = RUNGS["M1"].initial(VEHICLE)
    free = RUNGS["M1"].mask(start)
    count = len(loss.windows)
    adam = Adam(epochs=1, batch_size=count, test_share=0.0, regularizer_weight=0.0)
    outcome = adam.minimize(loss, start, free)
    gradient = loss.quadratic(start).gradient
    rate = np.where(free, 1e-4, 0.0)
    rate[18] *= 0.1  # the inertia
    # Kingma and Ba: the first step is -rate g / (|g| + 1e-8), whatever the gradient's size.
    np.testing.assert_allclose(
        outcome.parameters.to_vector() - start.to_vector(),
        -rate * gradient / (np.abs(gradient) + 1e-8),
        rtol=1e-6,
        atol=1e-15,
    )


def test_the_seed_decides(loss):
    start = RUNGS["M3"].initial(VEHICLE)
    free = RUNGS["M3"].mask(start)
    first, again, other = (
        Adam(epochs=1, batch_size=64, seed=seed).minimize(loss, start, free).parameters.to_vector()
        for seed in (1, 1, 2)
    )
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, other)


def test_the_regulariser_keeps_curves_rising(loss):
    start = RUNGS["M3"].initial(VEHICLE)
    vector = start.to_vector()
    vector[0] = -0.02  # the first curve falls at zero
    start = start.with_vector(vector)
    free = RUNGS["M3"].mask(start)
    adam = Adam(learning_rate=1e-3, epochs=10, batch_size=64)
    assert adam.minimize(loss, start, free).parameters.thrust[0, 0] > -1e-3
