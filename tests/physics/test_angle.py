"""Differences of angles against their sines and cosines."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from airpuck.physics.angle import pose_difference, wrapped


@given(st.floats(-1e4, 1e4))
def test_a_wrapped_angle_points_the_same_way(angle):
    near = wrapped(np, np.array([angle]))
    assert np.abs(near) <= np.pi + 1e-9
    np.testing.assert_allclose(np.exp(1j * near), np.exp(1j * angle), atol=1e-9)


def test_only_the_yaw_of_a_state_repeats():
    state = np.array([10.0, -10.0, 3 * np.pi + 0.1, 10.0, 10.0, 10.0])
    expected = [10, -10, -np.pi + 0.1, 10, 10, 10]
    np.testing.assert_allclose(pose_difference(np, state, np.zeros(6)), expected)
    many = pose_difference(np, np.stack([state, state], axis=1), np.zeros((6, 1)))
    np.testing.assert_allclose(many, np.stack([expected, expected], axis=1))
