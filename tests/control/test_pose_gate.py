"""Which poses are accepted: one jumping frame, a lasting jump, clocks that go back."""

from dataclasses import replace

import numpy as np
import pytest

from airpuck.control.pose_gate import PoseGate, longest_pause
from airpuck.control.tuning import default_tuning
from airpuck.estimate.axis_filter import Noise
from airpuck.estimate.kalman import KalmanFilter
from airpuck.model.model_file import read_model

from ..apparatus.models import scaled

MODEL = read_model("paper:M3")
NOISE = Noise((1e-4, 1e-4, 1e-3), (0.1, 0.1, 2.0), (0.2, 0.2, 3.0))
FRAME = 1 / 240


class Craft:
    """A gate before a filter, and a clock."""

    def __init__(self):
        self.gate, self.filter = PoseGate(), KalmanFilter(MODEL, NOISE, compiled=False)
        self.time = 1.0

    def see(self, *pose, frames=1):
        for _ in range(frames):
            self.time += FRAME
            assert self.gate.offer(self.filter, self.time, np.array(pose, dtype=float))
        return self.gate.refusal(self.time)

    def place(self):
        return self.filter.predict(self.time).state[:3]


@pytest.fixture
def craft():
    found = Craft()
    assert found.see(0.2, 0.1, 0.3, frames=20) is None
    return found


def test_a_jump_that_persists_for_fifty_milliseconds_is_accepted(craft):
    began = craft.time + FRAME
    while craft.time < began + 0.045:
        assert craft.see(0.6, -0.2, 2.0) == "jumping pose"
    np.testing.assert_allclose(craft.place(), (0.2, 0.1, 0.3), atol=0.02)
    while craft.time < began + 0.05:
        found = craft.see(0.6, -0.2, 2.0)
    assert found is None
    np.testing.assert_allclose(craft.place(), (0.6, -0.2, 2.0), atol=1e-3)


def test_a_pose_is_stale_after_fifty_milliseconds_and_the_next_one_restarts(craft):
    assert craft.gate.refusal(craft.time + 0.0499) is None
    assert craft.gate.is_recent(craft.time - 0.0499)
    assert craft.gate.refusal(craft.time + 0.0501) == "stale pose"
    assert not craft.gate.is_recent(craft.time - 0.0501)
    # However far the craft has moved by then.
    craft.time += 0.06
    assert craft.see(-0.8, 0.3, -2.0) is None
    np.testing.assert_allclose(craft.place(), (-0.8, 0.3, -2.0), atol=1e-3)


def test_old_stamps_are_ignored_unless_the_clock_was_set_back(craft):
    gate, pose = craft.gate, np.array([0.9, 0.0, 0.0])
    for old in (0.0, 0.01, 0.049):
        assert not gate.offer(craft.filter, craft.time - old, pose)
    assert gate.refusal(craft.time) is None
    np.testing.assert_allclose(craft.place(), (0.2, 0.1, 0.3), atol=1e-3)
    craft.time -= 0.5
    assert craft.see(0.9, 0.0, 0.0) is None
    np.testing.assert_allclose(craft.place(), (0.9, 0.0, 0.0), atol=1e-3)


def test_the_longest_pause_depends_on_camera_and_craft():
    model, tuning = MODEL, default_tuning()
    assert longest_pause(model, tuning) == 0.05
    slow = scaled(model, 1e-3)
    pauses = [longest_pause(one, tuning.with_camera(8.0)) for one in (model, slow)]
    # Six frames of the slow camera for a slow craft; a fast one moves too far meanwhile.
    assert pauses[1] == pytest.approx(6 / 8)
    assert pauses[0] == pytest.approx(3 / 8)
    # A slow craft needs no more patience with a fast camera.
    assert longest_pause(slow, tuning.with_camera(240.0)) == 0.05
    # Without a stated rate, the rate of the model's recordings applies.
    assert longest_pause(replace(slow, fit={"sample_period_s": 0.125}), tuning) == pauses[1]
    assert longest_pause(slow, tuning.with_camera(8.0).with_camera(240.0)) == pauses[1]


class Spinning(KalmanFilter):
    """An estimate so fast that every third frame of a craft at rest agrees with it."""

    def __init__(self):
        self.poses, self.restarts = 0, []

    def pose(self, time, pose, gate):
        self.poses += 1
        return self.poses % 3 == 0

    def restart(self, time, pose):
        self.restarts.append(time)


def test_consistent_poses_restart_a_lost_estimate():
    gate, estimate = PoseGate(), Spinning()
    for k in range(25):
        gate.offer(estimate, k * FRAME, np.zeros(3))
    assert len(estimate.restarts) == 2
    assert 0.0499 < estimate.restarts[1] < 0.05 + 2 * FRAME


def test_a_moving_craft_is_steered_through_a_gap_of_250_ms_and_keeps_its_speed(craft):
    for k in range(60):
        assert craft.see(0.2 + 0.5 * k * FRAME, 0.1, 0.3) is None
    for waited, refused in ((0.04, None), (0.24, None), (0.26, "stale pose")):
        assert craft.gate.refusal(craft.time + waited, speed=0.5) == refused
    # One at rest has nothing to brake.
    assert craft.gate.refusal(craft.time + 0.06, speed=0.05) == "stale pose"
    craft.time += 0.2 - FRAME
    assert craft.see(0.2 + 0.5 * (59 * FRAME + 0.2), 0.1, 0.3) is None
    assert craft.filter.predict(craft.time).state[3] == pytest.approx(0.5, abs=0.05)
