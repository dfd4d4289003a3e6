"""Intervals in figures and tables."""

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.collections import LineCollection, PolyCollection

from airpuck.model.model_file import published_model
from airpuck.model.uncertainty import Uncertainty
from airpuck.report.fit_figures import main_rows, parameter_figure, thrust_figure

PLAIN = published_model("M3")


@pytest.fixture
def known():
    vector = PLAIN.parameters.to_vector()
    errors = np.where(PLAIN.free, 0.01 * np.abs(vector), np.nan)
    covariance = np.diag(np.nan_to_num(errors) ** 2)
    nothing = np.zeros((0, len(vector)))
    return replace(PLAIN, uncertainty=Uncertainty(vector, covariance, errors, nothing, 30, 2.0))


def bands(figure):
    return [c for axes in figure.axes for c in axes.collections if isinstance(c, PolyCollection)]


def test_thrust_curves_have_bands_where_they_are_known(known):
    assert not bands(thrust_figure([PLAIN]))
    changed = known.with_delay(0.03)
    assert not bands(thrust_figure([changed]))
    found = bands(thrust_figure([known]))
    assert len(found) == 6
    ends = found[0].get_paths()[0].vertices
    full = ends[np.isclose(ends[:, 0], 1.0), 1]
    reach = 2.0 * 0.01 * np.linalg.norm(PLAIN.parameters.thrust[0])
    middle = PLAIN.parameters.thrust[0].sum()
    assert full.min() == pytest.approx(middle - reach, rel=1e-6)
    assert full.max() == pytest.approx(middle + reach, rel=1e-6)


def test_ratios_have_intervals_where_they_are_known(known):
    def widths(model):
        axes = parameter_figure([model], {"M3": PLAIN}).axes[0]
        segments = [c.get_segments() for c in axes.collections if isinstance(c, LineCollection)]
        return np.ptp(np.array(segments[0])[:, :, 0], axis=1)

    # 2.0 errors of 1 % of each coefficient on both sides, in percent of the sum.
    curves = np.asarray(PLAIN.parameters.thrust)
    expected = 2 * 2.0 * np.linalg.norm(curves, axis=1) / curves.sum(axis=1)
    np.testing.assert_allclose(widths(known), expected, rtol=1e-4)
    # Changed after its fit: unknown.
    np.testing.assert_array_equal(widths(known.with_delay(0.03)), 0.0)


def test_the_table_has_the_standard_error(known):
    lag = next(row for row in main_rows([PLAIN, known]) if row.label == "τ")
    without, with_error = (cell.text for cell in lag.cells)
    assert "±" not in without
    assert with_error == f"{without} ± {0.01 * float(without):.2f}"
