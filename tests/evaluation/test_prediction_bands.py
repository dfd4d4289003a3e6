"""95 % bands of predictions: what they hold, and their limits."""

from dataclasses import replace

import numpy as np
import pytest

from airpuck.boundary.errors import InputError
from airpuck.estimate.axis_filter import Noise
from airpuck.evaluation.innovations import innovations
from airpuck.evaluation.prediction_bands import BAND, prediction_bands
from airpuck.model.uncertainty import Uncertainty
from airpuck.preprocessing.pipeline import preprocess
from airpuck.twin.experiments import excite

from ..noisy import POSE_NOISE, TRUTH, noisy
from ..predicted import predicted


def in_deviations(bands):
    """Errors at the horizon by the standard deviations that the bands give them."""
    return BAND * ((bands.measured - bands.predicted) / bands.total)[-1]


def test_bands_hold_what_they_say_on_the_twin():
    # Default radio: what its jitter does is not in the model, and found by maximum likelihood.
    flight = preprocess(excite(TRUTH, 20.0, seed=3))
    bands = prediction_bands(TRUTH, flight)
    assert bands.by_parameters is None
    assert bands.horizon == pytest.approx(0.2, abs=0.003)
    assert len(bands.start) > 90
    # Of 90 windows at 95 %: less than 87 % in 0.2 % of all flights, if windows are independent.
    assert (bands.coverage >= 87).all()
    # Bands that are too wide would hold everything.
    size = np.sqrt(np.mean(in_deviations(bands) ** 2, axis=1))
    assert ((size > 0.5) & (size < 1.3)).all()


def test_bands_of_a_learned_model_hold_another_flight(fits, flights):
    flight = flights[1].slice(0, 0.7)
    bands = prediction_bands(fits[0], flight, horizon=0.5)
    assert bands.by_parameters is not None
    assert bands.coverage.mean() > 85
    # What is not known of the parameters counts beside the noise.
    assert (np.median(bands.by_parameters[-1], axis=1) > 0.5 * np.array(POSE_NOISE)).all()
    assert np.abs(in_deviations(bands)).mean() > 0.3


def test_the_band_by_lag_and_delay_is_that_of_models_drawn_from_their_covariance():
    learned = TRUTH.parameters.mask(frozenset({"motor_time_constant", "transport_delay"}))
    estimate, size = TRUTH.parameters.to_vector(), len(learned)
    # As a fit knows them: what one has too much the other has too little.
    covariance = np.zeros((size, size))
    covariance[np.ix_(learned, learned)] = 1e-8 * np.array([[1.0, -0.95], [-0.95, 1.0]])
    model = replace(
        TRUTH,
        free=learned,
        uncertainty=Uncertainty(
            estimate, covariance, np.sqrt(np.diag(covariance)), np.zeros((0, size)), 30, 2.0
        ),
    )
    flight = noisy(duration=2.0, seed=5)
    known = innovations(TRUTH, flight, Noise(POSE_NOISE, (0.1, 0.1, 2.0), (0.0, 0.0, 0.0)))
    starts = np.array([150, 220])
    bands = prediction_bands(model, flight, known=known, starts=starts)

    def moved(direction):
        parameters = TRUTH.parameters.with_vector(estimate + direction)
        late = float(parameters.transport_delay) - TRUTH.transport_delay
        one = replace(TRUTH, parameters=parameters)
        return predicted(one, flight, known, starts, len(bands.time), late)

    drawn = np.random.default_rng(0).multivariate_normal(np.zeros(size), covariance, 60)
    # With its mirror image each: what is not linear cancels.
    halves = [(moved(one) - moved(-one)) / 2 for one in drawn]
    expected = 2.0 * np.sqrt(np.mean(np.square(halves), axis=0))
    # 60 draws: a standard error of 9 %.
    np.testing.assert_allclose(bands.by_parameters[-1], expected[-1], rtol=0.3)


def test_without_any_error_the_band_is_that_of_the_pose(fits):
    flight = noisy(duration=2.0, seed=5)
    silent = Noise(POSE_NOISE, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    known = innovations(fits[0], flight, silent)
    known = replace(known, covariance=np.zeros_like(known.covariance))
    uncertainty = fits[0].uncertainty
    sure = replace(uncertainty, covariance=np.zeros_like(uncertainty.covariance))
    bands = prediction_bands(replace(fits[0], uncertainty=sure), flight, known=known)
    np.testing.assert_array_equal(bands.by_parameters, 0.0)
    expected = np.broadcast_to(1.96 * np.array(POSE_NOISE)[:, None], bands.total.shape)
    np.testing.assert_allclose(bands.total, expected, rtol=1e-4)


def test_predictions_do_not_overlap_nor_leave_the_recording(fits):
    flight = noisy(duration=2.0, seed=5)
    known = innovations(fits[0], flight, Noise(POSE_NOISE, (0.1, 0.1, 2.0), (0.0, 0.0, 0.0)))
    bands = prediction_bands(fits[0], flight, known=known)
    assert (bands.start[1:] >= bands.time[-1, :-1]).all()
    assert set(bands.to_json()["coverage_percent"]) == {"x_m", "y_m", "yaw_rad"}
    with pytest.raises(InputError, match="long enough"):
        prediction_bands(fits[0], flight, known=known, horizon=3.0)
