"""The share of the squared error in a few windows."""

import numpy as np

from airpuck.report.prediction_figures import squares_held, worst_windows


def test_worst_windows_are_the_largest_whatever_their_sign():
    errors = np.array([1.0, -5.0, 2.0, 4.0, -3.0] + [0.0] * 20)
    assert np.flatnonzero(worst_windows(errors)).tolist() == [1, 3]
    assert worst_windows(np.ones(3)).sum() == 1


def test_what_marked_windows_hold_of_the_squares():
    errors = np.stack([np.ones(100), np.eye(100)[7], np.zeros(100)])
    assert squares_held(errors, worst_windows(errors)) == "8 / 100 / 0"
    assert squares_held(errors, np.arange(100) < 50) == "50 / 100 / 0"
