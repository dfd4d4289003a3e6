"""A batch of twins against twins that fly alone."""

from dataclasses import replace

import numpy as np
import pytest

from airpuck.boundary.errors import InputError
from airpuck.model.model_file import published_model
from airpuck.twin.batch import TwinBatch
from airpuck.twin.settings import Effects, MotionCapture, Motors, OnBoard, Radio, TwinSettings
from airpuck.twin.twin import Twin

MODEL = replace(published_model("M3"), frame="body")
CAPTURE = MotionCapture(position_noise_m=0.0, yaw_noise_rad=0.0, latency_jitter_s=0.0)
PERIOD, SEEDS = 0.01, [5, 6, 7]
BLIND = OnBoard(rate_hz=0.0)
PLAIN = TwinSettings(radio=Radio(jitter_s=0.007), motion_capture=CAPTURE, on_board=BLIND)
BAD_DAY = TwinSettings(
    radio=Radio(jitter_s=0.02, loss=0.4, timeout_s=0.03, outages_s=((0.2, 0.3),)),
    motion_capture=CAPTURE.model_copy(
        update={"rate_hz": 100.0, "latency_s": 0.03, "gaps_s": ((0.5, 0.55),)}
    ),
    on_board=BLIND,
    effects=Effects(battery_sag_1_s=0.05, drag_linear_1_s=0.2),
    motors=Motors(unarmed_s=0.1),
)


@pytest.mark.parametrize("settings", [PLAIN, BAD_DAY], ids=["plain", "bad day"])
def test_each_craft_flies_like_a_twin(settings):
    rng = np.random.default_rng(1)
    starts = rng.uniform([-0.9, -0.4, -3.0], [0.9, 0.4, 3.0], (len(SEEDS), 3))
    batch = TwinBatch(MODEL, settings, len(SEEDS), 1.0, PERIOD, rng)
    batch.reset(np.arange(len(SEEDS)), starts, SEEDS)
    twins = [
        Twin(MODEL, settings, seed=seed, pose=tuple(start.tolist()))
        for seed, start in zip(SEEDS, starts, strict=True)
    ]
    seen = [(False, 0.0, np.zeros(3))] * len(twins)
    for k in range(1, 71):
        commands = rng.random((len(twins), 6))
        batch.step(commands, np.ones(len(twins), bool))
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


def test_craft_that_wait_do_not_move_and_a_reset_begins_a_new_flight():
    batch = TwinBatch(MODEL, PLAIN, 2, 1.0, PERIOD, np.random.default_rng(0))
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


def test_faults_of_motors_need_a_twin():
    settings = PLAIN.model_copy(update={"motors": Motors(starting_delay_s=0.1)})
    with pytest.raises(InputError, match="use Twin"):
        TwinBatch(MODEL, settings, 1, 1.0, PERIOD, np.random.default_rng(0))
