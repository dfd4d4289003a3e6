"""Figures of predictions, typical stretches, paths, the time line of faults, and worst windows."""

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.collections import LineCollection, PolyCollection

from airpuck import PredictionBands, Span
from airpuck.evaluation.evaluate import evaluate
from airpuck.model.model_file import published_model
from airpuck.report.evaluation_report import fault_report
from airpuck.report.prediction_figures import (
    SHOWN_S,
    error_timeline_figure,
    fault_color,
    path_figure,
    prediction_figure,
    squares_held,
    typical_stretch,
    worst_windows,
)
from airpuck.report.residual_report import prediction_bands_figure

from ..apparatus.synthetic_flights import fly


def test_worst_windows_have_the_largest_absolute_errors():
    errors = np.array([1.0, -5.0, 2.0, 4.0, -3.0] + [0.0] * 20)
    assert np.flatnonzero(worst_windows(errors)).tolist() == [1, 3]
    assert worst_windows(np.ones(3)).sum() == 1


def test_marked_windows_state_their_share_of_squared_errors():
    errors = np.stack([np.ones(100), np.eye(100)[7], np.zeros(100)])
    assert squares_held(errors, worst_windows(errors)) == "8 / 100 / 0"
    assert squares_held(errors, np.arange(100) < 50) == "50 / 100 / 0"


def test_predictions_are_drawn_at_their_predicted_places(judged):
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


def test_the_shown_stretch_has_typical_errors(judged):
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
def test_the_path_follows_the_poses_and_is_interrupted_at_exclusions(judged, study, gap):
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


SPANS = (
    Span(0.0, 0.8, "not armed", 0.999),
    Span(2.0, 2.2, "motor_a_1 stalled", 0.6),
    Span(3.0, 3.1, "gap"),
    Span(4.0, 4.3, "motor_a_1 stalled", 0.97),
)


@pytest.fixture(scope="module")
def flight():
    return fly(published_model("M3"), duration=6.0)


@pytest.fixture(scope="module")
def figure(flight):
    evaluation = evaluate(published_model("M3"), flight)
    return error_timeline_figure(evaluation, SPANS)


def test_each_cause_has_a_row_and_each_span_its_position(figure):
    top = figure.axes[0]
    rows = [label.get_text() for label in top.get_yticklabels()]
    assert rows == ["not armed", "motor_a_1 stalled", "gap"]
    bars = [c for c in top.collections if isinstance(c, PolyCollection)]
    for span, bar in zip(SPANS, bars, strict=True):
        (path,) = bar.get_paths()
        x, y = path.vertices[:, 0], path.vertices[:, 1]
        assert (x.min(), x.max()) == pytest.approx((span.start, span.stop))
        assert np.mean([y.min(), y.max()]) == pytest.approx(rows.index(span.cause))
    # Less certain faults are paler.
    assert bars[1].get_alpha() < bars[3].get_alpha() < bars[2].get_alpha() == 1
    assert {text.get_text() for text in top.texts} == {"0.99", "0.60", "0.97"}


def test_causes_have_distinct_colours():
    causes = ("not armed", "radio out", "contact", "unexplained motion", "motor_a_1 stalled", "gap")
    assert len({fault_color(cause) for cause in causes}) == len(causes)


def test_the_page_lists_the_findings(flight, tmp_path):
    marked = replace(flight, excluded=SPANS[2:3])
    found = (SPANS[0], SPANS[1], SPANS[3])
    page = fault_report(marked, found, published_model("M3"), tmp_path).read_text()
    for words in ("motor_a_1 stalled", "measured", "0.60", "windows overlap a fault"):
        assert words in page
    assert (tmp_path / "figures" / "fault_timeline.png").stat().st_size > 5000


def test_a_probability_is_never_rounded_to_certainty():
    assert SPANS[0].certainty == "0.99"
    assert SPANS[2].certainty == "measured"


def bands(starts: list[float], horizon: float, error: float, half: float) -> PredictionBands:
    """A craft at rest at (0, 0, 0), with errors and bands that grow evenly to given values."""
    growth = np.linspace(0.05, 1, 20)[:, None, None] * np.ones((1, 3, len(starts)))
    start, time = np.array(starts), np.array(starts) + horizon * growth[:, 0]
    measured = np.zeros_like(growth)
    return PredictionBands("M3", start, time, -error * growth, measured, None, half * growth)


def limits(figure, column: int) -> np.ndarray:
    return np.array([axes.get_ylim() for axes in figure.axes[column::3]])


def test_a_band_that_would_hide_its_errors_is_clipped():
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
