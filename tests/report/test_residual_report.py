"""Figures of predictions on the page of `airpuck resid`."""

import numpy as np
import pytest

from airpuck.evaluation.prediction_bands import PredictionBands
from airpuck.report.residual_report import prediction_bands_figure


def bands(starts: list[float], horizon: float, error: float, half: float) -> PredictionBands:
    """A craft at rest at (0, 0, 0), with errors and bands that grow evenly to given values."""
    growth = np.linspace(0.05, 1, 20)[:, None, None] * np.ones((1, 3, len(starts)))
    start, time = np.array(starts), np.array(starts) + horizon * growth[:, 0]
    measured = np.zeros_like(growth)
    return PredictionBands("M3", start, time, -error * growth, measured, None, half * growth)


def limits(figure, column: int) -> np.ndarray:
    return np.array([axes.get_ylim() for axes in figure.axes[column::3]])


def test_a_band_that_would_hide_its_errors_is_cut_off():
    ahead = bands([0.0, 0.2, 0.4], 0.2, 1e-3, 2e-3)
    cut = prediction_bands_figure(ahead, bands([0.0], 0.6, 0.1, 10.0))
    # Five times the largest error, in mm, mm and rad; half of that around the poses in m, m, rad.
    expected = 5 * 0.1 * np.array([1e3, 1e3, 1.0])[:, None] * [-1, 1]
    np.testing.assert_allclose(limits(cut, 2), expected)
    np.testing.assert_allclose(limits(cut, 0), np.tile([-0.1 - 0.25, 0.25], (3, 1)))
    # Bands that fit are shown in full: bands of 0.2 s, and narrower bands of a simulation.
    assert limits(cut, 1)[0] == pytest.approx([-2.0, 2.0], rel=0.15)
    whole = prediction_bands_figure(ahead, bands([0.0], 0.6, 0.1, 0.4))
    assert (np.abs(limits(whole, 2)) >= 0.4 * np.array([1e3, 1e3, 1.0])[:, None]).all()
    assert (np.abs(limits(whole, 0)) >= 0.3).all()
    # Zero errors have no scale, and neither do unknown bands.
    prediction_bands_figure(ahead, bands([0.0], 0.6, 0.0, 10.0))
    unknown = prediction_bands_figure(ahead, bands([0.0], 0.6, 0.1, np.nan))
    assert np.isfinite(limits(unknown, 2)).all()
