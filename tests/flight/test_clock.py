import math
import time

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from airpuck.flight.clock import Clock, Histogram, LoopTiming, StampClock

RNG = np.random.default_rng(1)


def arrivals(start, stop, rate=240.0):
    """Stamps and arrivals of a sender on the same clock, 0.5 to 2.5 ms late."""
    stamps = np.arange(start, stop, 1 / rate)
    return stamps, stamps + 5e-4 + 2e-3 * RNG.random(len(stamps))


def placed(clock, stamps, arrived):
    return [clock.time(s, a) for s, a in zip(stamps, arrived, strict=True)]


def test_stamps_of_a_sender_on_the_same_clock_are_used():
    stamps, arrived = arrivals(0.0, 5.0)
    assert placed(StampClock(), stamps, arrived) == stamps.tolist()


@pytest.mark.parametrize("ahead", [-3600.0, -0.5, 0.5, 1e6])
def test_another_clock_is_trusted_after_half_a_second(ahead):
    stamps, arrived = arrivals(0.0, 3.0)
    times = placed(StampClock(), stamps + ahead, arrived)
    first = next(k for k, t in enumerate(times) if t is not None)
    assert stamps[first] == pytest.approx(0.5, abs=0.01)
    # The true time is the stamp before the clock was set wrong; the least latency is 0.5 ms.
    errors = np.array(times[first:]) - stamps[first:]
    assert np.abs(errors - 5e-4).max() < 2e-4


def test_a_drifting_clock_is_followed():
    stamps, arrived = arrivals(0.0, 120.0, rate=50.0)
    wrong = stamps * (1 + 200e-6) + 10.0
    times = placed(StampClock(), wrong, arrived)
    late = [(t, s) for t, s in zip(times, stamps, strict=True) if s > 60 and t is not None]
    assert len(late) > 2900
    assert max(abs(t - s) for t, s in late) < 3e-3  # 12 ms without


def test_single_wrong_stamps_are_ignored():
    clock = StampClock()
    stamps, arrived = arrivals(0.0, 2.0)
    bad = np.arange(len(stamps)) % 10 == 3
    given = np.where(bad, stamps + RNG.uniform(-1e6, 1e6, len(stamps)), stamps)
    times = placed(clock, given, arrived)
    assert [t is None for t in times] == bad.tolist()
    assert clock.offset == 0.0


def test_inconsistent_stamps_are_never_trusted():
    _, arrived = arrivals(0.0, 5.0)
    given = RNG.uniform(-1e6, 1e6, len(arrived))
    assert set(placed(StampClock(), given, arrived)) == {None}


def test_a_non_finite_stamp_is_ignored():
    assert StampClock().time(float("nan"), 1.0) is None


def test_stamps_convert_back_to_clock_time():
    clock = Clock()
    stamp = clock.stamp_ns(clock.now)
    assert abs(stamp - time.time_ns()) < 1e8
    assert clock.of(stamp) == pytest.approx(clock.now, abs=0.1)
    due = clock.now + 0.02
    clock.sleep_until(due)
    assert clock.now >= due
    clock.sleep_until(0.0)  # long past: returns at once


# Timing of a loop ---------------------------------------------------------------------------------

DURATIONS = st.lists(st.floats(0, 0.049), min_size=1, max_size=50)


@given(DURATIONS, st.sampled_from([1.0, 50.0, 99.0, 100.0]))
def test_percentiles_match_numpy_to_ten_microseconds(durations, percent):
    histogram = Histogram()
    for duration in durations:
        histogram.add(duration)
    expected = np.percentile(durations, percent, method="inverted_cdf")
    assert expected <= histogram.percentile(percent) + 1e-12
    assert histogram.percentile(percent) <= expected + 1.001e-5


def test_an_empty_histogram_has_no_percentile_and_overflow_reports_the_maximum():
    histogram = Histogram()
    assert math.isnan(histogram.percentile(50))
    histogram.add(3.0)
    assert histogram.percentile(50) == 3.0


def test_a_punctual_loop_causes_no_warning():
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


def test_skipped_periods_count_as_missed():
    timing = LoopTiming(0.01)
    for k in (0, 1, 2, 7, 8):
        timing.add(k * 0.01, k * 0.01 + 5e-4, None)
    assert timing.missed == 4
    assert timing.warning() == (
        "the loop is late: period jitter 40.0 ms, 4 missed deadlines (99th percentiles)"
    )


def test_an_action_within_the_deadline_is_not_missed():
    timing = LoopTiming(0.01)
    for k, late in enumerate([5e-4, 7e-3, 5e-4, 9e-3, 5e-4]):
        timing.add(k * 0.01, k * 0.01 + late, None)
    assert timing.missed == 0
    # Due at 50 ms, done at 85 ms: late itself, and the two due at 60 and 70 ms are skipped.
    timing.add(0.05, 0.085, None)
    timing.add(0.08, 0.086, None)
    assert timing.missed == 3
