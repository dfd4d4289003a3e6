"""The transport delay, to a fraction of a sample, jointly with the motor lag."""

from dataclasses import replace

import numpy as np
import pytest
from studies.adam import Adam

from airpuck.boundary.errors import InputError
from airpuck.craft.vehicle import default_vehicle
from airpuck.data.sampling import mean_hold
from airpuck.data.trajectory import Trajectory
from airpuck.data.windows import make_windows
from airpuck.estimate.encoder import PaperEncoder
from airpuck.evaluation.evaluate import evaluate
from airpuck.identification.fit import identify
from airpuck.identification.objective import PredictionLoss
from airpuck.identification.settings import Loss, Preparation
from airpuck.model.model_file import Model, published_model, read_model
from airpuck.model.rungs import RUNGS

from ..apparatus.plain_loss import differences, plain_residuals
from ..apparatus.random_flights import fast_rollout, random_flight
from ..apparatus.synthetic_flights import fly

VEHICLE = default_vehicle()
FIXED, LEARNED = Preparation(delay="fixed"), Preparation(delay="fit")
TRUTH = replace(published_model("M3"), frame="body", indexing="start").with_delay(0.01873)
#: Number of samples after which the first command no longer matters.
LONG = Loss(encoder_time=0.5, spacing=3 / 240)


def flown(truth: Model = TRUTH, applied: float = 5 / 240, seed: int = 0) -> Trajectory:
    """A flight with exact states whose commands act a fraction of a sample after one.

    It is integrated at 16 times the rate of the motion capture, so that commands change between
    samples.
    """
    fine, late = 16, 7
    flight = random_flight(truth, 6.0, seed)
    rate = 240 * fine
    command = np.repeat(flight.command, fine, axis=0)
    acting = np.concatenate([np.repeat(command[:1], late, axis=0), command])[: len(command)]
    n = truth.vehicle.n_propellers
    start = np.concatenate([np.zeros(6), np.full(n, truth.vehicle.command_min)])
    states = fast_rollout(truth.dynamics, start, acting, np.full(len(acting), 1 / rate))
    state = np.concatenate([start[None], states[:-1]])[::fine, :6]
    return Trajectory(
        time=flight.time,
        state=state,
        acceleration=np.gradient(state[:, 3:], flight.time, axis=0),
        command_time=flight.time + late / rate - truth.transport_delay,
        command=flight.command,
        propellers=truth.vehicle.propeller_names,
        delay=applied,
    )


@pytest.fixture(scope="module")
def flight() -> Trajectory:
    return flown()


@pytest.mark.slow
@pytest.mark.parametrize("applied", [3 / 240, pytest.param(7 / 240, marks=pytest.mark.study)])
def test_delay_and_lag_are_estimated_jointly(applied):
    """From a delay two samples off and a lag half too long, in data without noise."""
    start = RUNGS["M3"].initial(VEHICLE)
    wrong = replace(start, motor_time_constant=1.5 * 0.0281, transport_delay=applied)
    fit = identify(flown(applied=applied), initial=wrong, loss=LONG)
    found = fit.model.parameters
    assert fit.converged
    # Remaining error of the mean over a step: x (1 - x) h² / 2τ of the lag, see `mean_hold`.
    assert fit.model.transport_delay == pytest.approx(TRUTH.transport_delay, abs=8e-5)
    assert found.motor_time_constant == pytest.approx(
        TRUTH.parameters.motor_time_constant, abs=12e-5
    )
    assert found.inertia == pytest.approx(TRUTH.parameters.inertia, rel=1e-3)


@pytest.mark.study
def test_a_delay_fixed_to_whole_samples_biases_the_lag(flight):
    """Why the delay is continuous: 5 samples instead of 4.5 make the lag too short."""
    fit = identify(flight, preparation=FIXED, loss=LONG)
    assert fit.model.transport_delay == flight.delay
    assert not fit.model.delay_learned
    bias = fit.model.parameters.motor_time_constant - TRUTH.parameters.motor_time_constant
    assert bias < -1e-3


@pytest.mark.parametrize(("name", "indexing"), [("M0", "end"), ("M3", "start"), ("M3", "end")])
def test_the_gradient_matches_finite_differences(flight, name, indexing):
    """Derivatives by lag and delay, against a plain rollout."""
    noise = np.random.default_rng(1).normal(size=flight.state.shape)
    noisy = replace(flight, state=flight.state + 0.01 * noise)
    windows = make_windows(noisy, stride=31)
    encoder = PaperEncoder(indexing=indexing)
    loss = PredictionLoss(windows, VEHICLE, encoder, continuous_delay=True)
    parameters = replace(RUNGS[name].initial(VEHICLE), transport_delay=0.0203)

    def plain(vector):
        moved = parameters.with_vector(vector)
        events = noisy.command_time + float(moved.transport_delay)
        own = replace(windows, input=mean_hold(events, noisy.command, noisy.time)[0])
        return np.mean(plain_residuals(np, moved.dynamics(np, VEHICLE), own, encoder) ** 2)

    here, vector = loss.quadratic(parameters), parameters.to_vector()
    assert here.loss == pytest.approx(plain(vector), rel=1e-12)
    names = {"transport_delay"} | ({"motor_time_constant"} if name == "M3" else set())
    entries = np.flatnonzero(parameters.mask(frozenset(names)))
    slopes = differences(plain, vector, entries)
    np.testing.assert_allclose(here.gradient[entries], slopes, rtol=1e-5)


@pytest.mark.slow
def test_predictions_use_the_learned_delay(flight, tmp_path):
    """A learned delay is used whatever preprocessing found, also after reading it from a file."""
    learned = replace(TRUTH, free=TRUTH.parameters.mask(frozenset({"transport_delay"})))
    other = flown(applied=6 / 240, seed=1)
    exact = evaluate(learned, other).rmse
    np.testing.assert_array_less(exact, 0.2 * evaluate(TRUTH, other).rmse)
    learned.save(tmp_path / "model.toml")
    again = evaluate(read_model(tmp_path / "model.toml"), replace(other, delay=4 / 240))
    np.testing.assert_array_equal(again.rmse, exact)


@pytest.mark.slow
def test_already_shifted_commands_get_the_nominal_delay():
    """If the author had already shifted the commands, the amount is unknown."""
    fit = identify(fly(TRUTH, duration=6.0), preparation=LEARNED, loss=LONG)
    assert fit.model.transport_delay == pytest.approx(VEHICLE.nominal.transport_delay_s, abs=2e-5)


@pytest.mark.slow
def test_rungs_without_a_lag_keep_the_delay(flight):
    fit = identify(flight, "M0")
    assert not fit.model.delay_learned
    assert identify(flight, "M0", preparation=LEARNED).model.transport_delay > 1.5 * flight.delay


@pytest.mark.slow
def test_other_optimisers_do_not_learn_the_delay(flight):
    with pytest.raises(InputError, match="Levenberg-Marquardt only"):
        identify(flight, preparation=LEARNED, method=Adam(epochs=1))


@pytest.mark.slow
def test_a_recording_with_another_delay_causes_a_warning(flight):
    strange = replace(flown(seed=2), delay=12 / 240)
    warnings = identify([flight, strange]).warnings
    assert any("check clocks" in warning for warning in warnings)
