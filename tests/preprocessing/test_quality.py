"""Checks of raw streams at their limits; what they do to a whole flight is in test_pipeline."""

import numpy as np
import pytest

from airpuck.errors import InputError
from airpuck.preprocessing.quality import check_poses
from airpuck.recording.stream import COLUMNS, Stream

RATE = 240.0


def check(yaw: np.ndarray, rate: float = RATE) -> None:
    """Check 10 s of a craft at the origin with this yaw."""
    time = np.arange(len(yaw)) / rate
    values = np.column_stack([np.zeros((len(yaw), 2)), yaw])
    stamp = np.rint(1e9 * time).astype(np.int64)
    check_poses(Stream(stamp, stamp, values, COLUMNS["pose"]), time, "flight")


def spinning(rate: float, poses: float = RATE) -> np.ndarray:
    """A yaw that grows evenly."""
    return rate * np.arange(round(10 * poses)) / poses


@pytest.mark.parametrize("poses", [50.0, RATE])
@pytest.mark.parametrize("sign", [-1, 1])
def test_a_continuous_yaw_in_degrees_is_told_by_its_speed(sign, poses):
    # Continuous, so nothing wraps at 360. 120 °/s is a slow turn, 120 rad/s more than any craft.
    with pytest.raises(InputError, match=r"yaw reaches 1\d{3} and looks like degrees") as caught:
        check(sign * spinning(120.0, poses), poses)
    assert caught.value.field == "pose.orientation.yaw"


@pytest.mark.parametrize("poses", [50.0, RATE])
def test_the_speed_that_no_craft_has_is_100_rad_per_second(poses):
    check(spinning(99.0, poses), poses)
    with pytest.raises(InputError, match="looks like degrees"):
        check(spinning(101.0, poses), poses)


def test_many_turns_in_radians_are_no_degrees():
    check(spinning(25.0))
    check(-spinning(25.0))


def test_nine_of_ten_frames_decide():
    # A wrapped yaw of a fast craft jumps by 2π, which is 1500 rad/s between two frames, and a yaw
    # that starts three turns up is larger than one turn: still radians.
    wrapped = (spinning(25.0) + np.pi) % (2 * np.pi) - np.pi
    assert (np.abs(np.diff(wrapped)) * RATE > 100).sum() > 30
    check(wrapped + 6 * np.pi)


def test_degrees_that_wrap_are_told_by_their_jumps():
    with pytest.raises(InputError, match="looks like degrees"):
        check((spinning(50.0) + 180) % 360 - 180)


def test_within_one_turn_fast_noise_is_not_called_degrees():
    # 0.9 rad to and fro between frames: nonsense, but not of another unit.
    check(0.45 * (-1.0) ** np.arange(2400))


def test_one_pose_has_no_speed():
    check(np.array([20.0]))
