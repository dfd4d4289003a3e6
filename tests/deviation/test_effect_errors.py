"""Systematic errors of a model: valves faster than the poses, and chance."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from airpuck.craft.vehicle import read_vehicle
from airpuck.deviation.effect_errors import effect_errors, timing_change
from airpuck.judgement.findings import clock_suspect, timing_suspect
from airpuck.model.model_file import nominal_model, published_model
from airpuck.preprocessing.pipeline import preprocess
from airpuck.recording.stream import Recording

from ..apparatus.synthetic_flights import edited, record

ATMOS = Path(__file__).parents[2] / "examples/free_flyers/atmos.toml"
OPPOSITE = [1, 0, 3, 2, 5, 4, 7, 6]
STEP, HELD, SEEN, DELAY = 0.005, 80, 12, 0.03


MODEL = published_model("M3")
WINDOWS, POSES = 60, 20


def flown(noise=5e-5):
    """A true model, and 40 s of its switches seen every 60 ms, with noise [m]."""
    vehicle = read_vehicle(ATMOS)
    start = nominal_model(vehicle)
    truth = replace(start.parameters, transport_delay=DELAY)
    free = truth.mask(frozenset({"transport_delay"}))
    model = replace(start, parameters=truth, free=free)
    random = np.random.default_rng(4)
    count = round(40 / STEP)
    command = (random.random((count // HELD, 8)) < 0.3).astype(float)
    command[1::2] = command[::2, OPPOSITE]  # so that the craft stays near its start
    moved = model.simulate(np.zeros(6), np.repeat(command, HELD, axis=0), STEP)
    time = STEP * np.arange(1, count + 1)[::SEEN]
    pose = moved[::SEEN, :3] + noise * random.normal(0, [1, 1, 4], (len(time), 3))
    sent = STEP * HELD * np.arange(count // HELD) - DELAY
    recording = Recording.from_arrays(time, pose, sent, command, propellers=vehicle.columns)
    return model, preprocess(recording, vehicle)


@pytest.mark.slow
def test_the_timing_of_valves_faster_than_the_frame_rate_is_estimated():
    model, trajectory = flown()
    errors = effect_errors(model, trajectory)
    assert errors is not None
    assert errors.later_error < 0.003
    assert abs(errors.later) < 0.006  # 0.3 s off with one integration step between poses


@pytest.mark.slow
def test_noise_does_not_make_a_craft_stronger():
    # Every thruster seems to push sideways a little, in some direction that some motion can use.
    model, trajectory = flown(noise=5e-3)
    errors = effect_errors(model, trajectory)
    assert errors is not None
    assert errors.push.mean() > -0.08  # -0.13 with what chance adds


def made_up(seed, change, cut):
    """Effects of four errors, the third a delay, and residuals with a delay that changes."""
    rng = np.random.default_rng(seed)
    columns = rng.normal(size=(WINDOWS, POSES, 3, 4))
    columns[..., 3] += 0.7 * columns[..., 2]
    late = np.where(np.arange(WINDOWS) < cut, 0.0, change)
    values = columns[..., 2] * late[:, None, None] + 5.0 * columns[..., 0]
    values = (values + rng.normal(size=values.shape)).reshape(-1, 3)
    columns = columns.reshape(-1, 3, 4)
    flat = columns.reshape(-1, 4)
    found = np.linalg.lstsq(flat, values.ravel(), rcond=None)[0]
    return columns, values - columns @ found


def clearest(seed, change, cut=40):
    timing = np.array([0.0, 0.0, 1.0, 0.0])
    start = 0.5 * np.arange(WINDOWS)
    return timing_change(*made_up(seed, change, cut), timing, start, 1.0)


@pytest.mark.parametrize("change", [-0.3, 0.3])
@pytest.mark.parametrize("cut", [16, 40])
def test_a_change_and_its_time_are_estimated(change, cut):
    found = [clearest(seed, change, cut) for seed in range(20)]
    assert np.median([abs(one.at - 0.5 * cut) for one in found]) <= 1.0
    errors = [(one.change - change) / one.error for one in found]
    assert abs(np.mean(errors)) < 1.0 and np.std(errors) < 1.6


def test_the_largest_of_all_chance_changes_is_not_significant():
    chances = [clearest(seed, 0.0).p_value for seed in range(200)]
    assert min(chances) > 1e-4
    assert clearest(0, 0.3).p_value < 1e-6


def stepping(step):
    """Return a recording whose cameras' clock steps in the middle, without times of arrival."""

    def edit(stamp, received, values):
        late = np.arange(len(stamp)) > len(stamp) // 2
        stamp = stamp + np.rint(1e9 * step * late).astype(np.int64)
        return stamp, stamp, values

    return preprocess(edited(record(duration=14.0, noise=5e-5), "pose", edit))


@pytest.mark.parametrize("step", [0.0, 0.02, 0.05])
def test_a_clock_that_steps_without_arrivals_makes_a_recording_suspect(step):
    trajectory = stepping(step)
    effects = effect_errors(MODEL, trajectory)
    findings = timing_suspect(MODEL, effects)
    assert bool(findings) == (step != 0.0)
    if step:
        assert effects.timing.change == pytest.approx(step, rel=0.35)
        assert findings[0].suspect


def test_a_clock_that_steps_back_without_arrivals_makes_a_recording_suspect():
    trajectory = stepping(-0.03)
    assert 6.5 < trajectory.usable.sum() * trajectory.sample_period < 7.5
    (finding,) = clock_suspect(MODEL, trajectory)
    assert finding.suspect and "A clock steps" in finding.cause
