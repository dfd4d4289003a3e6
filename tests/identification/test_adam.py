"""Adam, the paper's optimiser (`studies/adam.py`), as a method for `identify`."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from studies.adam import Adam, monotone_penalty

from airpuck.craft.vehicle import default_vehicle
from airpuck.data.windows import make_windows
from airpuck.estimate.encoder import PaperEncoder
from airpuck.identification.method import LevenbergMarquardt
from airpuck.identification.objective import PredictionLoss
from airpuck.model.model_file import published_model
from airpuck.model.rungs import RUNGS
from airpuck.physics.thrust import lowest_slope

from ..apparatus.synthetic_flights import fly

VEHICLE = default_vehicle()


@pytest.fixture(scope="module")
def loss():
    windows = make_windows(fly(published_model("M3"), duration=4.0), stride=2)
    return PredictionLoss(windows, VEHICLE, PaperEncoder())


@pytest.mark.slow
def test_adam_approaches_the_minimum(loss):
    start = RUNGS["M3"].initial(VEHICLE)
    free = RUNGS["M3"].mask(start)
    adam = Adam(learning_rate=4e-3, inertia_factor=3e-4, epochs=25, batch_size=64)
    outcome = adam.minimize(loss, start, free)
    best = LevenbergMarquardt().minimize(loss, start, free)
    initial = outcome.history[0].loss
    assert outcome.loss - best.loss < 0.05 * (initial - best.loss)


@pytest.mark.slow
def test_the_first_step_follows_the_negative_gradient_at_the_learning_rate(loss):
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


@pytest.mark.slow
def test_a_seed_determines_the_result(loss):
    start = RUNGS["M3"].initial(VEHICLE)
    free = RUNGS["M3"].mask(start)
    # The rate of the next test: one program for both.
    first, again, other = (
        Adam(learning_rate=1e-3, epochs=1, batch_size=64, seed=seed)
        .minimize(loss, start, free)
        .parameters.to_vector()
        for seed in (1, 1, 2)
    )
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, other)


def test_the_regulariser_keeps_curves_monotone(loss):
    start = RUNGS["M3"].initial(VEHICLE)
    vector = start.to_vector()
    vector[0] = -0.02  # the first curve falls at zero
    start = start.with_vector(vector)
    free = RUNGS["M3"].mask(start)
    adam = Adam(learning_rate=1e-3, epochs=10, batch_size=64)
    assert adam.minimize(loss, start, free).parameters.thrust[0, 0] > -1e-3


coefficient = st.floats(-2, 2).map(lambda x: round(x, 3))


@given(st.tuples(coefficient, coefficient, coefficient))
def test_the_penalty_equals_the_papers(abc):
    a, b, c = abc
    expected = max(0, -a) + max(0, -a - 2 * b - 3 * c)
    if c > 0 and 0 <= -b / (3 * c) <= 1:
        expected += max(0, b**2 / (3 * c) - a)
    assert monotone_penalty(np, np.array([abc])) == pytest.approx(expected, abs=1e-9)


@given(st.lists(coefficient, min_size=1, max_size=5))
def test_the_penalty_is_zero_exactly_for_rising_curves(coefficients):
    curve = np.array([coefficients])
    slope, _ = lowest_slope(curve)
    # Between the points of the grid for high degrees, a slope can dip a little.
    if abs(slope[0]) > 1e-2:
        assert (monotone_penalty(np, curve) == 0) == (slope[0] > 0)


def test_the_penalty_has_finite_gradients_without_a_cubic_term():
    gradient = jax.grad(lambda c: monotone_penalty(jnp, c))(jnp.array([[-0.1, 1.0, 0.0]]))
    assert np.isfinite(gradient).all()
