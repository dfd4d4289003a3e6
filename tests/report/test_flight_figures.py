"""Figures of a flight: measured and predicted poses, a typical stretch, the path."""

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.collections import LineCollection

from airpuck.report.prediction_figures import (
    SHOWN_S,
    path_figure,
    prediction_figure,
    typical_stretch,
)


def test_predictions_are_drawn_where_the_model_put_them(judged):
    evaluation = judged.evaluations[3]
    figure = prediction_figure(judged.trajectory, [evaluation])
    begin, stop = typical_stretch(evaluation)
    for channel in range(3):
        pose, error = figure.axes[2 * channel : 2 * channel + 2]
        measured, *lines = pose.lines
        time = judged.trajectory.time
        shown = time[(time >= begin) & (time <= stop)]
        np.testing.assert_array_equal(measured.get_xdata(), shown)
        predictions = [line for line in lines if len(line.get_xdata()) > 1]
        length = len(evaluation.errors) * evaluation.sample_period
        inside = (evaluation.start >= begin) & (evaluation.start <= stop - length)
        assert len(predictions) == inside.sum() > 10
        ends = np.array([line.get_ydata()[-1] for line in predictions])
        truth = np.interp(
            evaluation.start[inside] + length,
            judged.trajectory.time,
            judged.trajectory.state[:, channel],
        )
        np.testing.assert_allclose(
            ends - truth, evaluation.errors[-1, channel, inside], atol=1e-6, rtol=1e-3
        )
        factor = 1 if channel == 2 else 1e3
        drawn = [line.get_ydata()[-1] for line in error.lines[1:]]
        np.testing.assert_allclose(drawn, factor * evaluation.errors[-1, channel, inside])


def test_the_seconds_shown_have_errors_of_the_usual_size(judged):
    found = judged.evaluations[3]
    windows = 400
    start = 0.3 * np.arange(windows)
    errors = np.ones((len(found.errors), 3, windows))
    errors[:, :, start > 60] = 20.0  # large errors in most of the second half
    errors[:, :, start > 100] = 400.0
    begin, stop = typical_stretch(replace(found, errors=errors, start=start))
    assert stop - begin == SHOWN_S
    assert stop < 60 + 2 * SHOWN_S


@pytest.mark.parametrize("gap", [False, True])
def test_the_way_is_that_of_the_poses_and_does_not_cross_what_is_left_out(judged, study, gap):
    from airpuck.data.trajectory import Span

    flight = judged.trajectory
    if gap:
        flight = replace(flight, excluded=(Span(3.0, 4.0, "gap"),))
    (way,) = (
        c
        for c in path_figure(flight, study.models[0].vehicle).axes[0].collections
        if isinstance(c, LineCollection)
    )
    pieces = np.array(way.get_segments())
    assert len(pieces) == len(flight) - 1 - (np.sum(~flight.usable) if gap else 0) - gap
    assert np.linalg.norm(np.diff(pieces, axis=1), axis=2).max() < 0.05
    np.testing.assert_allclose(pieces[0, 0], flight.state[0, :2])
    np.testing.assert_allclose(pieces[-1, 1], flight.state[-1, :2])
