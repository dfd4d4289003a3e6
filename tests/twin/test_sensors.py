"""The sensors, by statistics and by hand."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import kstest

from airpuck.twin.sensors import EPOCH_NS, Sensor
from airpuck.twin.settings import default_twin_settings

from ..apparatus.examples import examples

NOISE = (1e-3, 2e-3, 5e-3)


def sensor(seed=0, kind="pose", **values):
    defaults = {"rate": 240.0, "noise": (0.0,) * 3, "latency": (0.0, 0.0)}
    return Sensor(kind, **{**defaults, "rng": np.random.default_rng(seed), **values})


def clock(offset, drift, step=0.0):
    camera = default_twin_settings().motion_capture
    update = {"clock_offset_s": offset, "clock_drift": drift, "stamp_step_s": step}
    return camera.model_copy(update=update).stamped


def measured(one, count, truth=(0.1, 0.2, 0.3)):
    for _ in range(count):
        one.measure(np.array(truth))
    return one.stream()


def seconds(stamps):
    return (stamps - EPOCH_NS) * 1e-9


def test_sample_times_follow_the_rate_without_accumulating_rounding():
    one = sensor(rate=240.0)
    for k in range(24_000):
        assert one.due == k / 240
        one.measure(np.zeros(3))
    stream = one.stream()
    assert np.abs(seconds(stream.stamp_ns) - np.arange(24_000) / 240).max() < 1e-9


def test_noise_is_white_and_normal_with_the_stated_size():
    values = measured(sensor(noise=NOISE), 8000).values
    errors = (values - [0.1, 0.2, 0.3]) / NOISE
    for channel in errors.T:
        assert kstest(channel, "norm").pvalue > 1e-3
    np.testing.assert_allclose(errors.std(axis=0), 1, rtol=0.04)
    # There is no correlation between samples or between channels.
    assert np.abs((errors[1:] * errors[:-1]).mean(axis=0)).max() < 4 / math.sqrt(8000)
    assert np.abs(np.corrcoef(errors.T) - np.eye(3)).max() < 4 / math.sqrt(8000)


def test_the_callers_true_state_is_not_modified():
    truth = np.array([0.0, 0.0, 9.0])
    sensor(noise=NOISE).measure(truth)
    np.testing.assert_array_equal(truth, [0, 0, 9])


def test_yaw_is_wrapped_after_adding_noise():
    values = measured(sensor(noise=(0, 0, 0.01)), 500, (0.0, 0.0, 3 * math.pi)).values
    assert (np.abs(values[:, 2]) <= math.pi).all()
    assert (values[:, 2] > 0).any()
    assert (values[:, 2] < 0).any()
    np.testing.assert_allclose(np.abs(values[:, 2]), math.pi, atol=0.06)


def test_only_the_yaw_of_a_pose_is_wrapped():
    stream = measured(sensor(kind="imu", noise=(0.0,) * 6), 2, (1, 2, 9.81, 4, 5, 6))
    np.testing.assert_array_equal(stream.values, [[1, 2, 9.81, 4, 5, 6]] * 2)
    assert stream.columns == ("ax_m_s2", "ay_m_s2", "az_m_s2", "gx_rad_s", "gy_rad_s", "gz_rad_s")


def test_latency_is_constant_plus_exponential():
    # At 10 Hz no message catches up with the one before it.
    stream = measured(sensor(rate=10.0, latency=(0.002, 0.004)), 4000)
    late = (stream.received_ns - stream.stamp_ns) * 1e-9 - 0.002
    assert late.min() > -2e-9
    assert kstest(late, "expon", args=(0, 0.004)).pvalue > 1e-3


def test_messages_do_not_overtake_each_other():
    stream = measured(sensor(latency=(0.001, 0.02)), 2000)
    assert (np.diff(stream.received_ns) >= 0).all()
    assert (np.diff(stream.stamp_ns) > 0).all()
    assert (stream.received_ns - stream.stamp_ns >= 999_998).all()


@pytest.mark.parametrize("share", [0.0, 0.02, 0.5, 1.0])
def test_samples_are_dropped_at_the_stated_rate(share):
    count = len(measured(sensor(dropped=share), 5000))
    assert 1 - count / 5000 == pytest.approx(
        share, abs=4 * math.sqrt(share * (1 - share) / 5000) + 1e-12
    )


def test_dropping_does_not_change_the_other_samples():
    whole, part = (
        measured(sensor(4, rate=10.0, noise=NOISE, latency=(0.0, 1e-3), dropped=p), 300)
        for p in (0.0, 0.3)
    )
    kept = np.isin(whole.stamp_ns, part.stamp_ns)
    assert 150 < kept.sum() < 260
    np.testing.assert_array_equal(part.values, whole.values[kept])
    np.testing.assert_array_equal(part.received_ns, whole.received_ns[kept])


def test_gaps_contain_no_samples():
    stamps = seconds(measured(sensor(rate=100.0, gaps=((0.5, 0.75), (1.5, 1.6))), 200).stamp_ns)
    missing = np.setdiff1d(np.arange(200), np.rint(stamps * 100))
    np.testing.assert_array_equal(missing, [*range(50, 75), *range(150, 160)])


def test_the_camera_clock_has_offset_and_drift_but_the_recorder_does_not():
    stream = measured(sensor(stamped=clock(5.0, 1e-4), latency=(0.001, 0.0)), 240 * 20)
    time = np.arange(240 * 20) / 240
    np.testing.assert_allclose(seconds(stream.stamp_ns), 5.0 + 1.0001 * time, atol=2e-9)
    np.testing.assert_allclose(seconds(stream.received_ns), time + 0.001, atol=2e-9)


def test_stamps_in_whole_milliseconds_are_off_by_at_most_half_a_millisecond():
    stream = measured(sensor(stamped=clock(0.0, 0.0, step=1e-3), rate=120.0), 1200)
    stamps = 1e3 * seconds(stream.stamp_ns)
    np.testing.assert_allclose(stamps, np.rint(stamps), atol=1e-5)
    off = stamps - 1e3 * np.arange(1200) / 120
    assert np.abs(off).max() < 0.5
    assert np.std(off) == pytest.approx(0.29, abs=0.03)


def test_delivered_measurements_are_logged():
    one = sensor(noise=NOISE, latency=(0.001, 0.001), dropped=0.1, stamped=clock(5.0, 0.5))
    stream = measured(one, 200)
    found = one.arrived(math.inf)
    np.testing.assert_allclose([m.stamp for _, m in found], seconds(stream.stamp_ns), atol=1e-9)
    np.testing.assert_array_equal([m.values for _, m in found], stream.values)
    np.testing.assert_allclose([t for t, _ in found], seconds(stream.received_ns), atol=1e-9)
    assert {m.kind for _, m in found} == {"pose"}


@examples(50)
@given(
    st.integers(0, 10**6),
    st.floats(0, 0.05),
    st.floats(0, 0.05),
    st.floats(0, 0.9),
    st.lists(st.floats(0, 0.1), min_size=1, max_size=20),
)
def test_each_measurement_is_delivered_once_and_not_before_it_arrives(
    seed, least, jitter, dropped, waits
):
    one = sensor(seed, latency=(least, jitter), dropped=dropped)
    delivered = []
    for now in [*np.cumsum(waits), 1e3]:
        while one.due <= min(now, 3.0):
            one.measure(np.zeros(3))
        for arrival, measurement in one.arrived(now):
            assert measurement.stamp + least - 1e-12 <= arrival <= now
            delivered.append((measurement.stamp, arrival))
        assert one.arrived(now) == []
        waiting = seconds(one.stream().received_ns)
        assert (waiting <= now - 1e-8).sum() <= len(delivered) <= (waiting <= now + 1e-8).sum()
    stamps = [stamp for stamp, _ in delivered]
    assert stamps == sorted(set(stamps))
    assert len(stamps) == len(one.stream())


def test_a_sensor_without_measurements_has_an_empty_stream():
    assert len(sensor().stream()) == 0
    assert sensor().arrived(1.0) == []
