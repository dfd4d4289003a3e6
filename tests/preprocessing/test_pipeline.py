"""`preprocess`: against the authors' own file, and with all kinds of wrong input."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from airpuck import InputError, Recording
from airpuck.data.windows import make_windows
from airpuck.evaluation.evaluate import evaluate
from airpuck.identification.fit import identify
from airpuck.model.model_file import published_model
from airpuck.preprocessing.pipeline import load_all, preprocess
from airpuck.recording.bag import write_bag

from ..apparatus.examples import examples
from ..apparatus.public_recordings import BLUE
from ..apparatus.synthetic_flights import RATE, bad_value, edited, fly, record, shuffled


def lacking(recording: Recording, stream: str, kept):
    """Preprocess a recording without some rows of a stream, by their time since its begin [s]."""

    def edit(stamp, received, values):
        rows = kept((stamp - stamp[0]) / 1e9)
        return stamp[rows], received[rows], values[rows]

    return preprocess(edited(recording, stream, edit))


@pytest.fixture(scope="module")
def recording() -> Recording:
    return record(duration=6.0, noise=1e-5)


def test_a_synthetic_flight_is_recovered(recording):
    trajectory = preprocess(recording)
    assert trajectory.delay == pytest.approx(5 / RATE, rel=1e-3)
    assert not trajectory.excluded
    assert not trajectory.warnings
    truth = fly(published_model("M3"), 6.0)
    # The recording's first command is stamped before its first pose: few poses are cropped.
    first = int(np.argmin(np.abs(truth.state[:100, :2] - trajectory.state[0, :2]).sum(axis=1)))
    inner = slice(first + 10, first + len(trajectory) - 10)
    np.testing.assert_array_equal(trajectory.input[10:-10], truth.input[inner])
    error = trajectory.state[10:-10] - truth.state[inner]
    assert np.abs(error[:, :3]).max() < 1e-4
    assert np.abs(error[:, 3:5]).max() < 0.02
    assert np.abs(error[:, 5]).max() < 1.0


def test_a_path_a_recording_and_a_trajectory_are_accepted_alike(recording, tmp_path):
    write_bag(recording, tmp_path / "bag")
    trajectory = preprocess(recording)
    for found in load_all([tmp_path / "bag", str(tmp_path / "bag"), recording, trajectory]):
        np.testing.assert_allclose(found.time, trajectory.time, atol=1e-9)
        np.testing.assert_allclose(found.state, trajectory.state, atol=1e-7)
        np.testing.assert_array_equal(found.command, trajectory.command)
    assert load_all(trajectory) == [trajectory]
    assert len(load_all(recording)) == 1  # although a recording is an iterable of its streams
    assert len(load_all(tmp_path / "bag")) == 1
    with pytest.raises(InputError, match=r"recordings: must be paths.*, not nothing"):
        load_all([])


@pytest.mark.slow
def test_a_recording_becomes_parameters():
    trajectory = preprocess(record(duration=20.0, noise=5e-5))
    fit = identify(trajectory)
    truth = published_model("M3").parameters
    assert fit.model.parameters.inertia == pytest.approx(truth.inertia, rel=0.01)
    assert fit.model.parameters.angle_offset == pytest.approx(truth.angle_offset, abs=0.003)
    assert fit.model.transport_delay == pytest.approx(trajectory.delay, abs=2e-4)
    unseen = preprocess(record(duration=8.0, seed=9, noise=5e-5))
    assert evaluate(fit.model, unseen).rmse[0] < 1e-3


def test_a_gap_is_detected_and_no_window_spans_it(recording):
    trajectory = lacking(recording, "pose", lambda time: (time < 3.0) | (time > 3.2))
    (span,) = trajectory.excluded
    assert span.cause == "gap"
    assert span.stop - span.start == pytest.approx(0.2, abs=0.01)
    for start in make_windows(trajectory, 20, 50).starts:
        assert np.diff(trajectory.time[start : start + 70]).max() < 1.5 / RATE
    # Derivatives beside the gap do not use samples across it.
    truth = preprocess(recording)
    far = np.abs(trajectory.state[:, 3]).max()
    assert far < 1.5 * np.abs(truth.state[:, 3]).max()


def test_accelerations_are_interpolated_linearly_across_lost_frames(recording):
    trajectory = lacking(recording, "pose", lambda time: np.abs(time - 3.0) > 0.03)
    known, time = trajectory.bridged, trajectory.time
    assert np.ptp(time[~known]) == pytest.approx(0.06, abs=2 / RATE)
    for column in trajectory.acceleration.T:
        expected = np.interp(time[~known], time[known], column[known])
        np.testing.assert_allclose(column[~known], expected)
        assert np.abs(expected).min() > 0


def test_too_few_poses_between_two_gaps_are_excluded(recording):
    trajectory = lacking(
        recording, "pose", lambda time: (np.abs(time - 3.0) > 0.2) | (np.abs(time - 3.0) < 0.02)
    )
    assert [span.cause for span in trajectory.excluded].count("gap") == 2
    (span,) = (span for span in trajectory.excluded if span.cause == "too short to smooth")
    assert span.stop - span.start == pytest.approx(0.04, abs=2 / RATE)
    inside = (trajectory.time >= span.start) & (trajectory.time <= span.stop)
    assert 8 < inside.sum() < 12
    assert not trajectory.usable[inside].any()


@pytest.mark.parametrize("logged", [False, True])
def test_the_motion_reveals_a_clock_step_if_there_are_no_arrival_times(logged):
    def edit(stamp, received, values):
        stamp = stamp + 30_000_000 * (np.arange(len(stamp)) > len(stamp) // 2)
        return stamp, stamp + 1_000_000 * logged, values

    trajectory = preprocess(edited(record(noise=5e-5), "pose", edit))
    told = [text for text in trajectory.warnings if "the cameras' clock steps by 30 ms" in text]
    assert len(told) == (not logged)
    assert ("clock step" in {span.cause for span in trajectory.excluded}) == (not logged)


def test_duplicates_and_backward_stamps_are_dropped_and_reported(recording):
    def edit(stamp, received, values):
        stamp = stamp.copy()
        stamp[500] = stamp[499]
        stamp[700] = stamp[600]
        return stamp, received, values

    trajectory = preprocess(edited(recording, "pose", edit))
    assert (np.diff(trajectory.time) > 0).all()
    assert any("1 of the pose samples, with a duplicated stamp" in w for w in trajectory.warnings)
    assert any(
        "1 of the pose samples, with a stamp that goes back" in w for w in trajectory.warnings
    )
    # A lost pose is not a gap, and no more than a measurement that is missing.
    assert not trajectory.excluded
    assert (~trajectory.measured).sum() == 2


def test_rows_in_any_order_never_crash(recording):
    def edit(stamp, received, values):
        order = np.random.default_rng(0).permutation(len(stamp))
        return stamp[order], received[order], values[order]

    with pytest.raises(InputError):
        make_windows(preprocess(edited(recording, "pose", edit)))


def test_a_frozen_pose_is_detected(recording):
    def edit(stamp, received, values):
        values[600:630] = values[600]
        return stamp, received, values

    trajectory = preprocess(edited(recording, "pose", edit))
    # After freezing, the pose jumps to where the craft is by then.
    span, leap = trajectory.excluded
    assert span.cause == "frozen pose"
    assert leap.cause == "jumping pose"
    assert leap.start < span.stop < leap.stop
    assert span.stop - span.start == pytest.approx(29 / RATE, rel=1e-3)


def test_a_pause_of_the_commands_is_excluded(recording):
    trajectory = lacking(recording, "command", lambda time: (time < 2.0) | (time > 2.5))
    assert "no commands" in {span.cause for span in trajectory.excluded}


def test_different_clocks_are_aligned(recording):
    def edit(stamp, received, values):
        return stamp - 7_300_000_000, received, values

    trajectory = preprocess(edited(recording, "command", edit))
    assert any("clocks" in warning for warning in trajectory.warnings)
    # The remainder is the difference of the two latencies: 1 ms against 0.1 ms.
    straight = preprocess(recording)
    assert trajectory.delay == pytest.approx(straight.delay, abs=2 / RATE)


def test_reordered_motors_are_matched_by_name(recording):
    other = preprocess(shuffled(recording))
    np.testing.assert_array_equal(other.command, preprocess(recording).command)


def test_a_given_delay_is_used(recording):
    trajectory = preprocess(recording, delay=0.03)
    assert trajectory.delay == 0.03
    assert trajectory.time[0] == 0


@pytest.mark.parametrize(
    ("stream", "edit", "message"),
    [
        ("pose", bad_value(100, 0, np.nan), "x_m: 1 of .* not finite"),
        ("pose", bad_value(100, 2, np.inf), "yaw_rad: 1 of .* not finite"),
        ("command", bad_value(100, 1, np.nan), "motor_a_2: 1 of .* not finite"),
        ("command", bad_value(100, 1, 1.5), r"motor_a_2: command 1.5 at .* outside \[0, 1\]"),
        ("command", bad_value(100, 1, -0.1), r"outside \[0, 1\]"),
        ("pose", lambda s, r, v: (s, r, v * [1000, 1000, 1]), "for millimetres"),
        ("pose", lambda s, r, v: (s, r, v * [1, 1, 180 / np.pi]), "looks like degrees"),
        (
            "pose",
            lambda s, r, v: (s // 1000, r // 1000, v),
            "every 4.17e-06 s, which is implausible for motion capture",
        ),
        (
            "pose",
            lambda s, r, v: (1000 * (s - s[0]), r, v),
            "every 4.17 s, which is implausible for motion capture",
        ),
        ("pose", lambda s, r, v: (s[:50], r[:50], v[:50]), "too short"),
        ("pose", lambda s, r, v: (s[:0], r[:0], v[:0]), "pose stream is empty"),
        ("command", lambda s, r, v: (s, r, v * 0), "never moved the craft"),
        ("pose", lambda s, r, v: (s + 10**12, r + 10**12, v), "do not overlap"),
    ],
)
def test_bad_input_ends_in_one_clear_line(recording, stream, edit, message):
    with pytest.raises(InputError, match=message):
        make_windows(preprocess(edited(recording, stream, edit)))


def test_an_error_that_bad_stamps_may_cause_repeats_their_warning(recording):
    pose = recording["pose"]
    # A client gets six poses at once, and the mapping states a rate that is too low.
    late = pose.stamp_ns[0] + 25_000_000 * (1 + np.arange(len(pose)) // 6)
    late += 1000 * (np.arange(len(pose)) % 6)
    pose = replace(pose, stamp_ns=late, received_ns=late, rate_hz=50.0)
    made = replace(recording, streams={**recording.streams, "pose": pose})
    with pytest.raises(InputError, match="in bursts; rate_hz = 50 does not fit the stamps"):
        preprocess(made)


def test_a_missing_stream_is_named(recording):
    with pytest.raises(InputError, match="no command stream"):
        preprocess(replace(recording, streams={"pose": recording["pose"]}))


@examples(25)
@given(st.data())
def test_any_damage_gives_a_trajectory_or_a_clear_error(recording, data):
    """Delete, repeat, freeze, swap or shift random rows of random streams."""
    damaged = recording
    for _ in range(data.draw(st.integers(1, 3))):
        stream = data.draw(st.sampled_from(["pose", "command"]))
        count = len(damaged[stream])
        first = data.draw(st.integers(0, count - 2))
        width = data.draw(st.integers(1, 200))
        kind = data.draw(st.sampled_from(["delete", "repeat", "freeze", "reverse", "shift"]))

        def edit(stamp, received, values, kind=kind, first=first, width=width):
            rows = np.arange(len(stamp))
            inside = (rows >= first) & (rows < first + width)
            if kind == "delete":
                rows = rows[~inside]
            elif kind == "repeat":
                rows = np.sort(np.concatenate([rows, rows[inside]]))
            elif kind == "reverse":
                rows[inside] = rows[inside][::-1]
            elif kind == "freeze":
                values[inside] = values[inside][0]
            else:
                stamp = stamp + 50_000_000 * inside
            return stamp[rows], received[rows], values[rows]

        damaged = edited(damaged, stream, edit)
    try:
        trajectory = preprocess(damaged)
    except InputError:
        return
    assert (np.diff(trajectory.time) > 0).all()
    assert np.isfinite(trajectory.state).all()
    assert np.isfinite(trajectory.acceleration).all()
    for start in trajectory.window_starts(70):
        assert np.diff(trajectory.time[start : start + 70]).max() < 2 / RATE


@pytest.mark.data
def test_preprocessing_agrees_with_the_authors(experiments):
    from airpuck.recording.read import read_recording
    from airpuck.recording.torch_archive import read_authors_experiment

    mine = preprocess(read_recording(experiments / BLUE / BLUE))
    theirs = read_authors_experiment(experiments / BLUE / "data.pt")
    assert mine.delay / mine.sample_period == pytest.approx(4, abs=1e-6)
    assert len(mine) == len(theirs)
    np.testing.assert_allclose(mine.time, theirs.time, atol=1e-9)
    np.testing.assert_allclose(mine.state[:, :3], theirs.state[:, :3], atol=1e-9)
    np.testing.assert_allclose(mine.input, theirs.input, atol=1e-9)
    for ours, reference in (
        (mine.state[:, 3:], theirs.state[:, 3:]),
        (mine.acceleration, theirs.acceleration),
    ):
        error = np.sqrt(np.mean((ours - reference) ** 2, axis=0))
        assert (error <= 1e-9 * np.sqrt(np.mean(reference**2, axis=0))).all()
