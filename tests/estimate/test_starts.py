"""Failed starts of motors, in simulated flights whose starts are known."""

import numpy as np
import pytest

from airpuck.estimate.starts import StartMonitor
from airpuck.model.model_file import published_model

MODEL = published_model("M4")
IDLE, FRAME = MODEL.vehicle.command_min, 1 / 240
DUE = MODEL.transport_delay + float(MODEL.dynamics.motor_time_constant)
#: When a motor is commanded to start [s].
SENT = 0.3


def flown(motor: int, strength: float, *, turns_up: float, seed: int = 0):
    """Fly at a half, start one motor; return what a monitor reports, and the time it knew.

    The motor follows the command from `turns_up` after it acts; the cameras are noisy.
    """
    random, monitor = np.random.default_rng(seed), StartMonitor(MODEL)
    count = round(0.8 / FRAME)
    time = FRAME * np.arange(count)
    steady = np.full(6, 0.3)
    steady[motor] = IDLE
    command = np.tile(steady, (count, 1))
    command[time >= SENT + MODEL.transport_delay + turns_up, motor] = strength
    path = MODEL.simulate(np.concatenate([np.zeros(6), steady]), command, FRAME)
    pose = path[:, :3] + random.normal(0, [5e-5, 5e-5, 6e-4], (count, 3))
    # The command of a step acts until the next pose.
    time, found, sent = time + FRAME, [], 0
    for stamp, measured in zip(time, pose, strict=True):
        while 0.01 * sent <= stamp:
            asked = steady.copy()
            asked[motor] = strength if 0.01 * sent >= SENT - 1e-9 else IDLE
            monitor.command(0.01 * sent, asked)
            sent += 1
        found += monitor.pose(stamp, measured)
    # Every motor starts once at the beginning, when there are no poses to judge it by.
    return [one for one in found if one.sent > 0.1]


@pytest.mark.parametrize("motor", range(6))
def test_a_stalled_start_is_detected_within_50_ms_of_its_due_thrust(motor):
    (found,) = flown(motor, 0.6, turns_up=1.0, seed=motor)
    assert found.motor == motor
    assert found.sent == pytest.approx(SENT)
    assert SENT + DUE < found.noticed <= SENT + DUE + 0.05


@pytest.mark.parametrize("late", [0.0, 0.007, 0.015])
@pytest.mark.parametrize("motor", range(6))
def test_a_motor_that_starts_is_not_accused_even_if_its_packet_is_late(motor, late):
    assert flown(motor, 0.6, turns_up=late, seed=motor) == []


def test_starts_with_little_thrust_are_ignored():
    assert flown(2, 0.15, turns_up=1.0) == []
