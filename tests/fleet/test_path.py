"""Paths of a fleet: pieces, continuations, and the mean that a craft follows."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from airpuck.fleet.path import SMOOTHED, Following, Route, braked

finite = st.floats(-2.0, 2.0, allow_nan=False)


def stepped(offset, rate, durations, accelerations):
    """Integrate in many small steps, independently of the closed form."""
    for duration, acceleration in zip(durations, accelerations, strict=True):
        for _ in range(1000):
            offset += rate * duration / 1000 + acceleration * (duration / 1000) ** 2 / 2
            rate += acceleration * duration / 1000
    return offset, rate


def one_way(begin=0.0):
    """Return a path of a metre along x: one second of 1 m/s² each way, by hand."""
    durations = np.array([[1.0, 1.0], [1.0, 1.0], [1.0, 1.0]])
    accelerations = np.array([[1.0, -1.0], [0.0, 0.0], [0.0, 0.0]])
    return Route(begin, np.zeros(3), np.zeros(3), durations, accelerations)


def test_a_metre_from_rest_takes_two_seconds_at_one_metre_per_second_squared():
    durations, _ = braked(np.array(1.0), np.array(0.0), np.array(1.0), 9.0)
    assert durations.sum() == pytest.approx(2.0)
    assert durations[1] == 0


def test_a_speed_limit_is_kept_by_coasting():
    durations, accelerations = braked(np.array(1.0), np.array(0.0), np.array(1.0), 0.5)
    # Half a second to reach 0.5 m/s, over 0.125 m, and to stop; 0.75 m at that speed.
    np.testing.assert_allclose(durations, [0.5, 1.5, 0.5])
    np.testing.assert_allclose(accelerations, [-1.0, 0.0, 1.0])


@given(finite, finite, st.floats(0.1, 3.0), st.floats(0.3, 3.0))
def test_braking_always_ends_at_rest_at_the_target(offset, rate, push, fastest):
    durations, accelerations = braked(np.array(offset), np.array(rate), np.array(push), fastest)
    assert (durations >= 0).all()
    assert np.abs(accelerations).max() <= push * (1 + 1e-12)
    place, speed = stepped(offset, rate, durations, accelerations)
    assert place == pytest.approx(0.0, abs=1e-6)
    assert speed == pytest.approx(0.0, abs=1e-6)


def test_a_path_follows_its_segments_and_then_rests():
    path = one_way(begin=5.0)
    motion = path.moved(np.array([4.0, 5.5, 6.0, 7.0, 99.0]))
    np.testing.assert_allclose(motion.pose[:, 0], [0.0, 0.125, 0.5, 1.0, 1.0])
    np.testing.assert_allclose(motion.rate[:, 0], [0.0, 0.5, 1.0, 0.0, 0.0], atol=1e-12)
    assert path.end == 7.0
    np.testing.assert_allclose(path.rest, [1.0, 0.0, 0.0], atol=1e-12)
    assert path.push == pytest.approx(1.0)


def test_the_followed_state_is_the_recent_mean_of_the_path():
    reference = Following(one_way())
    for now in (0.02, 0.7, 1.01, 2.03, 4.0):
        before = np.linspace(now - SMOOTHED, now, 20001)
        mean = reference.path.moved(before)
        target = reference.at(now, 0.0)
        np.testing.assert_allclose(target.state[:3], mean.pose.mean(axis=0), atol=1e-6)
        np.testing.assert_allclose(target.state[3:], mean.rate.mean(axis=0), atol=1e-4)


def test_a_continuation_agrees_with_the_path_until_it_branches():
    path = one_way()
    start = path.moved(np.array([0.6]))
    durations, accelerations = braked(
        start.pose[0] - [0.2, 0.1, 0.3], start.rate[0], np.array([1.0, 1.0, 2.0]), 9.0
    )
    then = Route(0.6, start.pose[0], start.rate[0], durations, accelerations)
    changed = path.followed(0.3, 0.6, then)
    times = np.linspace(0.3, 0.6, 31)
    np.testing.assert_allclose(changed.moved(times).pose, path.moved(times).pose, atol=1e-12)
    np.testing.assert_allclose(changed.moved(times).rate, path.moved(times).rate, atol=1e-12)
    np.testing.assert_allclose(changed.rest, [0.2, 0.1, 0.3], atol=1e-9)
    later = np.linspace(0.6, 4.0, 50)
    np.testing.assert_allclose(changed.moved(later).pose, then.moved(later).pose, atol=1e-9)
