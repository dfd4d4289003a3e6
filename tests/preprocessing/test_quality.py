"""Checks of raw streams at their limits; test_pipeline tests their effect on a whole flight."""

import numpy as np
import pytest
from scipy.ndimage import median_filter

from airpuck.boundary.errors import InputError
from airpuck.preprocessing.quality import (
    check_commands,
    check_poses,
    drop_disorder,
    find_frozen,
    find_gaps,
    find_jumps,
    other_parts,
    steps_of_motion,
)
from airpuck.recording.stream import COLUMNS, Stream

from ..apparatus.refusals import rejected

RATE = 240.0


def check(yaw: np.ndarray, rate: float = RATE) -> None:
    """Check 10 s of a craft at the origin with this yaw."""
    time = np.arange(len(yaw)) / rate
    values = np.column_stack([np.zeros((len(yaw), 2)), yaw])
    stamp = np.rint(1e9 * time).astype(np.int64)
    check_poses(Stream(stamp, stamp, values, COLUMNS["pose"]), time)


@pytest.mark.parametrize("rate", [20.0, 100.0, RATE, 1000.0])
@pytest.mark.parametrize(("unit", "size"), [("ms", 1e3), ("us", 1e6), ("ns", 1e9)])
def test_a_time_unit_other_than_seconds_is_named(rate, unit, size):
    says = rf'implausible for motion capture.*gives {1 / rate:.3g} s: in the mapping.*\["{unit}"\]'
    with rejected(match=says, field="time"):
        check(np.zeros(100), rate / size)


def test_too_small_a_time_unit_in_a_mapping_is_corrected_by_its_factor():
    with pytest.raises(InputError, match="too small by a factor of about 1e3"):
        check(np.zeros(100), RATE * 1e3)
    with pytest.raises(InputError, match="check the column or field of the time"):
        check(np.zeros(3), RATE / 1e12)


def spinning(rate: float, poses: float = RATE) -> np.ndarray:
    """A yaw that grows evenly."""
    return rate * np.arange(round(10 * poses)) / poses


@pytest.mark.parametrize("poses", [50.0, RATE])
@pytest.mark.parametrize("sign", [-1, 1])
def test_continuous_yaw_in_degrees_is_recognised_by_its_speed(sign, poses):
    # Continuous, so nothing wraps at 360. 120 °/s is a slow turn, 120 rad/s more than any craft.
    with rejected(match=r"yaw reaches 1\d{3} and looks like deg", field="pose.orientation.yaw"):
        check(sign * spinning(120.0, poses), poses)


@pytest.mark.parametrize("poses", [50.0, RATE])
def test_a_hundred_radians_per_second_is_impossible(poses):
    check(spinning(99.0, poses), poses)
    with pytest.raises(InputError, match="looks like degrees"):
        check(spinning(101.0, poses), poses)


def test_many_turns_in_radians_are_not_degrees():
    check(spinning(25.0))
    check(-spinning(25.0))
    check(np.array([20.0]))  # one pose has no speed


def test_at_most_a_tenth_of_the_frames_may_be_outliers():
    # A wrapped yaw of a fast craft jumps by 2π, which is 1500 rad/s between two frames, and a yaw
    # that starts three turns up is larger than one turn: still radians.
    wrapped = (spinning(25.0) + np.pi) % (2 * np.pi) - np.pi
    assert (np.abs(np.diff(wrapped)) * RATE > 100).sum() > 30
    check(wrapped + 6 * np.pi)


def test_wrapped_degrees_are_recognised_by_their_jumps():
    with pytest.raises(InputError, match="looks like degrees"):
        check((spinning(50.0) + 180) % 360 - 180)


def test_fast_noise_within_one_turn_is_not_called_degrees():
    # 0.9 rad back and forth between frames: nonsense, but not due to another unit.
    check(0.45 * (-1.0) ** np.arange(2400))


def moving(seed: int = 0, rate: float = RATE) -> tuple[np.ndarray, np.ndarray]:
    """10 s of a fast craft with camera noise, and its times."""
    time = np.arange(round(10 * rate)) / rate
    path = np.column_stack([0.5 * np.sin(2 * time), 0.3 * np.cos(3 * time), 10 * np.sin(time)])
    noise = np.random.default_rng(seed).normal(size=path.shape) * [5e-5, 5e-5, 7e-4]
    return time, path + noise


def test_jumping_poses_are_excluded_around_the_jump():
    time, poses = moving()
    poses[1200:1300, 0] += 0.01  # there and back
    poses[2000:, 2] += 0.1  # for good
    spans = find_jumps(time, poses)
    assert [span.cause for span in spans] == ["jumping pose"] * 3
    for span, leap in zip(spans, (1200, 1300, 2000), strict=True):
        # Smoothing uses seven samples on both sides.
        assert time[leap - 8] < span.start <= time[leap - 7] < time[leap + 6] <= span.stop
        assert span.stop < time[leap + 8]


RATES = [50.0, 100.0, 120.0, RATE, 360.0]


@pytest.mark.parametrize("rate", RATES)
def test_jumps_are_found_at_every_rate(rate):
    time, poses = moving(rate=rate)
    middle, late = len(time) // 2, round(0.8 * len(time))
    poses[middle, 1] -= 0.02
    poses[late:, 2] += 0.3
    spans = find_jumps(time, poses)
    assert len(spans) == 2
    for span, leap in zip(spans, (middle, late), strict=True):
        # Smoothing for accelerations uses 31 ms on both sides.
        assert span.start < time[leap] <= span.stop
        assert span.stop - span.start < 0.08 + 1 / rate


@pytest.mark.parametrize("rate", RATES)
@pytest.mark.parametrize("seed", range(5))
def test_motion_noise_and_collisions_are_not_jumps(seed, rate):
    time, poses = moving(seed, rate)
    # A rail reverses 1.2 m/s within one frame, and changes the spin by 20 rad/s.
    after = np.clip(time - 5.001, 0, None)
    poses[:, 0] -= 2.4 * after
    poses[:, 2] += 20 * after
    assert find_jumps(time, poses) == ()


@pytest.mark.parametrize("count", [10, 11, 12, 40_000])
def test_jumps_agree_with_a_running_median(count):
    """Jumps at the limit, and whether SciPy's median filter finds them."""
    time = np.arange(count) / RATE
    rng = np.random.default_rng(2)
    poses = np.cumsum(rng.standard_t(1.5, size=(count, 3)), axis=0) * [1e-4, 1e-4, 1e-2]
    rate = np.diff(poses, axis=0) * RATE
    leap = np.abs(rate - median_filter(rate, (11, 1), mode="nearest")) / RATE
    limit = np.maximum(10 * np.median(leap, axis=0) / 0.6745, (1e-3, 1e-3, 0.02))
    spoilt = np.zeros(count, dtype=bool)
    for before in np.flatnonzero((leap > limit).any(axis=1)):
        spoilt[max(before - 6, 0) : before + 8] = True
    marked = np.zeros(count, dtype=bool)
    for span in find_jumps(time, poses):
        marked |= (time >= span.start) & (time <= span.stop)
    np.testing.assert_array_equal(marked, spoilt & (count >= 11))


def test_a_thinned_stream_has_gaps_only_where_poses_are_lost():
    time = np.rint(np.arange(0, 10, 0.01) * RATE) / RATE
    assert find_gaps(time, 0.015) == ()
    (gap,) = find_gaps(np.delete(time, 500), 0.015)
    assert gap.start < 5.0 < gap.stop


@pytest.mark.parametrize(("rate", "least"), [(50.0, 3), (120.0, 3), (RATE, 5), (360.0, 8)])
def test_poses_count_as_frozen_after_the_same_time_at_any_rate(rate, least):
    time, poses = moving(rate=rate)
    poses[100 : 100 + least - 1] = poses[100]
    assert find_frozen(time, poses) == ()
    poses[100 : 100 + least] = poses[100]
    (span,) = find_frozen(time, poses)
    assert (span.start, span.stop) == (time[100], time[99 + least])


def test_motion_continuing_across_a_gap_is_not_a_jump():
    time, poses = moving()
    seen = np.delete(np.arange(len(time)), np.arange(1000, 1100))
    assert find_jumps(time[seen], poses[seen]) == ()


@pytest.mark.parametrize(
    ("unit", "step", "advice"),
    [(1e3, "10", 'command = {units = ["ms"]}'), (1e-3, "1e-05", "too small by a factor of about")],
)
def test_a_wrong_time_unit_of_commands_is_reported(unit, step, advice):
    time = unit * np.arange(100) / 100.0
    stamp = np.rint(1e9 * time).astype(np.int64)
    stream = Stream(stamp, stamp, np.full((100, 2), 0.3), ("left", "right"))
    with rejected(advice, match=f"commands come every {step} s", field="time"):
        check_commands(stream, time)
    # A few commands that were logged only when they changed do not indicate a wrong unit.
    few = Stream(stamp[:9], stamp[:9], stream.values[:9], stream.columns)
    check_commands(few, np.arange(9) * 30.0)


def test_a_clock_set_back_is_distinguished_from_a_late_message():
    time, none = np.arange(1000) / 100.0, np.zeros((1000, 1))
    back = np.where(np.arange(1000) < 400, time, time - 0.03)
    found = drop_disorder(back, none, "command")
    assert found.breaks == (3.99,)
    assert "the clock of the commands is set back by 30 ms after 3.990 s" in found.warnings
    late = time.copy()
    late[[400, 401]] = late[[401, 400]]
    assert drop_disorder(late, none, "command").breaks == ()


@pytest.mark.parametrize("first", [100, 500])
def test_a_clock_set_far_back_is_an_error(first):
    time = np.arange(1000) / 100.0
    time[first:] -= 600.0
    with pytest.raises(InputError, match=f"{1000 - first} of 1000 commands .* row {first + 1} on"):
        drop_disorder(time, np.zeros((1000, 1)), "command")


def test_duplicated_rows_are_dropped():
    time = np.tile(np.arange(1000) / 100.0, 2)
    found = drop_disorder(time, np.zeros((2000, 1)), "command")
    assert len(found.time) == 1000
    assert found.breaks == ()


@pytest.mark.parametrize("rate", [100.0, 120.0, RATE])
@pytest.mark.parametrize("seed", range(5))
def test_the_motion_distinguishes_a_clock_step_from_lost_frames(seed, rate):
    time, poses = moving(seed, rate)
    lost = np.full(len(time), False)
    single = np.random.default_rng(seed).random(len(time)) < 0.05
    for begin in np.arange(0.5, 10.0, 1.0):
        lost |= (time > begin) & (time < begin + 0.03)
        single[(time > begin - 0.2) & (time < begin + 0.2)] = False
    assert steps_of_motion(time[~lost & ~single], poses[~lost & ~single]) == {}
    stepped = time + 0.03 * (time > 7.2)
    single[(time > 7.0) & (time < 7.4)] = False
    ((after, step),) = steps_of_motion(stepped[~single], poses[~single]).items()
    assert after == pytest.approx(7.2, abs=1.01 / rate)
    assert step == pytest.approx(0.03, abs=1e-6)


def test_only_the_longest_segment_between_clock_steps_is_kept():
    spans = other_parts(np.arange(0.0, 10.0, 0.1), [7.0, 2.0])
    assert [(span.start, span.stop) for span in spans] == [(0.0, 2.0), (7.0, 9.9)]
    assert {span.cause for span in spans} == {"clock step"}
    assert other_parts(np.arange(0.0, 10.0, 0.1), []) == ()
