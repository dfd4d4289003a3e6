"""Paths between nodes."""

import numpy as np

from airpuck.planning.transcription import Path


def test_a_path_of_several_legs_is_resampled_leg_by_leg():
    durations, states = np.array([0.4, 1.0]), np.zeros((5, 12))
    states[:, 0] = [0.0, 0.2, 0.4, 0.9, 1.4]  # as the time passes
    commands = np.repeat(np.arange(4.0)[:, None], 6, axis=1)
    path = Path(durations, states, commands)
    np.testing.assert_allclose(path.times, states[:, 0])
    for intervals in (4, 10):
        finer = path.resampled(intervals)
        assert len(finer.commands) == 2 * intervals
        np.testing.assert_allclose(finer.times, finer.states[:, 0])
        np.testing.assert_allclose(finer.times[[0, intervals, -1]], [0.0, 0.4, 1.4])
        np.testing.assert_array_equal(finer.commands[:: intervals // 2, 0], range(4))
    assert path.resampled(2) is path
