"""A fast reaction wheel beside slow propellers, seen by a slow camera."""

from dataclasses import replace

import numpy as np
import pytest

from airpuck.deviation.effect_errors import effect_errors
from airpuck.evaluation.comparison import better_from
from airpuck.evaluation.evaluate import evaluate
from airpuck.identification.bootstrap import resampled_estimates
from airpuck.identification.fit import identify
from airpuck.identification.settings import Preparation
from airpuck.model.model_file import nominal_model
from airpuck.preprocessing.pipeline import preprocess
from airpuck.recording.stream import Recording

from ..apparatus.two_way_craft import triangle

STEP, DELAY = 0.02, 0.04


def flown(tmp_path, noise=(1e-4, 1e-4, 5e-4)):
    """Return the craft, its true model, and a trajectory of 60 s seen at 8 Hz."""
    fast = 'commanded = "torque"\ntime_constant_s = 0.01'
    vehicle = triangle(tmp_path, fast, **{"constant_s = 0.06": "constant_s = 0.15"})
    random, nominal = np.random.default_rng(1), nominal_model(vehicle)
    start = nominal.parameters
    strengths = random.uniform(0.9, 1.1, (len(start.thrust), 1))
    truth = replace(start, thrust=start.thrust * strengths, motor_time_constant=0.17)
    count, held = 3000, 20
    command = random.choice([0.0, 1.0], (count // held, 4))
    command *= random.uniform(-1.0, 1.0, command.shape)
    command[:, 2] = np.abs(command[:, 2])
    drives = np.repeat(vehicle.actuation.split(command), held, axis=0)
    moved = replace(nominal, parameters=truth).simulate(np.zeros(6), drives, STEP)
    time = STEP * np.arange(1, count + 1)
    seen = slice(None, None, 6)
    pose = moved[seen, :3] + random.normal(0, noise, (len(time[seen]), 3))
    sent = STEP * held * np.arange(count // held) - DELAY
    recording = Recording.from_arrays(time[seen], pose, sent, command, propellers=vehicle.columns)
    return vehicle, truth, preprocess(recording, vehicle)


def test_timing_and_predictions_are_judged_between_slow_frames(tmp_path):
    vehicle, truth, trajectory = flown(tmp_path)
    parameters = replace(truth, transport_delay=DELAY)
    free = parameters.mask(frozenset({"transport_delay"}))
    model = replace(nominal_model(vehicle), parameters=parameters, free=free)
    errors = effect_errors(model, trajectory)
    assert errors is not None
    assert errors.later_error < 0.006
    assert abs(errors.later) < 4 * errors.later_error
    assert (errors.push_error < 0.1).all()
    since = better_from(evaluate(model, trajectory), trajectory)
    assert since.longest > 0.8  # 5.5 time constants of the propellers
    assert since.since is not None


@pytest.mark.slow
def test_a_wheels_own_lag_leaves_all_forces_correct(tmp_path):
    _, truth, trajectory = flown(tmp_path)
    model = identify(trajectory, preparation=Preparation(faults="keep")).model
    known = model.uncertainty
    assert known is not None
    full = model.parameters.thrust.sum(axis=1) / truth.thrust.sum(axis=1) - 1
    error = known.propagate(lambda v: truth.with_vector(v).thrust.sum(axis=1))
    within = known.quantile * error / truth.thrust.sum(axis=1)
    assert (np.abs(full) < np.maximum(0.02, within)).all(), full
    assert (within < 0.1).all()
    assert abs(model.parameters.motor_time_constant - 0.17) < 0.01
    assert abs(model.transport_delay - DELAY) < 0.01


@pytest.mark.slow
def test_the_error_of_a_wheels_lag_matches_fits_with_other_lags(tmp_path):
    """Also where noise makes the model smooth the velocities, by 0.1 standard errors."""
    vehicle, _, trajectory = flown(tmp_path, noise=(1e-3, 1e-3, 2e-3))
    (wheel,), error = vehicle.wheels, 0.01

    def fitted(**stated):
        wheels = (wheel.model_copy(update=stated),)
        other = vehicle.model_copy(update={"wheels": wheels})
        return identify(trajectory, vehicle=other, preparation=Preparation(faults="keep")).model

    known, without = (
        fitted(time_constant_s=0.02, lag_error_s=own).uncertainty for own in (error, 0.0)
    )
    low, high = (
        fitted(time_constant_s=0.02 + sign * error, lag_error_s=0.0).parameters.to_vector()
        for sign in (-1, 1)
    )
    told = np.isfinite(known.standard_errors)
    added = np.diag(known.covariance)[told] - np.diag(without.covariance)[told]
    actual, plain = np.abs(high - low)[told] / 2, without.standard_errors[told]
    assert (np.abs(np.sqrt(np.maximum(added, 0)) - actual) < 0.05 * plain + 0.2 * actual).all()


@pytest.mark.slow
def test_resampled_fits_draw_a_wheels_lag_from_its_error(tmp_path):
    vehicle, _, trajectory = flown(tmp_path)
    fit = identify(trajectory, preparation=Preparation(faults="keep"))
    (wheel,), known, estimates = vehicle.wheels, fit.uncertainty, []
    for error in (0.005, 0.0):
        wheels = (wheel.model_copy(update={"lag_error_s": error}),)
        other = vehicle.model_copy(update={"wheels": wheels})
        model = replace(fit.model, vehicle=other)
        estimates.append(resampled_estimates(replace(fit, model=model), 6, seed=3))
    drawn, held = estimates
    errors = np.nan_to_num(known.standard_errors, nan=np.inf)
    # A longer lag changes all parameters in proportion.
    size = np.linalg.svd((drawn - held) / errors, compute_uv=False)
    assert size[0] > max(3 * size[1], 0.5)
