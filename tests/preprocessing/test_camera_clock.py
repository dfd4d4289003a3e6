"""The cameras' clock behind stamps made on arrival: frames of a known clock."""

from dataclasses import replace

import numpy as np
import pytest

from airpuck import InputError, PoseMapping, Recording, RecordingMapping, Stream
from airpuck.preprocessing.camera_clock import at_exposure
from airpuck.recording.stream import COLUMNS


def exposures(rate: float, share_lost: float = 0.0, seconds: float = 20.0) -> np.ndarray:
    """Times of the frames that were not lost [s]."""
    frames = np.arange(round(rate * seconds))
    return frames[np.random.default_rng(5).random(len(frames)) >= share_lost] / rate


def polled(time: np.ndarray) -> np.ndarray:
    """Arrivals at a client that looks every 10 ms, and stamps each pose when it gets it."""
    return np.ceil((time + 5e-4) / 0.01) * 0.01


def held_up(time: np.ndarray) -> np.ndarray:
    """Arrivals over a network that holds packets back ten times a second, for up to 30 ms."""
    rng = np.random.default_rng(6)
    arrival = time + 1e-3 + rng.exponential(5e-4, len(time))
    for begin in np.arange(0.05, time[-1], 0.1) + rng.uniform(0, 0.05):
        end = begin + rng.uniform(0, 0.03)
        arrival[(arrival > begin) & (arrival < end)] = end
    return arrival


def stamped(arrival: np.ndarray, values: np.ndarray | None = None, **stated) -> Stream:
    arrival = np.maximum.accumulate(arrival) + 3e-5 * np.arange(len(arrival)) / len(arrival)
    stamp = np.rint(1e9 * arrival).astype(np.int64)
    if values is None:
        values = np.random.default_rng(7).normal(size=(len(stamp), 3))
    return Stream(stamp, stamp, values, COLUMNS["pose"], **stated)


def moving(time: np.ndarray) -> np.ndarray:
    """Poses of a craft that flies to and fro, measured to 0.1 mm and 2 mrad."""
    noise = np.random.default_rng(8).normal(size=(len(time), 3)) * (1e-4, 1e-4, 2e-3)
    curve = np.column_stack([np.sin(1.3 * time), np.cos(0.9 * time), 2 * np.sin(0.7 * time)])
    return 0.5 * curve + noise


def rate_found(warning: str) -> float:
    """The cameras' rate that a warning states [Hz]."""
    return float(warning.split(" Hz")[0].split()[-1])


def off(stream: Stream, time: np.ndarray) -> np.ndarray:
    """Errors of the times, up to a common latency [s]."""
    late = stream.stamp_ns / 1e9 - time
    return late - np.median(late)


@pytest.mark.parametrize("arrive", [polled, held_up])
@pytest.mark.parametrize("rate", [120.0, 240.0])
@pytest.mark.parametrize("share_lost", [0.0, 0.02])
def test_arrival_stamps_are_converted_to_exposure_times(arrive, rate, share_lost):
    time = exposures(rate, share_lost)
    raw = stamped(arrive(time), moving(time))
    found, warnings = at_exposure(raw)
    assert "stamped on arrival" in warnings[0]
    assert rate_found(warnings[0]) == pytest.approx(rate, rel=2e-4)
    error = off(found, time)
    assert np.mean(np.abs(error) > 0.1 / rate) < (0.002 if not share_lost else 0.01)
    assert error.std() < 0.4 * off(raw, time).std()


@pytest.mark.parametrize("rate", [120.0, 240.0])
def test_the_motion_reveals_which_of_two_frames_is_lost(rate):
    time = exposures(rate, 0.2)
    found, _ = at_exposure(stamped(polled(time), moving(time)))
    assert np.mean(np.abs(off(found, time)) > 0.1 / rate) < 0.004


@pytest.mark.parametrize("share_lost", [0.0, 0.05])
def test_a_client_that_polls_at_about_the_camera_rate_is_recognised(share_lost):
    time = exposures(240.0, share_lost)
    arrival = np.ceil((time + 5e-4) / 0.004) * 0.004
    found, warnings = at_exposure(stamped(arrival, moving(time)))
    assert "stamped on arrival" in warnings[0]
    assert np.mean(np.abs(off(found, time)) > 0.1 / 240) < 0.01


def in_bursts(time: np.ndarray, rate: float, jitter: float = 5e-4) -> np.ndarray:
    """Arrivals at a client that looks at this rate, as a game loop does, and not quite evenly."""
    looks = np.arange(0, time[-1] + 1, 1 / rate)
    looks += np.random.default_rng(9).uniform(-jitter, jitter, len(looks))
    arrival = looks[np.searchsorted(looks, time + 2e-3)]
    return arrival + 3e-5 * (np.arange(len(time)) - np.searchsorted(arrival, arrival))


@pytest.mark.parametrize("polls", [59.94, 59.5, 39.7])
@pytest.mark.parametrize("rate", [120.0, 240.0])
def test_beating_between_client_and_camera_rate_is_not_a_lost_frame(rate, polls):
    time = exposures(rate)
    found, warnings = at_exposure(stamped(in_bursts(time, polls), moving(time)))
    assert rate_found(warnings[0]) == pytest.approx(rate, rel=2e-4)
    assert np.abs(off(found, time)).max() < 1e-3


@pytest.mark.parametrize(("rate", "polls"), [(120.0, 59.5), (240.0, 119.3)])
def test_twice_the_client_rate_is_not_taken_for_the_camera_rate(rate, polls):
    time = exposures(rate, 0.01, seconds=3.0)
    found, warnings = at_exposure(stamped(in_bursts(time, polls), moving(time)))
    assert rate_found(warnings[0]) == pytest.approx(rate, rel=1e-3)
    assert np.abs(off(found, time)).max() < 1e-3


def test_a_jerk_moves_no_pose_if_no_frame_is_lost():
    time = exposures(120.0)
    values = moving(time)
    values[-1] = moving(time + 1 / 120)[-1]
    found, _ = at_exposure(stamped(polled(time), values))
    assert np.abs(off(found, time)).max() < 1e-4


@pytest.mark.parametrize("stated", [None, 240.0])
def test_bursts_of_six_poses_with_lost_frames_are_timed_correctly(stated):
    time = exposures(240.0, 0.03)
    looks = np.cumsum(np.random.default_rng(9).uniform(0.015, 0.035, 2000))
    arrival = looks[np.searchsorted(looks, time + 2e-3)]
    arrival += 3e-5 * (np.arange(len(time)) - np.searchsorted(arrival, arrival))
    found, _ = at_exposure(stamped(arrival, moving(time), rate_hz=stated))
    assert np.mean(np.abs(off(found, time)) > 1e-3) < 0.02


@pytest.mark.parametrize("back", [1, 50])
def test_a_few_backward_stamps_do_not_hide_that_stamps_are_arrivals(back):
    time = exposures(120.0)
    arrival = polled(time) + 3e-5 * np.arange(len(time)) / len(time)
    arrival[100 :: len(time) // back] -= 0.03
    stamp = np.rint(1e9 * arrival).astype(np.int64)
    found, warnings = at_exposure(Stream(stamp, stamp, moving(time), COLUMNS["pose"]))
    assert "stamped on arrival" in warnings[0]
    assert np.abs(off(found, time)).max() < 1e-3


def test_frames_of_a_resting_craft_are_counted_by_their_arrivals():
    time = exposures(120.0, 0.02)
    found, _ = at_exposure(stamped(held_up(time)))
    assert np.mean(np.abs(off(found, time)) > 1e-3) < 0.03


def test_a_stated_rate_is_used_if_many_frames_are_lost():
    time = exposures(120.0, 0.1)
    found, _ = at_exposure(stamped(held_up(time), rate_hz=120.0))
    assert np.mean(np.abs(off(found, time)) > 3e-4) < 0.05
    wrong, warnings = at_exposure(raw := stamped(held_up(time), rate_hz=77.0))
    assert wrong == raw
    assert "rate_hz = 77 does not fit" in warnings[-1]


@pytest.mark.parametrize(
    "stamps",
    [
        exposures(240.0),
        exposures(240.0, 0.2),
        np.rint(np.arange(0, 20, 0.01) * 240) / 240,
        exposures(120.0) + np.random.default_rng(0).uniform(-1e-3, 1e-3, 2400),
    ],
)
def test_camera_stamps_are_unchanged(stamps):
    stamps = np.sort(stamps)
    for stream in (stamped(stamps), stamped(stamps, moving(stamps))):
        assert at_exposure(stream) == (stream, ())


def test_stamps_stated_to_be_exact_are_unchanged():
    stream = stamped(polled(exposures(120.0)), exact=True)
    assert at_exposure(stream) == (stream, ())


@pytest.mark.parametrize(("count", "stated"), [(150, {}), (2400, {"exact": True})])
def test_repeats_are_kept_in_short_recordings_and_with_exact_stamps(count, stated):
    time = exposures(120.0)[:count]
    held = np.arange(count) // 2 * 2
    stream = stamped(time, moving(time)[held], **stated)
    assert at_exposure(stream) == (stream, ())


def test_poses_may_share_a_stamp_if_a_few_of_them_repeat():
    time = exposures(240.0)
    values = moving(time)
    values[50::100] = values[49::100]
    arrival = np.ceil(240 / 3 * (time + 1e-3)) * 3 / 240
    stamp = np.rint(1e9 * arrival).astype(np.int64)
    found, warnings = at_exposure(Stream(stamp, stamp, values, COLUMNS["pose"]))
    assert rate_found(warnings[-1]) == pytest.approx(240.0, rel=2e-4)
    assert np.abs(off(found, time)).max() < 1e-4


@pytest.mark.parametrize("repeats", [1, 2])
def test_exposure_times_do_not_depend_on_the_clocks_epoch(repeats):
    time = exposures(120.0, 0.02, seconds=3.0)
    held = np.repeat(np.arange(len(time)), repeats)
    early = stamped(
        polled(time)[held] + 4e-3 * (np.arange(len(held)) % repeats), moving(time)[held]
    )
    later = 1_700_000_000 * 10**9
    late = replace(early, stamp_ns=early.stamp_ns + later, received_ns=early.received_ns + later)
    (expected, warnings), (found, same) = at_exposure(early), at_exposure(late)
    assert len(warnings) == repeats and same == warnings
    np.testing.assert_allclose(found.stamp_ns - later, expected.stamp_ns, atol=1)


def test_arrivals_without_a_recognisable_rate_cause_a_warning():
    arrival = np.cumsum(np.random.default_rng(1).pareto(1.1, 3000) * 1e-3)
    stream = stamped(arrival)
    found, warnings = at_exposure(stream)
    assert found == stream
    assert "state it in the mapping: pose = {rate_hz = 120}" in warnings[0]


def check_repeats(time: np.ndarray, values: np.ndarray, faster: float, rate: float) -> list[str]:
    """Log poses faster than they change; the first of equal ones must be kept and placed."""
    logged = np.arange(0.001, time[-1], 1 / (faster * rate))
    held = np.searchsorted(time, logged, side="right") - 1
    found, warnings = at_exposure(stamped(logged, values[held]))
    order = np.argsort(values[:, 0])
    kept = time[order[np.searchsorted(values[order, 0], found.values[:, 0])]]
    assert len(kept) == len(set(held.tolist()))
    # The logger was late by up to a step.
    assert np.abs(off(found, kept)).max() < 0.6 / (faster * rate)
    return list(warnings)


@pytest.mark.parametrize("faster", [1.25, 2.0, 4.0])
def test_the_first_of_repeated_poses_is_kept(faster):
    time = exposures(240.0)
    values = np.cumsum(np.random.default_rng(2).normal(size=(len(time), 3)), axis=0)
    assert "repeat the one before" in check_repeats(time, values, faster, 240.0)[0]


@pytest.mark.parametrize("faster", [1.25, 2.0, 4.0])
def test_lost_frames_filled_with_repeats_are_recognised_as_lost(faster):
    time = exposures(120.0)
    bursts = [(3.04, 3.1), (7.2, 7.3), (11.0, 11.03)]
    seen = np.all([(time < first) | (time > last) for first, last in bursts], axis=0)
    time, values = time[seen], np.random.default_rng(2).normal(size=(int(seen.sum()), 3))
    assert "120.0" in check_repeats(time, values, faster, 120.0)[1]


@pytest.mark.parametrize("faster", [1.25, 2.00003])  # the second's steps become late
def test_the_rate_is_found_despite_a_fifth_of_lost_frames_and_two_bursts(faster):
    time = exposures(120.0, 0.2, 16.0)
    time = time[((time < 3.0) | (time > 3.1)) & ((time < 7.2) | (time > 7.3))]
    logged = np.arange(1e-4, time[-1], 1 / (faster * 120.0))
    held = np.searchsorted(time, logged, side="right") - 1
    found, warnings = at_exposure(stamped(logged, moving(time)[held]))
    assert rate_found(warnings[1]) == pytest.approx(120.0, rel=5e-4)
    steps = np.diff(found.stamp_ns) / 1e9 * 120.0
    assert np.abs(steps - np.rint(steps)).max() < 0.01


def test_a_frozen_pose_keeps_its_repeats():
    time = exposures(240.0)
    values = np.random.default_rng(2).normal(size=(len(time), 3))
    values[1000:1050] = values[1000]
    stream = stamped(time, values)
    assert at_exposure(stream) == (stream, ())


def test_a_mapping_may_state_either_rate_or_exact_stamps():
    time = exposures(120.0, seconds=2.0)
    poses, commands = np.zeros((240, 3)), np.zeros((240, 6))
    for stated, field in (({"rate_hz": 120.0}, "rate_hz"), ({"stamps": "exact"}, "exact")):
        mapping = RecordingMapping(pose=PoseMapping(**stated))
        made = Recording.from_arrays(time, poses, time, commands, mapping=mapping)
        assert getattr(made["pose"], field) == next(iter(stated.values())) or made["pose"].exact
    with pytest.raises((InputError, ValueError), match="exclude each other"):
        PoseMapping(rate_hz=120.0, stamps="exact")
