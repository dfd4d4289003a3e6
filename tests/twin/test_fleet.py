"""A fleet, against the twin, which simulates one craft at a time."""

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from airpuck.boundary.errors import InputError
from airpuck.craft.table import Table
from airpuck.identification.fit import identify
from airpuck.model.model_file import published_model
from airpuck.preprocessing.pipeline import preprocess
from airpuck.twin import fleet as fleet_module
from airpuck.twin.fleet import fly_fleet
from airpuck.twin.settings import (
    Effects,
    MotionCapture,
    Motors,
    OnBoard,
    Radio,
    Stall,
    TwinSettings,
)
from airpuck.twin.twin import Twin

MODEL = replace(published_model("M3"), frame="body")
OTHER = replace(
    MODEL,
    parameters=replace(
        MODEL.parameters,
        thrust=1.2 * MODEL.parameters.thrust,
        inertia=1.3 * MODEL.parameters.inertia,
        motor_time_constant=0.031,
        center_of_mass=np.array([2e-3, -1e-3]),
        angle_offset=0.02,
    ),
)
BAD_DAY = TwinSettings(
    radio=Radio(
        delay_s=0.02, jitter_s=0.015, loss=0.2, timeout_s=0.06, outages_s=((0.5, 0.7), (0.9, 0.95))
    ),
    motion_capture=MotionCapture(position_noise_m=5e-5, yaw_noise_rad=6e-4, dropped=0.05),
    on_board=OnBoard(rate_hz=0.0),
    motors=Motors(unarmed_s=0.13),
    effects=Effects(
        drag_linear_1_s=0.3,
        inflow_s_m=0.1,
        pair_interaction_1_N=0.4,
        tilt_rad=(0.004, -0.002),
        battery_sag_1_s=0.05,
    ),
)
#: Fast enough to reach the rails within a second: the comparison includes bounces.
COMMAND = np.repeat([[0.9, 0.2, 0.1, 0.8, 0.5, 0.05], [0.03, 0.6, 0.7, 0.2, 0.1, 0.9]], 60, axis=0)
QUIET = BAD_DAY.model_copy(
    update={
        "radio": Radio(delay_s=5 / 240),
        "motion_capture": MotionCapture(position_noise_m=5e-5, yaw_noise_rad=6e-4),
        "motors": Motors(),
        "effects": Effects(),
    }
)


def twin_of(model, command, *, seed=0, pose=(0.0, 0.0, 0.0), delay=None, settings=BAD_DAY):
    if delay is not None:
        radio = settings.radio.model_copy(update={"delay_s": delay})
        settings = settings.model_copy(update={"radio": radio})
    twin = Twin(model, settings, seed=seed, pose=pose)
    for k, row in enumerate(command):
        twin.wait_until(0.01 * k)
        twin.send(row)
    twin.wait_until(0.01 * len(command))
    return twin


@pytest.mark.slow
def test_each_craft_does_what_a_twin_of_its_own_would_do():
    rng = np.random.default_rng(1)
    commands = np.stack([COMMAND, COMMAND[::-1], rng.permutation(COMMAND)], axis=-1)
    poses = np.array([[0.9, 0.0, -0.3], [0.3, -0.4, 0.0], [0.5, -3.0, 8.0]])
    models, seeds, delays = [MODEL, OTHER, MODEL], [3, 4, 3], np.array([0.0, 0.02, 0.05])
    flight = fly_fleet(models, commands, seeds=seeds, delays=delays, poses=poses, settings=BAD_DAY)
    assert len(flight) == 3
    bounced = 0
    for b in range(3):
        twin = twin_of(
            models[b],
            commands[:, :, b],
            seed=seeds[b],
            pose=tuple(poses[:, b].tolist()),
            delay=delays[b],
        )
        time, state = twin.truth
        np.testing.assert_array_equal(flight.time, time)
        np.testing.assert_allclose(flight.state[:, :, b], state, atol=1e-8)
        assert flight.recording(b)["command"] == twin.recording()["command"]
        ours, theirs = flight.recording(b)["pose"], twin.recording()["pose"]
        np.testing.assert_array_equal(ours.stamp_ns, theirs.stamp_ns)
        np.testing.assert_array_equal(ours.received_ns, theirs.received_ns)
        np.testing.assert_allclose(ours.values, theirs.values, atol=1e-8)
        bounced += np.abs(state[:, 1]).max() > 0.9 * BAD_DAY.table.reach(0.07)[1]
    assert bounced


@pytest.mark.slow
def test_a_radio_without_a_delay_has_that_of_each_model():
    settings = QUIET.model_copy(update={"radio": Radio()})
    models = [MODEL.with_delay(delay) for delay in (0.0123, 0.04)]
    flight = fly_fleet(models, COMMAND, settings=settings)
    for b, model in enumerate(models):
        _, state = twin_of(MODEL, COMMAND, delay=model.transport_delay, settings=settings).truth
        np.testing.assert_allclose(flight.state[:, :, b], state, atol=1e-8)
        _, state = twin_of(model, COMMAND, settings=settings).truth
        np.testing.assert_allclose(flight.state[:, :, b], state, atol=1e-8)
    same = fly_fleet(models[0], COMMAND, settings=settings)
    np.testing.assert_array_equal(same.state[:, :, 0], flight.state[:, :, 0])


@pytest.mark.slow
@pytest.mark.parametrize("count", [1, 3, 6])
def test_the_number_of_craft_is_not_mistaken_for_another_axis(count, monkeypatch):
    # Axes of the coefficients have 2, 3 and 6 entries; some fleets do not fill batches of two.
    monkeypatch.setattr(fleet_module, "BATCH", 2)
    seeds = range(10, 10 + count)
    flight = fly_fleet(MODEL, COMMAND, seeds=seeds, settings=BAD_DAY)
    last = twin_of(MODEL, COMMAND, seed=seeds[-1]).truth[1]
    np.testing.assert_allclose(flight.state[:, :, -1], last, atol=1e-8)


def test_craft_that_share_everything_but_the_pose_move_alike():
    poses = np.array([[0.0, 0.1], [0.0, 0.1], [0.0, 0.0]])
    flight = fly_fleet(MODEL, COMMAND[:30], poses=poses, settings=QUIET)
    moved = flight.state[:, :, 1] - flight.state[:, :, 0]
    np.testing.assert_allclose(moved[:, :2], 0.1, atol=1e-12)
    np.testing.assert_allclose(moved[:, 2:], 0.0, atol=1e-12)


@pytest.mark.slow
def test_every_so_many_frames_are_those_of_all_frames():
    whole, part = (
        fly_fleet(MODEL, COMMAND, seeds=(1, 2), settings=BAD_DAY, every=k) for k in (1, 24)
    )
    np.testing.assert_array_equal(part.time, whole.time[::24])
    np.testing.assert_array_equal(part.state, whole.state[::24])
    with pytest.raises(InputError, match="every frame"):
        part.recording(0)


def test_a_slow_camera_does_not_make_long_steps():
    slow = QUIET.motion_capture.model_copy(update={"rate_hz": 30.0})
    coarse = fly_fleet(MODEL, COMMAND, settings=QUIET.model_copy(update={"motion_capture": slow}))
    fine = fly_fleet(MODEL, COMMAND, settings=QUIET)
    np.testing.assert_allclose(coarse.time, fine.time[::8], atol=1e-12)
    np.testing.assert_allclose(coarse.state, fine.state[::8], atol=1e-9)


def test_single_precision_is_near():
    double, single = (
        fly_fleet(MODEL, COMMAND, settings=QUIET, precision=p) for p in ("double", "single")
    )
    assert single.state.dtype == np.float32
    np.testing.assert_allclose(single.state, double.state, atol=1e-4)


@pytest.mark.slow
def test_flights_of_a_fleet_give_the_parameters_back():
    rng = np.random.default_rng(0)
    # One motor of each pair and its opposite, and back: the craft comes to rest, far from a rail.
    hall = QUIET.model_copy(update={"table": Table(length_m=200.0, width_m=200.0)})
    rows = []
    for _ in range(30):
        first, second = np.full((2, 6), 0.05)
        which, command = rng.integers(0, 2, 3), rng.uniform(0.05, 0.6, 3)
        first[np.arange(0, 6, 2) + which] = second[np.arange(1, 6, 2) - which] = command
        rows += [first] * 10 + [second] * 20 + [first] * 10
    flight = fly_fleet([MODEL, OTHER], np.array(rows), settings=hall)
    # The delay is found with the nominal lag, which is the first craft's.
    for b, (truth, near) in enumerate(((MODEL, 0.01), (OTHER, 0.06))):
        found = identify(preprocess(flight.recording(b)), "M3").model.parameters
        assert found.inertia == pytest.approx(truth.parameters.inertia, rel=near)
        # Thrust of all motors at half speed, 20 % apart.
        found, true = (p.thrust.sum(axis=0) @ [0.5, 0.25, 0.125] for p in (found, truth.parameters))
        assert found == pytest.approx(true, rel=near)


STALLS = Motors(stalls=(Stall(motor="motor_a_1", start_s=0.1, stop_s=0.2),))


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        ({"models": []}, "models"),
        ({"seeds": ()}, "seeds"),
        ({"seeds": (1, 2), "delays": np.zeros(3)}, "2 seeds, 3 delays"),
        ({"command": COMMAND[:, :4]}, "command"),
        ({"command": COMMAND[:0]}, "command"),
        ({"command": COMMAND + 0.2}, r"\[0, 1\]"),
        ({"command": np.where(COMMAND > 0.8, np.nan, COMMAND)}, r"\[0, 1\]"),
        ({"period": 0.0}, "period"),
        ({"delays": np.array([-0.01])}, "delays"),
        ({"every": 0}, "every"),
        ({"seeds": (1, -1)}, "seeds: must be from 0 to"),
        ({"models": [MODEL, replace(MODEL, frame="world")]}, "models"),
        ({"settings": QUIET.model_copy(update={"motors": STALLS})}, "Twin"),
    ],
)
def test_what_cannot_be_flown_is_refused(arguments, problem):
    given = {"models": MODEL, "command": COMMAND, **arguments}
    with pytest.raises(InputError, match=problem):
        fly_fleet(given.pop("models"), given.pop("command"), **given)


def test_values_of_no_such_kind_are_refused_where_nothing_checks_types():
    code = """
import numpy as np
from airpuck import InputError, fly_fleet, read_model

for field, value in (("every", 2.5), ("precision", "half"), ("seeds", (0.5,))):
    try:
        fly_fleet(read_model("paper:M3"), np.zeros((3, 6)), **{field: value})
    except InputError as error:
        assert error.field == field, error
    else:
        raise AssertionError(field)
"""
    subprocess.run([sys.executable, "-c", code], check=True)


def test_a_recording_needs_every_frame_though_only_the_first_was_kept():
    flight = fly_fleet(MODEL, COMMAND, settings=QUIET, every=1000)
    assert len(flight.time) == 1
    with pytest.raises(InputError, match="every frame"):
        flight.recording(0)
