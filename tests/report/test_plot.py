"""`airpuck.plot`: the report's figures in a user's axes."""

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.figure import Figure

import airpuck
from airpuck.boundary.errors import InputError
from airpuck.model.model_file import published_model

from ..apparatus.synthetic_flights import fly

M3 = published_model("M3")


@pytest.fixture(scope="module")
def flown():
    trajectory = fly(M3, 3.0)
    return trajectory, airpuck.compare([M3, published_model("M0")], trajectory)


def test_the_thrust_curves_of_the_model_are_drawn():
    axes = Figure().add_subplot()
    assert airpuck.plot.thrust(M3, axes) is axes
    assert len(axes.lines) == 6
    full = [line.get_ydata()[-1] for line in axes.lines]
    np.testing.assert_allclose(full, M3.parameters.thrust.sum(axis=1))


def test_the_errors_over_the_horizon_match_the_evaluation(flown):
    panels = list(Figure().subplots(1, 3))
    airpuck.plot.horizon(flown[1], panels)
    for channel, (axes, factor) in enumerate(zip(panels, (1e3, 1e3, 1.0), strict=True)):
        for line, evaluation in zip(axes.lines, flown[1], strict=False):
            expected = factor * evaluation.rmse_over_horizon[:, channel]
            np.testing.assert_allclose(line.get_ydata(), expected)


def test_all_plots_use_given_axes_or_a_new_figure(flown):
    trajectory, evaluations = flown
    figure = Figure()
    left, right = figure.subfigures(1, 2)
    assert airpuck.plot.predictions(trajectory, evaluations[0], left) is left
    assert len(left.axes) == 6 and not right.axes
    (axes,) = [right.add_subplot()]
    airpuck.plot.path(trajectory, M3.vehicle, axes)
    assert axes.collections
    with mpl.rc_context({"backend": "agg"}):
        panels = airpuck.plot.errors(evaluations)
        assert len(panels) == 3 and panels[0].figure is panels[2].figure


def test_a_wrong_number_of_axes_is_rejected(flown):
    with pytest.raises(InputError, match="needs 3 matplotlib axes, not 1"):
        airpuck.plot.horizon(flown[1], Figure().add_subplot())


@pytest.mark.slow
def test_flights_are_drawn_from_above():
    points = airpuck.SetPoints([0.0], [(0.1, 0.0, 0.0)])
    flown = airpuck.tracking_study([M3], M3, set_points=points, dwell=0.2)
    figure = airpuck.plot.path_figure(flown)
    assert [axes.get_title(loc="left") for axes in figure.axes] == [flown[0].label]
