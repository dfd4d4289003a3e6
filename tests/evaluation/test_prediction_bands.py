"""95 % bands of predictions, and the propagation of errors behind them."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from airpuck.boundary.errors import InputError
from airpuck.estimate.axis_filter import Noise
from airpuck.evaluation.innovations import innovations
from airpuck.evaluation.prediction_bands import BAND, predict_with_errors, prediction_bands
from airpuck.model.rungs import named_rung
from airpuck.physics.effects import Effect
from airpuck.physics.motor import motor_step
from airpuck.physics.rigid_body import rollout
from airpuck.preprocessing.pipeline import preprocess
from airpuck.twin.experiments import excite

from ..apparatus.beliefs import believed, uncertainty
from ..apparatus.noisy_flights import POSE_NOISE, TRUTH, noisy
from ..apparatus.predictions import predicted


def in_deviations(bands):
    """Errors at the horizon by the standard deviations that the bands give them."""
    return BAND * ((bands.measured - bands.predicted) / bands.total)[-1]


@pytest.mark.study
def test_bands_have_their_stated_coverage_on_the_twin():
    # Default radio: the model does not include jitter; maximum likelihood finds its effect.
    flight = preprocess(excite(TRUTH, 20.0, seed=3))
    # An uncertainty of other parameters says nothing about the model.
    vector = TRUTH.parameters.to_vector()
    other = uncertainty(1.01 * vector, vector)
    bands = prediction_bands(replace(TRUTH, uncertainty=other), flight)
    assert bands.by_parameters is None
    assert bands.horizon == pytest.approx(0.2, abs=0.003)
    assert len(bands.start) > 90
    # With 90 independent windows at 95 %, 0.2 % of all flights have a coverage below 87 %.
    assert (bands.coverage >= 87).all()
    # Bands that are too wide would hold everything.
    size = np.sqrt(np.mean(in_deviations(bands) ** 2, axis=1))
    assert ((size > 0.5) & (size < 1.3)).all()


@pytest.mark.slow
def test_bands_of_a_learned_model_cover_another_flight(fits, flights):
    flight = flights[1].slice(0, 0.7)
    bands = prediction_bands(fits[0], flight, horizon=0.5)
    assert bands.by_parameters is not None
    assert bands.coverage.mean() > 85
    # The uncertainty of the parameters adds to the noise.
    assert (np.median(bands.by_parameters[-1], axis=1) > 0.5 * np.array(POSE_NOISE)).all()
    assert np.abs(in_deviations(bands)).mean() > 0.3


@pytest.mark.slow
def test_the_band_of_lag_and_delay_matches_sampled_models():
    learned = TRUTH.parameters.mask(frozenset({"motor_time_constant", "transport_delay"}))
    estimate, size = TRUTH.parameters.to_vector(), len(learned)
    # As after a fit: the errors of lag and delay are opposite.
    covariance = np.zeros((size, size))
    covariance[np.ix_(learned, learned)] = 1e-8 * np.array([[1.0, -0.95], [-0.95, 1.0]])
    model = believed(replace(TRUTH, free=learned), covariance)
    flight = noisy(duration=2.0, seed=5)
    known = innovations(TRUTH, flight, Noise(POSE_NOISE, (0.1, 0.1, 2.0), (0.0, 0.0, 0.0)))
    starts = np.array([150, 220])
    bands = prediction_bands(model, flight, known=known, starts=starts)

    def moved(direction):
        parameters = TRUTH.parameters.with_vector(estimate + direction)
        late = float(parameters.transport_delay) - TRUTH.transport_delay
        one = replace(TRUTH, parameters=parameters)
        return predicted(one, flight, known, starts, len(bands.time), late)

    drawn = np.random.default_rng(0).multivariate_normal(np.zeros(size), covariance, 12)
    # Each draw with its mirror image, so that nonlinear effects cancel.
    halves = [(moved(one) - moved(-one)) / 2 for one in drawn]
    expected = 2.0 * np.sqrt(np.mean(np.square(halves), axis=0))
    # 12 draws: a standard error of 20 %.
    np.testing.assert_allclose(bands.by_parameters[-1], expected[-1], rtol=0.45)


@pytest.mark.slow
def test_without_model_error_the_band_reduces_to_pose_noise(fits):
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


@pytest.mark.slow
def test_predictions_neither_overlap_nor_leave_the_recording(fits):
    flight = noisy(duration=2.0, seed=5)
    known = innovations(fits[0], flight, Noise(POSE_NOISE, (0.1, 0.1, 2.0), (0.0, 0.0, 0.0)))
    bands = prediction_bands(fits[0], flight, known=known)
    assert (bands.start[1:] >= bands.time[-1, :-1]).all()
    assert set(bands.to_json()["coverage_percent"]) == {"x_m", "y_m", "yaw_rad"}
    with pytest.raises(InputError, match="long enough"):
        prediction_bands(fits[0], flight, known=known, horizon=3.0)


STARTS, STEPS, LEAD = np.array([200, 300]), 48, 40
NOISE = Noise(POSE_NOISE, (0.05, 0.04, 1.0), (0.1, 0.2, 3.0))


@pytest.fixture(scope="module")
def flight():
    return noisy(duration=3.0, seed=6)


@pytest.fixture(scope="module")
def filtered(flight):
    """A filter's estimates without a disturbance, which NumPy's rollout does not know."""
    known = innovations(TRUTH, flight, NOISE)
    mean = known.mean.copy()
    mean[:, :, 2] = 0.0
    return replace(known, mean=mean)


def simulate(model, flight, known, turned=0.0):
    """The same predictions by the plain rollout; commands change at samples only."""
    held, mean = np.diff(flight.time), known.mean[STARTS]
    speed, at = known.motor_speed[STARTS - LEAD].T, STARTS[:, None]
    for k in (at + np.arange(-LEAD, 0)).T:
        tau = model.parameters.motor_time_constant
        speed = motor_step(np, speed, flight.input[k].T, held[k], tau)
    pose = mean[:, :, 0].T + np.array([0, 0, turned])[:, None]
    ahead = (at + np.arange(STEPS)).T
    commands = np.moveaxis(flight.input[ahead], 2, 1)
    state = np.concatenate([pose, mean[:, :, 1].T, speed])
    return rollout(np, model.dynamics, state, commands, held[ahead])[:, :3]


def predict(flight, known, entries=()):
    mask = np.zeros(len(TRUTH.free), dtype=bool)
    mask[list(entries)] = True
    return predict_with_errors(TRUTH, flight, known, STARTS, STEPS, mask)


@pytest.mark.slow
def test_sensitivities_match_perturbed_parameters(flight, filtered):
    labels = TRUTH.parameters.labels(TRUTH.vehicle.propeller_names)
    names = ("thrust motor_b_1 φ^2", "inertia", "motor_time_constant", "center_of_mass x")
    entries = sorted(labels.index(name) for name in names)
    predicted, _, slopes = predict(flight, filtered, entries)
    np.testing.assert_allclose(predicted, simulate(TRUTH, flight, filtered), atol=1e-9)
    vector = TRUTH.parameters.to_vector()
    for k, entry in enumerate(entries):
        moved = []
        for sign in (1, -1):
            step = np.zeros_like(vector)
            step[entry] = sign * 1e-4 * abs(vector[entry])
            parameters = TRUTH.parameters.with_vector(vector + step)
            moved.append(simulate(replace(TRUTH, parameters=parameters), flight, filtered))
        slope = (moved[0] - moved[1]) / (2e-4 * abs(vector[entry]))
        scale = np.abs(slope).max(axis=(0, 2), keepdims=True)
        assert (np.abs(slopes[..., k] - slope) < 1e-4 * scale).all()


@pytest.mark.slow
@pytest.mark.parametrize("late", [0.0, 3e-3])
def test_the_sensitivity_to_the_delay_matches_shifted_commands(flight, filtered, late):
    # Without delay the commands of this flight are at samples, where pieces begin and end.
    delay = TRUTH.parameters.mask(frozenset({"transport_delay"}))
    model = replace(TRUTH, free=TRUTH.free | delay).with_delay(TRUTH.transport_delay + late)
    _, _, slopes = predict_with_errors(model, flight, filtered, STARTS, STEPS, delay)
    step = 1e-6
    moved = [
        predicted(TRUTH, flight, filtered, STARTS, STEPS, late + sign * step) for sign in (1, -1)
    ]
    slope = (moved[0] - moved[1]) / (2 * step)
    scale = np.abs(slope).max(axis=(0, 2), keepdims=True)
    assert (np.abs(slopes[..., 0] - slope) < 1e-3 * scale).all()


@pytest.mark.slow
def test_yaw_variance_is_the_double_integral_of_its_noise(flight, filtered):
    # Nothing else turns the craft: r + t² s + q₁t³/3 + (d + q₂ t³/20) t⁴/4 …, by hand.
    _, variance, _ = predict(flight, filtered)
    t = (flight.time[STARTS + STEPS] - flight.time[STARTS])[:, None, None]
    one, zero = np.ones_like(t), np.zeros_like(t)
    by_start = np.concatenate([one, t, t**2 / 2], axis=2)
    start = (by_start @ filtered.covariance[STARTS, 2] @ np.moveaxis(by_start, 1, 2)) + zero
    t = t[:, 0, 0]
    expected = start[:, 0, 0] + NOISE.acceleration[2] ** 2 * t**3 / 3
    expected += NOISE.disturbance[2] ** 2 * t**5 / 20
    np.testing.assert_allclose(variance[-1, 2], expected, rtol=1e-6)


def test_uncertainty_in_yaw_spreads_to_x_and_y(flight, filtered):
    sigma = 1e-3
    only_yaw = np.zeros_like(filtered.covariance)
    only_yaw[:, 2, 0, 0] = sigma**2
    silent = Noise(POSE_NOISE, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    _, variance, _ = predict(flight, replace(filtered, covariance=only_yaw, noise=silent))
    plus, minus = (simulate(TRUTH, flight, filtered, turned) for turned in (1e-4, -1e-4))
    np.testing.assert_allclose(
        np.sqrt(variance), sigma * np.abs(plus - minus) / 2e-4, rtol=1e-4, atol=1e-10
    )
    assert (np.sqrt(variance[-1, :2]) > 1e-5).any()


def test_windows_are_predicted_independently(flight, filtered):
    entries, one = np.zeros(len(TRUTH.free), dtype=bool), STARTS[:1]
    entries[:2] = True
    alone = predict_with_errors(TRUTH, flight, filtered, one, STEPS, entries)
    both = predict_with_errors(TRUTH, flight, filtered, STARTS, STEPS, entries)
    for single, pair in zip(alone, both, strict=True):
        assert single.shape[2] == 1
        np.testing.assert_allclose(single[:, :, 0], pair[:, :, 0], rtol=1e-12, atol=1e-15)


@dataclass(frozen=True, eq=False)
class Braked(Effect):
    """Linear drag along the body."""

    rate: float = 0.3

    def acceleration(self, xp, motion):
        return -self.rate * motion.forward, 0.0, 0.0


def test_effects_of_the_users_own_count(flight, filtered):
    rung, truth = named_rung("M3").with_effect(Braked), TRUTH.parameters
    known = {quantity.name: getattr(truth, quantity.name) for quantity in truth.quantities}
    parameters = replace(rung.initial(TRUTH.vehicle), **known)
    model = replace(TRUTH, parameters=parameters, free=rung.mask(parameters))
    nothing = np.zeros(len(model.free), dtype=bool)
    predicted, _, _ = predict_with_errors(model, flight, filtered, STARTS, STEPS, nothing)
    np.testing.assert_allclose(predicted, simulate(model, flight, filtered), atol=1e-9)
    assert np.abs(predicted - predict(flight, filtered)[0]).max() > 1e-4
