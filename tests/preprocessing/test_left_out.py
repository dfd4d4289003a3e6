"""Descriptions of what must not be used of a trajectory."""

from dataclasses import replace

import numpy as np
import pytest

from airpuck.data.trajectory import Span, Trajectory
from airpuck.preprocessing.quality import left_out_json, left_out_words

N = 1001
FLIGHT = Trajectory(
    time=np.arange(N) / 100,
    state=np.zeros((N, 6)),
    acceleration=np.zeros((N, 3)),
    command_time=np.zeros(1),
    command=np.zeros((1, 1)),
    propellers=("motor",),
)
SPANS = (
    Span(1.0, 1.1, "gap"),
    Span(3.0, 3.01, "gap"),
    *(Span(5.0 + k / 100, 5.01 + k / 100, "jumping pose") for k in range(14)),
    Span(8.0, 8.2, "motor stalled", 0.9),
)


def test_exclusions_are_counted_by_cause_and_the_longest_is_named():
    # Of 10 s, 0.1 s for the first gap, 0.01 s for the second, 0.14 s for the jumps, and 0.2 s.
    assert left_out_words(replace(FLIGHT, excluded=SPANS)) == (
        "left out: 4.5 % (2 gaps, 14 jumps, motor stalled; longest 0.20 s at 8.0 s)"
    )
    assert left_out_words(FLIGHT) == "left out: nothing"


def test_spans_outside_a_slice_do_not_count():
    part = replace(FLIGHT, excluded=SPANS).slice(0.0, 0.25)
    assert left_out_words(part) == "left out: 4.0 % (1 gap; longest 0.10 s at 1.0 s)"


def test_the_json_lists_every_span():
    figures = left_out_json(replace(FLIGHT, excluded=SPANS))
    assert len(figures["excluded"]) == len(SPANS)
    assert figures["usable"] == pytest.approx(0.955)


def test_a_gap_counts_by_duration_not_by_poses():
    time = FLIGHT.time[(FLIGHT.time < 1.0) | (FLIGHT.time > 6.0)]
    kept = {
        "time": time,
        "state": np.zeros((len(time), 6)),
        "acceleration": np.zeros((len(time), 3)),
    }
    lost = replace(FLIGHT, **kept, excluded=(Span(0.99, 6.01, "gap"), Span(5.0, 5.5, "contact")))
    assert left_out_words(lost).startswith("left out: 50.2 %")
