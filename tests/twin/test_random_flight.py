"""Random flights: data with known truth."""

import numpy as np

from airpuck.model.rollout import rollout
from airpuck.model_file import published_model
from airpuck.twin.random_flight import random_flight, random_recording

MODEL = published_model("M3")


def test_states_are_the_models():
    flight = random_flight(MODEL, 2.0, seed=1)
    start = np.concatenate([flight.state[0], np.full(6, 0.03)])
    steps = rollout(np, MODEL.dynamics, start, flight.command[:-1], np.diff(flight.time))
    np.testing.assert_allclose(steps[:, :6], flight.state[1:], atol=1e-9)


def test_speeds_are_realistic_and_the_craft_stays_near():
    flight = random_flight(MODEL, 30.0, seed=2)
    x, y, _, vx, vy, spin = np.abs(flight.state).max(axis=0)
    assert max(x, y) < 0.5
    assert max(vx, vy) < 1.0
    assert 2 < spin < 30


def test_one_motor_of_each_pair_idles():
    command = random_flight(MODEL, 5.0, seed=3).command
    assert command.min() == 0.03
    assert command.max() <= 1
    np.testing.assert_array_equal(np.minimum(command[:, ::2], command[:, 1::2]), 0.03)


def test_the_seed_decides():
    first, again, other = (random_recording(MODEL, 1.0, seed) for seed in (1, 1, 2))
    assert first.streams == again.streams
    assert first.streams != other.streams


def test_a_recording_has_noise_wrapped_yaw_and_delayed_commands():
    flight = random_flight(MODEL, 10.0, seed=4)
    recording = random_recording(MODEL, 10.0, seed=4, delay=0.02, noise=1e-3)
    pose, command = recording["pose"], recording["command"]
    error = pose.values[:, :2] - flight.state[:, :2]
    assert abs(error.std() - 1e-3) < 1e-4
    assert np.abs(pose.values[:, 2]).max() <= np.pi
    assert pose.stamp_ns[0] - command.stamp_ns[0] == 20_000_000
    assert np.diff(command.stamp_ns).tolist() == [10_000_000] * 999
