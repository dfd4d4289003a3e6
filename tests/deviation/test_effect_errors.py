"""Systematic errors of a model: valves faster than the poses, and chance."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from airpuck.craft.vehicle import read_vehicle
from airpuck.deviation.effect_errors import effect_errors
from airpuck.model.model_file import nominal_model
from airpuck.preprocessing.pipeline import preprocess
from airpuck.recording.stream import Recording

ATMOS = Path(__file__).parents[2] / "examples/free_flyers/atmos.toml"
OPPOSITE = [1, 0, 3, 2, 5, 4, 7, 6]
STEP, HELD, SEEN, DELAY = 0.005, 80, 12, 0.03


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
def test_the_timing_of_valves_faster_than_the_poses_is_known():
    model, trajectory = flown()
    errors = effect_errors(model, trajectory)
    assert errors is not None
    assert errors.later_error < 0.003
    assert abs(errors.later) < 0.006  # 0.3 s off with one integration step between poses


@pytest.mark.slow
def test_chance_does_not_make_a_craft_stronger():
    # Every thruster seems to push sideways a little, in some direction that some motion can use.
    model, trajectory = flown(noise=5e-3)
    errors = effect_errors(model, trajectory)
    assert errors is not None
    assert errors.push.mean() > -0.08  # -0.13 with what chance adds
