"""Trajectories: holding, slicing, excluded spans, files."""

import itertools
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from airpuck.boundary.errors import InputError
from airpuck.craft.vehicle import default_vehicle
from airpuck.data.sampling import hold, mean_hold
from airpuck.data.trajectory import Span, as_trajectories, vehicle_of
from airpuck.data.trajectory_file import read_trajectory
from airpuck.data.windows import make_windows
from airpuck.model.model_file import published_model

from ..apparatus.synthetic_flights import fly


@pytest.fixture(scope="module")
def flight():
    return fly(published_model("M3"), duration=2.0)


def test_the_delay_shifts_the_input(flight):
    events = replace(flight, delay=2 / 240 - 1e-9)
    np.testing.assert_array_equal(events.input[2:], flight.input[:-2])


def test_a_trajectory_file_round_trips(flight, tmp_path):
    doubtful = Span(0.5, 0.7, "radio out", 0.83)
    saved = replace(flight, warnings=("odd",), delay=0.02)
    saved = saved.leave_out([doubtful, Span(0.1, 0.2, "gap")])
    saved.save(tmp_path / "flight.npz")
    back = read_trajectory(tmp_path / "flight.npz")
    for name in ("time", "state", "acceleration", "command_time", "command", "input"):
        np.testing.assert_array_equal(getattr(back, name), getattr(saved, name))
    assert back.excluded == saved.excluded == (Span(0.1, 0.2, "gap", 1.0), doubtful)
    # A span that is already excluded is not excluded twice.
    assert saved.leave_out([doubtful]).excluded == saved.excluded
    assert not saved.usable[(flight.time >= 0.5) & (flight.time <= 0.7)].any()
    assert (back.delay, back.warnings, back.propellers) == (
        saved.delay,
        saved.warnings,
        saved.propellers,
    )
    with np.load(tmp_path / "flight.npz") as archive:
        assert {"t", "state", "input", "command_time", "command"} <= set(archive.files)


def test_files_of_earlier_versions_have_no_vehicle(flight, tmp_path):
    known = replace(flight, vehicle=default_vehicle())
    known.save(tmp_path / "new.npz")
    assert read_trajectory(tmp_path / "new.npz").vehicle == default_vehicle()
    with np.load(tmp_path / "new.npz") as archive:
        content = dict(archive)
    about = json.loads(str(content["about"]))
    del about["vehicle"]
    np.savez_compressed(tmp_path / "old.npz", **content | {"about": np.array(json.dumps(about))})
    assert read_trajectory(tmp_path / "old.npz").vehicle is None


def test_trajectories_must_agree_on_their_vehicle(flight):
    heavy = default_vehicle().model_copy(update={"name": "heavy", "mass_kg": 0.2})
    one, unknown, other = (
        replace(flight, vehicle=vehicle) for vehicle in (heavy, None, default_vehicle())
    )
    assert vehicle_of([unknown]) == default_vehicle()
    assert vehicle_of([unknown, one]) == heavy
    with pytest.raises(InputError, match="'heavy' with other values; pass the vehicle"):
        vehicle_of([one, unknown, other])


def test_junk_truncated_files_and_pickled_arrays_are_rejected(flight, tmp_path):
    path = tmp_path / "flight.npz"
    flight.save(path)
    content = path.read_bytes()
    np.savez(path, t=np.array([object()], dtype=object))
    cut = (content[: len(content) * k // 13] for k in range(13))
    for part in (path.read_bytes(), *cut, b"PK\x03\x04junk", b"\x93NUMPY", b"text"):
        path.write_bytes(part)
        with pytest.raises(InputError, match=r"flight\.npz"):
            read_trajectory(path)


def test_a_slice_keeps_time_and_commands(flight):
    part = flight.slice(0.25, 0.75)
    assert len(part) == len(flight) // 2
    np.testing.assert_array_equal(part.input, flight.input[120:360])


@pytest.mark.parametrize("span", [(0.5, 0.5), (0.6, 0.4), (-0.1, 0.5), (0.5, 1.1), (0.5, 0.5001)])
def test_bad_spans_are_rejected(flight, span):
    with pytest.raises(InputError, match="span"):
        flight.slice(*span)


@given(
    st.lists(st.tuples(st.floats(0, 2), st.floats(0, 0.1)), max_size=4),
    st.integers(2, 80),
    st.integers(1, 20),
)
def test_no_window_overlaps_an_excluded_span(flight, spans, length, stride):
    excluded = tuple(Span(start, start + width, "gap") for start, width in spans)
    marked = replace(flight, excluded=excluded)
    for start in marked.window_starts(length, stride):
        time = marked.time[start : start + length]
        assert len(time) == length
        for span in excluded:
            assert not np.any((time >= span.start) & (time <= span.stop))


def test_all_fitting_windows_are_made(flight):
    assert len(flight.window_starts(70)) == len(flight) - 69
    assert len(flight.window_starts(70, 70)) == len(flight) // 70


def test_windows_never_span_two_recordings(flight):
    other = fly(published_model("M3"), duration=2.0, seed=1)
    windows = make_windows([flight, other], 20, 50)
    ends = windows.starts + 69
    assert not np.any((windows.starts < len(flight)) & (ends >= len(flight)))
    assert len(windows) == 2 * (len(flight) - 69)


def test_the_future_starts_where_the_past_ends(flight):
    windows = make_windows(flight, 20, 50, stride=70)
    past, (commands, durations, measured) = windows.past(), windows.future()
    first = windows.starts[1]
    np.testing.assert_array_equal(past.state[:, :, 1], flight.state[first : first + 20])
    np.testing.assert_array_equal(measured[:, :, 1], flight.state[first + 20 : first + 70])
    np.testing.assert_array_equal(commands[:, :, 1], flight.input[first + 19 : first + 69])
    np.testing.assert_allclose(durations, 1 / 240)


def test_too_short_a_recording_is_rejected(flight):
    with pytest.raises(InputError, match="needs 70 samples"):
        make_windows(flight.slice(0, 0.1))


def test_one_window_can_cover_the_whole_flight(flight):
    windows = make_windows(flight, 20, None)
    assert len(windows) == 1
    assert windows.prediction_length == len(flight) - 20


@pytest.mark.parametrize("given", ["bags/training", Path("bags/training"), ["bag"], 5, object()])
def test_a_raw_recording_is_rejected_with_the_command_to_preprocess_it(given):
    with pytest.raises(InputError, match=r"not a Trajectory: airpuck.load_trajectory\(path\)"):
        as_trajectories(given)


def test_one_trajectory_or_several_become_a_list(flight):
    assert as_trajectories(flight) == [flight]
    assert as_trajectories((flight, flight)) == [flight, flight]


TIMES = st.lists(st.floats(0, 10), min_size=1, max_size=20).map(sorted)


@given(TIMES, st.lists(st.floats(-1, 11), min_size=1, max_size=20))
def test_hold_returns_the_latest_value(events, times):
    values = np.arange(len(events), dtype=float)[:, None]
    held = hold(np.array(events), values, np.array(times))[:, 0]
    for time, value in zip(times, held, strict=True):
        before = [k for k, event in enumerate(events) if event <= time]
        assert value == (before[-1] if before else 0)


def test_the_mean_matches_a_hand_calculation():
    """A step from 0 to 1 at 0.3 and on to 3 at 0.9: in [0, 1] 0.6·1 + 0.1·3, and then 3."""
    events, values = np.array([-1.0, 0.3, 0.9]), np.array([[0.0], [1.0], [3.0]])
    time = np.array([-2.0, -1.5, 0.0, 1.0, 2.0])
    mean, slope = mean_hold(events, values, time)
    np.testing.assert_allclose(mean[:, 0], [0, 0, 0.9, 3, 3])
    # It falls by the whole change of 3 for each second that both events come later.
    np.testing.assert_allclose(slope[:, 0], [0, 0, -3, 0, 0])
    later, _ = mean_hold(events + 0.05, values, time)
    np.testing.assert_allclose(later[:, 0], [0, 0, 0.75, 3, 3])


@given(TIMES, TIMES)
def test_the_mean_equals_the_integral(events, times):
    """Integrate the held values, summing from one event or time to the next."""
    time = np.unique(np.round(times, 3))
    values = np.cos(np.arange(len(events)))[:, None] ** 2
    mean, _ = mean_hold(np.array(events), values, time)
    for k, (begin, end) in enumerate(itertools.pairwise(time)):
        edges = np.array([begin, *(event for event in events if begin < event < end), end])
        integral = np.diff(edges) @ hold(np.array(events), values, edges[:-1])[:, 0]
        assert mean[k, 0] == pytest.approx(integral / (end - begin), abs=1e-12)
    np.testing.assert_array_equal(mean[-1:], hold(np.array(events), values, time[-1:]))


def test_the_slope_equals_the_derivative():
    rng = np.random.default_rng(3)
    events, time = np.sort(rng.uniform(0, 1, 40)), np.sort(rng.uniform(0, 1, 30))
    values, step = rng.normal(size=(40, 2)), 1e-8
    forth, back = (mean_hold(events + d, values, time)[0] for d in (step, -step))
    _, slope = mean_hold(events, values, time)
    np.testing.assert_allclose((forth - back) / (2 * step), slope, rtol=1e-5, atol=1e-4)
