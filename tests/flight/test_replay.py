"""Replay reproduces a flight of the package's controller, and nearly the paper's flight."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.stats import pearsonr

from airpuck import InputError, Recording, Replay, SetPoints, Vehicle
from airpuck.control.law import Status
from airpuck.control.lqr import LQRSettings
from airpuck.control.tuning import default_tuning
from airpuck.craft.vehicle import default_vehicle
from airpuck.flight.replay import Gains, replay
from airpuck.flight.track import Track
from airpuck.model.model_file import nominal_model, published_model
from airpuck.twin.experiments import track
from airpuck.twin.plant import build_plant
from airpuck.twin.sensors import EPOCH_NS
from airpuck.twin.settings import MotionCapture, Radio, default_twin_settings

from ..apparatus.changes import changed
from ..apparatus.refusals import rejected
from ..apparatus.synthetic_flights import bad_value, edited, shuffled

M4 = published_model("M4")
LEAST = M4.vehicle.command_min
# At the second change the request is too large and is scaled down.
SET_POINTS = SetPoints([0.0, 0.505, 2.005], [(0, 0, 0), (0.2, -0.1, 0.8), (-0.1, 0.1, -0.9)])
NOISY = default_twin_settings()
# Frames every 4 ms with 6.5 ms latency: no stamp is rounded, and none arrives with a command.
CLEAN = changed(
    NOISY,
    radio=Radio(delay_s=M4.transport_delay, jitter_s=0.0),
    motion_capture=MotionCapture(
        rate_hz=250, position_noise_m=0, yaw_noise_rad=0, latency_s=0.0065, latency_jitter_s=0
    ),
    on_board={"rate_hz": 0},
)
PAPER: dict[str, Any] = {"compensate_delay": False, "reject_disturbance": False}
OURS: dict[str, Any] = {"compensate_delay": True, "reject_disturbance": True}


@pytest.fixture(scope="module")
def plant():
    return build_plant(M4)


@pytest.fixture(scope="module")
def recording(plant) -> Recording:
    return track(M4, SET_POINTS, 3.0, settings=CLEAN, plant=plant, **PAPER).recording


@pytest.fixture(scope="module")
def plain(recording) -> Replay:
    return replay(recording, M4, **PAPER)


def moved(recording: Recording, stamps: dict[str, int], recorder: int = 0) -> Recording:
    """Move the clocks of some senders, and the recorder's [ns]."""
    streams = {
        name: replace(
            old, stamp_ns=old.stamp_ns + stamps.get(name, 0), received_ns=old.received_ns + recorder
        )
        for name, old in recording.streams.items()
    }
    return replace(recording, streams=streams)


def without_epoch(recording: Recording) -> Recording:
    return moved(recording, dict.fromkeys(recording.streams, -EPOCH_NS), -EPOCH_NS)


@pytest.mark.slow
@pytest.mark.parametrize("options", [PAPER, OURS])
def test_a_flight_of_this_controller_is_reproduced(plant, options):
    weights = default_tuning().of(LQRSettings).weights
    weights = weights.model_copy(update={"position": 20.0, "yaw": 10.0})
    tuning = default_tuning().with_law("lqr", weights=weights)
    log = track(M4, SET_POINTS, 3.0, settings=CLEAN, plant=plant, tuning=tuning, **options)
    recording = log.recording
    found = replay(recording, M4, tuning=tuning, **options)
    np.testing.assert_array_equal(found.sent, log.command)
    np.testing.assert_array_equal(found.reference, log.reference)
    np.testing.assert_allclose(found.time, log.time, atol=1e-6)
    assert found.status == log.status
    assert {"no pose", "exact", "scaled"} <= set(log.status)
    np.testing.assert_array_equal(found.compared, [s != "no pose" for s in log.status])
    # Stamps of today are good to 0.24 µs in double precision, ...
    np.testing.assert_allclose(found.computed, log.command, atol=2e-4)
    # ... and commands stamped in 1970 agree to rounding errors.
    then = replay(without_epoch(recording), M4, tuning=tuning, **options)
    np.testing.assert_allclose(then.computed, log.command, atol=2e-8)
    assert np.median(np.abs(then.computed - log.command)) < 1e-14


def test_a_different_model_computes_different_commands(recording):
    found = replay(recording, published_model("M3"), **PAPER)
    assert np.median(np.abs(found.difference)) > 5e-3


@pytest.mark.slow
@pytest.mark.parametrize(
    ("settings", "gains", "tolerance"),
    [(CLEAN, Gains(6.5, 4.0, 20.0, 8.0), 1e-3), (NOISY, Gains(12.0, 6.5, 11.0, 5.0), 0.01)],
)
def test_the_gains_that_flew_are_recovered(plant, settings, tolerance, gains):
    log = track(M4, SET_POINTS, 3.0, settings=settings, plant=plant, gain=gains.matrix(), **PAPER)
    recording = log.recording
    found = replay(recording, M4, fit_gains=True, **PAPER)
    assert found.fitted
    np.testing.assert_allclose(
        list(vars(found.gains).values()), list(vars(gains).values()), rtol=tolerance
    )
    # Start from the packaged tuning's gains, which explain the commands less.
    other = replay(recording, M4, **PAPER)
    assert not other.fitted
    mean = [np.abs(one.computed - log.command)[one.compared].mean() for one in (found, other)]
    assert mean[0] < 0.3 * mean[1]


def test_gains_are_in_the_order_of_the_state():
    # v = -K (x, y, γ, vx, vy, ω).
    expected = [[1, 0, 0, 2, 0, 0], [0, 1, 0, 0, 2, 0], [0, 0, 3, 0, 0, 4]]
    gains = Gains(position=1.0, speed=2.0, yaw=3.0, spin=4.0)
    np.testing.assert_array_equal(gains.matrix(), expected)
    assert Gains.of(gains.matrix()) == gains


@pytest.mark.parametrize(
    ("senders", "sender_s", "recorder_s"),
    [(["pose"], 7.3, 0), (["command"], 7.3, 0), (["pose", "command"], -7.3, 0), ([], 0, -7.3)],
)
def test_different_clocks_change_little(recording, plain, senders, sender_s, recorder_s):
    stamps = {name: round(1e9 * sender_s) for name in senders}
    other = moved(recording, stamps, round(1e9 * recorder_s))
    found = replay(other, M4, **PAPER)
    np.testing.assert_array_equal(found.reference, plain.reference)
    both = plain.compared & found.compared
    assert both.sum() >= 298
    # The latency of the poses is unknown here: the controller gets one or two more.
    apart = np.abs(found.computed - plain.computed)[both]
    assert np.median(apart) < 1e-3
    assert np.quantile(apart, 0.99) < 0.1
    times = Track.of(other, M4.vehicle, "").set_points.times
    np.testing.assert_allclose(times, [0.0, 0.51, 2.01], atol=0.0075)


def test_reordered_columns_are_matched_by_name(recording, plain):
    found = replay(shuffled(recording), M4, **PAPER)
    np.testing.assert_array_equal(found.computed, plain.computed)
    np.testing.assert_array_equal(found.sent, plain.sent)
    assert found.motors == M4.vehicle.propeller_names


def test_commands_logged_twice_count_once(recording, plain):
    def again(stamp, received, values):
        rows = np.sort(np.append(np.arange(len(stamp)), np.arange(120, 140)))
        return stamp[rows], received[rows], values[rows]

    def late(stamp, received, values):
        rows = np.insert(np.arange(len(stamp)), 200, np.arange(120, 140))
        return stamp[rows], received[rows], values[rows]

    for edit in (again, late):
        found = replay(edited(recording, "command", edit), M4, **PAPER)
        np.testing.assert_array_equal(found.computed, plain.computed)


def test_pauses_of_the_poses_are_not_compared(recording):
    # Frames from 1.0 to 1.2 s are missing: the last is of 0.996 s, the next arrives at 1.2065 s.
    def edit(stamp, received, values):
        time = (stamp - EPOCH_NS) / 1e9
        keep = (time < 0.9999) | (time > 1.1999)
        return stamp[keep], received[keep], values[keep]

    found = replay(edited(recording, "pose", edit), M4, **PAPER)
    stale = np.array([s == "stale pose" for s in found.status])
    np.testing.assert_array_equal(np.flatnonzero(stale), np.arange(105, 121))
    np.testing.assert_array_equal(found.compared, ~stale & (np.arange(300) > 0))
    np.testing.assert_array_equal(found.computed[stale], LEAST)
    assert np.isnan(found.pose[stale]).all()
    assert np.isfinite(found.pose[found.compared]).all()
    assert np.isfinite([*found.correlation, *found.difference.ravel()]).all()


def test_a_span_is_a_fraction_of_the_commands(recording, plain):
    part = replay(recording, M4, span=(0.25, 0.5), **PAPER)
    np.testing.assert_array_equal(np.flatnonzero(part.compared), np.arange(75, 150))
    np.testing.assert_array_equal(part.computed, plain.computed)
    np.testing.assert_array_equal(part.difference, (part.computed - part.sent)[75:150])
    assert part.to_json()["steps"] == 75
    assert sum(part.to_json()["outcomes"].values()) == 75


@pytest.mark.slow
def test_only_commands_in_the_span_are_fitted(recording, plain):
    def edit(stamp, received, values):
        values[:75] = 0.9 - values[:75]
        return stamp, received, values.clip(0, 1)

    damaged = edited(recording, "command", edit)
    found = replay(damaged, M4, fit_gains=True, span=(0.4, 1.0), **PAPER)
    np.testing.assert_allclose(
        list(vars(found.gains).values()), list(vars(plain.gains).values()), rtol=0.01
    )


def made_up() -> Replay:
    """Twenty steps of two motors, the first and the last three not compared."""
    random = np.random.default_rng(0)
    sent = random.uniform(0, 1, (20, 2))
    computed = np.column_stack([0.5 * sent[:, 0] + 0.2 * random.uniform(size=20), np.full(20, 0.4)])
    status: list[Status] = ["no pose", *["exact"] * 12, *["scaled"] * 7]
    return Replay(
        time=np.arange(20) / 100,
        sent=sent,
        computed=computed,
        status=tuple(status),
        reference=np.zeros((20, 3)),
        pose=np.zeros((20, 3)),
        gains=Gains(1.0, 2.0, 3.0, 4.0),
        fitted=True,
        motors=("a", "b"),
        compared=(np.arange(20) > 0) & (np.arange(20) < 17),
        span=np.arange(20) < 17,
    )


def test_figures_match_plain_numpy():
    found = made_up()
    sent, computed = found.sent[1:17], found.computed[1:17]
    expected = float(pearsonr(sent[:, 0], computed[:, 0])[0])  # pyright: ignore
    assert 0.5 < expected < 0.99
    # A constant command correlates with nothing.
    np.testing.assert_allclose(found.correlation, [expected, 0.0], atol=1e-12)
    np.testing.assert_array_equal(found.difference, computed - sent)
    document = found.to_json()
    apart = np.sort(np.abs(computed - sent), axis=0)
    middle = (apart[7] + apart[8]) / 2
    for motor, name, r, m in zip(document["motors"], "ab", found.correlation, middle, strict=True):
        assert motor == {"name": name, "correlation": r, "median_abs": pytest.approx(m)}
    both = np.sort(apart.ravel())
    assert document["median_abs"] == pytest.approx((both[15] + both[16]) / 2)
    assert document["gains"] == {"position": 1.0, "speed": 2.0, "yaw": 3.0, "spin": 4.0}
    assert document["fitted"] is True
    assert document["steps"] == 16
    assert document["outcomes"] == {"exact": 12, "no pose": 1, "scaled": 4}


def test_a_law_without_gains_has_none_to_fit(recording):
    predictive = default_tuning().with_law("mpc")
    with pytest.raises(InputError, match="this law has no gains; use --law lqr"):
        replay(recording, M4, tuning=predictive, fit_gains=True)


@pytest.mark.parametrize("missing", ["pose", "command", "reference"])
def test_a_missing_or_empty_stream_is_named(recording, missing):
    streams = {name: stream for name, stream in recording.streams.items() if name != missing}
    with pytest.raises(InputError, match=f"has no {missing} stream"):
        replay(replace(recording, streams=streams), M4)
    empty = edited(recording, missing, lambda s, r, v: (s[:0], r[:0], v[:0]))
    with pytest.raises(InputError, match=f"the {missing} stream is empty"):
        replay(empty, M4)


@pytest.mark.parametrize(
    ("stream", "edit", "message"),
    [
        ("pose", bad_value(100, 1, np.nan), "y_m: 1 of 751 poses are not finite.*row 101"),
        ("pose", bad_value(100, 2, np.inf), "yaw_rad: 1 of 751 poses are not finite"),
        ("pose", lambda s, r, v: (s, r, v * [1000, 1000, 1]), "for millimetres"),
        (
            "pose",
            lambda s, r, v: (s + 10**12, r + 10**12, v),
            "not known at any command .* overlap",
        ),
        ("pose", lambda s, r, v: (s[::-1], r[::-1], v[::-1]), "have stamps before earlier ones"),
        ("command", lambda s, r, v: (s[:1], r[:1], v[:1]), "not known at any command"),
        ("command", bad_value(7, 1, np.nan), "motor_a_2: 1 of 300 commands are not finite"),
        ("command", bad_value(7, 1, 1.5), r"motor_a_2: command 1.5 at 0.07. s is outside \[0, 1\]"),
        ("reference", bad_value(1, 0, np.nan), "poses must be finite"),
    ],
)
def test_bad_input_ends_in_one_clear_line(recording, stream, edit, message):
    with pytest.raises(InputError, match=message):
        replay(edited(recording, stream, edit), M4)


@pytest.mark.parametrize("span", [(0.5, 0.5), (0.6, 0.4), (-0.1, 0.5), (0.5, 1.1), (np.nan, 0.5)])
def test_an_invalid_span_is_rejected(recording, span):
    with rejected(match="two fractions", field="span"):
        replay(recording, M4, span=span)


@pytest.mark.parametrize("span", [(0.0, 0.003), (0.5001, 0.5002)])
def test_a_span_without_a_step_to_compare_is_rejected(recording, span):
    # No pose precedes the first command, and none arrives between two commands.
    with pytest.raises(InputError, match=r"not known at any command in the span; .* longer"):
        replay(recording, M4, span=span)


def test_too_few_commands_for_the_gains_are_rejected(recording):
    with rejected(match="too few commands", field="fit-gains"):
        replay(recording, M4, fit_gains=True, span=(0.5, 0.6))


def test_a_model_of_another_craft_is_rejected(recording):
    content = default_vehicle().model_dump()
    content |= {"propellers": content["propellers"][:4], "pairs": content["pairs"][:2]}
    four = nominal_model(Vehicle.model_validate(content))
    with pytest.raises(InputError, match=r"has 6 motors \(motor_a_1, .* has 4 propellers"):
        replay(recording, four)


@pytest.mark.slow
@pytest.mark.data
def test_the_commands_of_the_papers_flight_are_reproduced(data):
    from airpuck.recording.read import read_recording

    flight = read_recording(data / "control_experiment" / "data_M4")
    found = replay(flight, M4, fit_gains=True, span=(0.0, 0.84))
    assert (found.correlation >= 0.94).all()
    assert np.median(np.abs(found.difference)) <= 0.01
    # Found independently from the same log, by regression.
    np.testing.assert_allclose(
        list(vars(found.gains).values()), [9.06, 5.02, 15.0, 6.36], rtol=0.05
    )
    assert found.compared.sum() > 800
