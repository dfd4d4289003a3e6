"""Descriptions of what must not be used of a trajectory."""

from dataclasses import replace

import numpy as np

from airpuck.data.left_out import left_out_json, left_out_words
from airpuck.data.trajectory import Span, Trajectory

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


def test_causes_are_counted_and_the_longest_is_named():
    # 11 samples of the first gap, 2 of the second, 15 of the jumps, 21 of the stall: 49 of 1001.
    assert left_out_words(replace(FLIGHT, excluded=SPANS)) == (
        "left out: 4.9 % (2 gaps, 14 jumps, motor stalled; longest 0.20 s at 8.0 s)"
    )
    assert left_out_words(FLIGHT) == "left out: nothing"


def test_spans_outside_a_part_do_not_count():
    part = replace(FLIGHT, excluded=SPANS).slice(0.0, 0.25)
    assert left_out_words(part) == "left out: 4.4 % (1 gap; longest 0.10 s at 1.0 s)"


def test_the_json_has_every_span():
    figures = left_out_json(replace(FLIGHT, excluded=SPANS))
    assert len(figures["excluded"]) == len(SPANS)
    assert figures["usable"] == 1 - 49 / N
