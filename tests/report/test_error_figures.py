"""How much of the squared error a few windows hold."""

import numpy as np
import pytest

from airpuck.report.error_figures import share_of_squares, worst_windows


def test_worst_windows_are_the_largest_whatever_their_sign():
    errors = np.array([1.0, -5.0, 2.0, 4.0, -3.0] + [0.0] * 20)
    assert np.flatnonzero(worst_windows(errors, 0.08)).tolist() == [1, 3]
    assert worst_windows(np.ones(3), 0.08).sum() == 1


def test_share_of_squares():
    assert share_of_squares(np.ones(100)) == pytest.approx(0.08)
    assert share_of_squares(np.array([1.0] + [0.0] * 99)) == 1.0
    assert share_of_squares(np.zeros(100)) == 0.08
