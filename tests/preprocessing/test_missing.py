"""Lost frames are samples without a measurement."""

from dataclasses import replace

import numpy as np
import pytest
from studies.adam import batch_loss

from airpuck import Loss, Recording, Trajectory
from airpuck.craft.vehicle import default_vehicle
from airpuck.data.windows import make_windows
from airpuck.evaluation.comparison import better_from
from airpuck.evaluation.evaluate import evaluate
from airpuck.evaluation.innovations import innovations
from airpuck.identification.fit import identify
from airpuck.identification.problem import prediction_loss
from airpuck.model.model_file import published_model
from airpuck.preprocessing.pipeline import preprocess
from airpuck.preprocessing.quality import interpolated, with_lost_frames

from ..apparatus.synthetic_flights import edited, fly, record

MODEL = published_model("M3")


def without(recording: Recording, kept: np.ndarray) -> Trajectory:
    """Preprocess a recording that lacks some poses."""

    def edit(stamp, received, values):
        return stamp[kept], received[kept], values[kept]

    return preprocess(edited(recording, "pose", edit))


def random_losses(count: int, share: float, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).random(count) > share


def test_lost_frames_get_samples_but_long_pauses_do_not():
    whole = np.arange(400) / 240
    lost = [50, 100, 101, *range(200, 220), *range(300, 340)]
    time, _, measured = with_lost_frames(np.delete(whole, lost), np.zeros((400 - len(lost), 1)))
    np.testing.assert_allclose(time, np.delete(whole, range(300, 340)), atol=1e-12)
    assert np.flatnonzero(~measured).tolist() == lost[:23]


def test_jitter_and_alternating_steps_are_not_lost_frames():
    rng = np.random.default_rng(0)
    jittered = (np.arange(1000) + rng.uniform(-0.2, 0.2, 1000)) / 240
    thinned = np.rint(np.arange(0, 5, 0.01) * 240) / 240
    for time in (jittered, thinned):
        assert with_lost_frames(time, np.zeros((len(time), 1)))[2].all()


def test_interpolation_is_exact_for_cubics_and_their_rates():
    time = np.sort(np.random.default_rng(1).uniform(0, 1, 60))
    cubic, rate = time**3 - 2 * time, 3 * time**2 - 2
    known = np.ones(60, dtype=bool)
    known[[5, 20, 21, 22, 50]] = False
    spoilt, unknown = np.where(known, cubic, 9.0)[:, None], np.where(known, rate, 9.0)[:, None]
    values, rates = interpolated(time, spoilt, unknown, known)
    np.testing.assert_allclose(values[:, 0], cubic, atol=1e-12)
    np.testing.assert_allclose(rates[:, 0], rate, atol=1e-10)


@pytest.mark.parametrize("share", [0.02, 0.05, 0.12, 0.2])
def test_velocities_are_accurate_despite_single_lost_frames(share):
    recording = record(duration=6.0, noise=5e-5)
    whole = preprocess(recording)
    kept = random_losses(len(recording["pose"]), share)
    trajectory = without(recording, kept)
    assert not trajectory.excluded
    assert 1 - trajectory.measured.mean() == pytest.approx(share, abs=0.02)
    places = np.searchsorted(whole.time + 1e-6, trajectory.time + whole.time[0], side="left")
    assert any("frames are lost" in warning for warning in trajectory.warnings)
    truth = fly(MODEL, 6.0)
    shift = int(np.argmin(np.abs(truth.state[:100, :2] - trajectory.state[0, :2]).sum(axis=1)))
    inner = slice(20, min(len(trajectory), len(truth) - shift) - 20)
    error = trajectory.state[inner] - truth.state[shift:][inner]
    usual = whole.state[inner] - truth.state[shift:][inner]
    assert len(places) == len(trajectory)
    assert (error.std(axis=0) < 1.5 * usual.std(axis=0)).all()


@pytest.fixture(scope="module")
def burst() -> Trajectory:
    """A flight that lost 12 and 20 frames in a row."""
    recording = record(duration=6.0, noise=5e-5)
    kept = np.ones(len(recording["pose"]), dtype=bool)
    kept[500:512] = kept[900:920] = False
    return without(recording, kept)


def spoilt(trajectory: Trajectory) -> Trajectory:
    """The same with nonsense in place of lost poses."""
    state = np.where(trajectory.measured[:, None], trajectory.state, 7.0)
    return replace(trajectory, state=state)


def test_bursts_of_lost_frames_exclude_only_window_starts(burst):
    assert not burst.excluded
    assert (~burst.measured).sum() == 32
    # Beside a burst, velocities are smoothed on one side only.
    assert (~burst.determined).sum() == 32 + 4 * 5
    windows = make_windows(burst, 20, 50)
    assert burst.determined[windows.present].all()
    # Every window whose start is known is there, whatever it misses later.
    assert len(windows) == len(burst) - 69 - 52
    judged = make_windows(burst, 20, 50, judged=48)
    assert burst.measured[judged.present + 48].all()


def test_a_lost_pose_is_ignored_by_a_fit(burst):
    loss = Loss()
    first, second = (
        prediction_loss(loss, [one], default_vehicle()) for one in (burst, spoilt(burst))
    )
    theta = MODEL.parameters
    found, other = first.quadratic(theta), second.quadratic(theta)
    assert found.loss == pytest.approx(other.loss, rel=1e-12)
    np.testing.assert_allclose(found.gradient, other.gradient, rtol=1e-9)
    squares = first.window_gradients(theta)[0], second.window_gradients(theta)[0]
    np.testing.assert_allclose(*squares, rtol=1e-12)
    # The mean is over the measured poses: all at once, or averaged over the windows.
    by_window = first.windows.poses / first.windows.poses.sum()
    assert found.loss == pytest.approx(float(squares[0] @ by_window))
    starts = first.windows.starts[:64]
    assert np.isclose(
        batch_loss(first, theta)(theta.to_vector(), starts),
        batch_loss(second, theta)(theta.to_vector(), starts),
        rtol=1e-4,
    )


def test_a_lost_pose_is_ignored_by_an_evaluation(burst):
    found, other = evaluate(MODEL, burst), evaluate(MODEL, spoilt(burst))
    np.testing.assert_array_equal(found.rmse, other.rmse)
    np.testing.assert_array_equal(found.every_start.rmse, other.every_start.rmse)
    np.testing.assert_array_equal(found.rmse_over_horizon, other.rmse_over_horizon)
    assert np.isfinite(found.rmse_over_horizon).all()
    assert np.isnan(found.errors).any()
    assert better_from(found, burst) == better_from(other, spoilt(burst))


def test_a_lost_pose_does_not_change_the_innovations(burst):
    found, other = innovations(MODEL, burst), innovations(MODEL, spoilt(burst))
    assert not found.used[~burst.measured].any()
    # One pause costs no more innovations than the poses that are missing.
    assert found.used.sum() == burst.measured.sum() - 2
    np.testing.assert_allclose(found.standardised, other.standardised, atol=1e-6)
    scaled = found.standardised[found.used]
    assert np.abs(scaled.std(axis=0) - 1).max() < 0.15


@pytest.mark.slow
def test_a_fit_without_some_of_the_poses_gives_the_same_result():
    recording = record(duration=20.0, noise=5e-5)
    kept = random_losses(len(recording["pose"]), 0.2)
    kept[1000:1020] = kept[2500:2524] = False
    fit, whole = identify(without(recording, kept)), identify(preprocess(recording))
    usual, errors = (one.model.uncertainty.standard_errors for one in (whole, fit))
    moved = fit.model.parameters.to_vector() - whole.model.parameters.to_vector()
    known = usual > 0
    assert np.abs(moved[known] / errors[known]).max() < 2.5
    assert np.median(errors[known] / usual[known]) < 1.5
