from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from airpuck.live.timing import Histogram, LoopTiming

DURATIONS = st.lists(st.floats(0, 0.049), min_size=1, max_size=50)


@given(DURATIONS, st.sampled_from([1.0, 50.0, 99.0, 100.0]))
def test_percentiles_are_those_of_numpy_to_ten_microseconds(durations, percent):
    histogram = Histogram()
    for duration in durations:
        histogram.add(duration)
    expected = np.percentile(durations, percent, method="inverted_cdf")
    assert expected <= histogram.percentile(percent) + 1e-12
    assert histogram.percentile(percent) <= expected + 1.001e-5


def test_of_nothing_there_is_no_percentile_and_beyond_the_last_bin_stands_the_longest():
    histogram = Histogram()
    assert math.isnan(histogram.percentile(50))
    histogram.add(3.0)
    assert histogram.percentile(50) == 3.0


def test_a_loop_that_keeps_its_time_is_not_warned_of():
    timing = LoopTiming(0.01)
    for k in range(100):
        timing.add(k * 0.01, k * 0.01 + 5e-4, k * 0.01 - 2e-3)
    figures = timing.to_json()
    assert figures["periods"] == 100
    assert figures["missed_deadlines"] == 0
    assert figures["pose_to_command_ms"]["p50"] == pytest.approx(0.5, abs=0.011)
    assert figures["pose_age_ms"]["p99"] == pytest.approx(2.5, abs=0.011)
    assert figures["period_jitter_ms"]["max"] < 0.01
    assert timing.warning() is None


def test_periods_that_were_left_out_are_missed():
    timing = LoopTiming(0.01)
    for k in (0, 1, 2, 7, 8):
        timing.add(k * 0.01, k * 0.01 + 5e-4, None)
    assert timing.missed == 4
    assert timing.warning() == (
        "the loop is late: period jitter 40.0 ms, 4 missed deadlines (99th percentiles)"
    )


def test_an_action_that_is_late_by_less_than_the_deadline_misses_nothing():
    timing = LoopTiming(0.01)
    for k, late in enumerate([5e-4, 7e-3, 5e-4, 9e-3, 5e-4]):
        timing.add(k * 0.01, k * 0.01 + late, None)
    assert timing.missed == 0
    # Due at 50 ms, done at 85 ms: late itself, and two after it, due at 60 and 70 ms, left out.
    timing.add(0.05, 0.085, None)
    timing.add(0.08, 0.086, None)
    assert timing.missed == 3
