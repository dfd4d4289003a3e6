"""The time line of faults, and its page."""

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.collections import PolyCollection

from airpuck.data.trajectory import Span
from airpuck.evaluation.evaluate import evaluate
from airpuck.model.model_file import published_model
from airpuck.report.evaluation_report import fault_report
from airpuck.report.prediction_figures import error_timeline_figure, fault_color

from ..apparatus.synthetic_flights import fly

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


def test_each_cause_has_a_row_and_each_span_its_place(figure):
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


def test_causes_have_colours():
    causes = ("not armed", "radio out", "contact", "unexplained motion", "motor_a_1 stalled", "gap")
    assert len({fault_color(cause) for cause in causes}) == len(causes)


def test_the_page_lists_what_was_found(flight, tmp_path):
    marked = replace(flight, excluded=SPANS[2:3])
    found = (SPANS[0], SPANS[1], SPANS[3])
    page = fault_report(marked, found, published_model("M3"), tmp_path).read_text()
    for words in ("motor_a_1 stalled", "measured", "0.60", "windows overlap a fault"):
        assert words in page
    assert (tmp_path / "figures" / "fault_timeline.png").stat().st_size > 5000


def test_a_probability_is_never_rounded_to_certainty():
    assert SPANS[0].certainty == "0.99"
    assert SPANS[2].certainty == "measured"
