"""A batch of twins against twins that fly alone."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from airpuck import InputError, Table, Twin, TwinBatch, TwinSettings
from airpuck.identification.fit import identify
from airpuck.model.model_file import published_model
from airpuck.preprocessing.pipeline import preprocess
from airpuck.twin.settings import (
    Effects,
    MotionCapture,
    Motors,
    OnBoard,
    Radio,
    Stall,
    read_twin_settings,
)

from ..apparatus import typechecker
from ..apparatus.changes import changed

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
).with_delay(0.05)
CAPTURE = MotionCapture(position_noise_m=0.0, yaw_noise_rad=0.0, latency_jitter_s=0.0)
PERIOD, SEEDS = 0.01, [5, 6, 7]
BLIND = OnBoard(rate_hz=0.0)
PLAIN = TwinSettings(radio=Radio(jitter_s=0.007), motion_capture=CAPTURE, on_board=BLIND)
BAD_DAY = TwinSettings(
    radio=Radio(jitter_s=0.02, loss=0.4, timeout_s=0.03, outages_s=((0.2, 0.3),)),
    motion_capture=changed(CAPTURE, rate_hz=100.0, latency_s=0.03, gaps_s=((0.5, 0.55),)),
    on_board=BLIND,
    effects=Effects(
        battery_sag_1_s=0.05,
        drag_linear_1_s=0.2,
        inflow_s_m=0.1,
        pair_interaction_1_N=0.4,
        tilt_rad=(0.004, -0.002),
    ),
    motors=Motors(unarmed_s=0.1),
)
#: Fast enough to reach the rails within a second.
COMMAND = np.repeat([[0.9, 0.2, 0.1, 0.8, 0.5, 0.05], [0.03, 0.6, 0.7, 0.2, 0.1, 0.9]], 60, axis=0)


def flown(models, commands, settings, *, starts, seeds=(0,), logs=False, period=PERIOD):
    """Fly given commands in open loop."""
    size = len(starts)
    batch = TwinBatch(
        models, size, period * len(commands), settings=settings, period=period, logs=logs
    )
    batch.reset(np.arange(size), np.array(starts), seeds)
    for row in commands:
        batch.step(np.broadcast_to(row, (size, 6)))
    return batch


@pytest.mark.parametrize("settings", [PLAIN, BAD_DAY], ids=["plain", "bad day"])
def test_each_craft_flies_like_a_twin(settings):
    rng = np.random.default_rng(1)
    starts = rng.uniform([-0.9, -0.4, -3.0], [0.9, 0.4, 3.0], (len(SEEDS), 3))
    batch = TwinBatch(MODEL, len(SEEDS), 1.0, settings=settings, rng=rng)
    batch.reset(np.arange(len(SEEDS)), starts, SEEDS)
    twins = [
        Twin(MODEL, settings, seed=seed, pose=tuple(start.tolist()))
        for seed, start in zip(SEEDS, starts, strict=True)
    ]
    seen = [(False, 0.0, np.zeros(3))] * len(twins)
    for k in range(1, 71):
        commands = rng.random((len(twins), 6))
        batch.step(commands)
        there, stamp, pose = batch.measured()
        for row, twin in enumerate(twins):
            twin.send(commands[row])
            for measurement in twin.wait_until(k * PERIOD):
                if measurement.kind == "pose":
                    seen[row] = True, measurement.stamp, measurement.values
            np.testing.assert_allclose(batch.state[:3, row], twin.state[:3], atol=1e-9)
            assert there[row] == seen[row][0]
            if there[row]:
                np.testing.assert_allclose(stamp[row], seen[row][1], atol=1e-9)
                np.testing.assert_allclose(pose[row], seen[row][2], atol=1e-9)


def test_waiting_craft_do_not_move_and_a_reset_starts_a_new_flight():
    batch = TwinBatch(MODEL, 2, 1.0, settings=PLAIN)
    start, command = np.array([[0.1, 0.2, 0.3]]), np.full((2, 6), 0.5)
    batch.reset(np.arange(2), np.repeat(start, 2, axis=0), [1, 1])
    for _ in range(20):
        batch.step(command, np.array([True, False]))
    np.testing.assert_array_equal(batch.state[:3, 1], start[0])
    assert np.abs(batch.state[:3, 0] - start[0]).max() > 1e-3
    for _ in range(20):
        batch.step(command, np.array([False, True]))
    np.testing.assert_allclose(batch.state[:, 0], batch.state[:, 1], atol=1e-12)
    batch.reset(np.array([1]), start, [1])
    assert batch.steps.tolist() == [20, 0]
    np.testing.assert_array_equal(batch.state[:, 1], [*start[0], *np.zeros(9)])


@pytest.mark.slow
@pytest.mark.parametrize("size", [3, 6])
def test_each_craft_obeys_its_own_model_and_logs_like_a_twin(size):
    # Axes of the coefficients have 2, 3 and 6 entries, which must not be mistaken for the craft.
    models = [MODEL, OTHER, MODEL, OTHER, MODEL, OTHER][:size]
    starts = np.array([[0.9, 0.0, -0.3], [0.3, -0.4, 0.0], [0.5, -0.4, 8.0], *np.zeros((3, 3))])
    seeds = [3, 4, 3, 10, 11, 12][:size]
    batch = flown(models, COMMAND, BAD_DAY, starts=starts[:size], seeds=seeds, logs=True)
    bounced = 0
    for row, (model, seed) in enumerate(zip(models, seeds, strict=True)):
        twin = Twin(model, BAD_DAY, seed=seed, pose=tuple(starts[row].tolist()))
        for k, command in enumerate(COMMAND):
            twin.wait_until(k * PERIOD)
            twin.send(command)
        twin.wait_until(len(COMMAND) * PERIOD)
        ours, theirs = batch.recording(row), twin.recording()
        assert ours["command"] == theirs["command"]
        np.testing.assert_array_equal(ours["pose"].stamp_ns, theirs["pose"].stamp_ns)
        np.testing.assert_array_equal(ours["pose"].received_ns, theirs["pose"].received_ns)
        np.testing.assert_allclose(ours["pose"].values, theirs["pose"].values, atol=1e-8)
        bounced += np.abs(twin.truth[1][:, 1]).max() > 0.9 * BAD_DAY.table.reach(0.07)[1]
    assert bounced


def test_the_final_state_is_at_the_end_of_the_last_period():
    # Both end at 0.49 s; the frames of the slow camera and of the fast one are at other times.
    ends = []
    for rate in (30.0, 240.0):
        settings = changed(PLAIN, motion_capture={"rate_hz": rate})
        batch = flown(MODEL, COMMAND[:49], settings, starts=np.zeros((1, 3)))
        ends.append(batch.final_state()[:, 0])
        assert np.abs(batch.state[:, 0] - ends[-1]).max() > 1e-4
    np.testing.assert_allclose(ends[0], ends[1], atol=1e-8)


@pytest.mark.slow
def test_batch_flights_recover_the_parameters():
    rng = np.random.default_rng(0)
    # One motor of each pair and its opposite, and back: the craft comes to rest, far from a rail.
    capture = MotionCapture(position_noise_m=5e-5, yaw_noise_rad=6e-4)
    hall = TwinSettings(
        radio=Radio(delay_s=5 / 240, jitter_s=0.0),
        table=Table(length_m=200.0, width_m=200.0),
        motion_capture=capture,
        on_board=BLIND,
    )
    rows: list[Any] = []
    for _ in range(30):
        first, second = np.full((2, 6), 0.05)
        which, command = rng.integers(0, 2, 3), rng.uniform(0.05, 0.6, 3)
        first[np.arange(0, 6, 2) + which] = second[np.arange(1, 6, 2) - which] = command
        rows += [first] * 10 + [second] * 20 + [first] * 10
    batch = flown([MODEL, OTHER], rows, hall, starts=np.zeros((2, 3)), seeds=(0, 0), logs=True)
    # The delay is found with the nominal lag, which is the first craft's.
    for b, (truth, near) in enumerate(((MODEL, 0.01), (OTHER, 0.06))):
        found = identify(preprocess(batch.recording(b)), "M3").model.parameters
        assert found.inertia == pytest.approx(truth.parameters.inertia, rel=near)
        # Thrust of all motors at half speed, 20 % apart.
        found, true = (p.thrust.sum(axis=0) @ [0.5, 0.25, 0.125] for p in (found, truth.parameters))
        assert found == pytest.approx(true, rel=near)


STALLS = Motors(stalls=(Stall(motor="motor_a_1", start_s=0.1, stop_s=0.2),))


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        ({"models": []}, "models"),
        ({"models": [MODEL] * 3}, r"models: must be one, or as many as there are craft \(2\)"),
        ({"models": [MODEL, replace(MODEL, frame="world")]}, "models"),
        ({"period": 0.0}, "period"),
        ({"settings": PLAIN.model_copy(update={"motors": STALLS})}, "Twin"),
        (
            {"settings": PLAIN.model_copy(update={"motors": Motors(starting_delay_s=0.1)})},
            "use Twin",
        ),
        ({"settings": read_twin_settings("paper:starts")}, "use Twin"),
    ],
)
def test_a_batch_rejects_unsupported_settings(arguments, problem):
    given = {"models": MODEL, "settings": PLAIN, **arguments}
    with pytest.raises(InputError, match=problem):
        TwinBatch(size=2, longest=1.0, **given)


def test_a_batch_rejects_invalid_commands_poses_and_seeds():
    batch = TwinBatch(MODEL, 2, 2 * PERIOD, settings=PLAIN)
    rows, poses, still = np.arange(2), np.zeros((2, 3)), np.zeros((2, 6))
    wrong: list[Any] = [(1, -1), (0.5, 1), (1,)]
    typechecker.pause()
    for seeds in wrong:
        with pytest.raises(InputError, match="seeds: must be"):
            batch.reset(rows, poses, seeds)
    with pytest.raises(InputError, match="poses"):
        batch.reset(rows, poses[:, :2], (1, 2))
    batch.reset(rows, poses, (1, 2))
    for commands in (still[:, :4], still + 1.1, np.where(still == 0, np.nan, 0)):
        with pytest.raises(InputError, match="commands"):
            batch.step(commands)
    with pytest.raises(InputError, match="logs=True"):
        batch.recording(0)
    for _ in range(2):
        batch.step(still)
    with pytest.raises(InputError, match="over after 2 steps"):
        batch.step(still)
