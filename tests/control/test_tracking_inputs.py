"""The tracking controller with all kinds of wrong input."""

import re
import subprocess
import sys
import warnings
from itertools import count, takewhile

import numpy as np
import pytest

from airpuck import Fence, InputError, Measurement, SetPoint, Step, TrackingController
from airpuck.control.allocation import Daqp
from airpuck.control.law import Law
from airpuck.control.limits import KeepOut
from airpuck.control.lqr import LQR

from ..apparatus.closed_loops import FRAME, IDLE, MODEL, NOTHING, controller, hold_still, idles


def test_without_a_pose_the_motors_idle():
    ours = controller()
    idles(ours.step(0.0), "no pose")
    ours.pose(0.0, NOTHING)
    assert ours.step(0.0).flies


def restarts_at_rest(ours, time: float) -> None:
    """The next pose, 5 cm from the last one, restarts the estimate there."""
    ours.pose(time, np.array([0.05, 0.0, 0.0]))
    step = ours.step(time)
    assert step.flies
    np.testing.assert_allclose(step.request[0], ours.law.gain[0, 0] * 0.05, atol=0.02)


def test_a_stale_pose_idles_the_motors_until_the_next():
    ours = controller(SetPoint(0.1, 0, 0))
    last = hold_still(ours)
    assert ours.step(last + 0.049).flies
    idles(ours.step(last + 0.051), "stale pose")
    idles(ours.step(last + 10), "stale pose")
    restarts_at_rest(ours, last + 10)


@pytest.mark.parametrize("jump", [[0.2, 0, 0], [0, -0.2, 0], [0, 0, 2.0]])
def test_a_single_jump_idles_once_and_is_then_ignored(jump):
    ours, spared = controller(), controller()
    last = hold_still(ours)
    hold_still(spared)
    ours.pose(last + FRAME, np.array(jump))
    idles(ours.step(last + FRAME), "jumping pose")
    for one in (ours, spared):
        one.pose(last + 2 * FRAME, NOTHING)
    one, other = ours.step(last + 2 * FRAME), spared.step(last + 2 * FRAME)
    assert one.flies
    np.testing.assert_array_equal(one.command, other.command)


@pytest.mark.parametrize("jump", [[0.09, 0, 0], [0, 0.09, 0], [0, 0, 0.9], [0, 0, 2 * np.pi]])
def test_a_motion_within_the_crafts_limits_is_not_a_jump(jump):
    ours = controller()
    last = hold_still(ours)
    ours.pose(last + FRAME, np.array(jump))
    assert ours.step(last + FRAME).flies


@pytest.mark.parametrize("rate", [100.0, 1000.0, 2000.0])
def test_poses_are_accepted_after_a_time_not_a_count(rate):
    ours = controller()
    for k in range(12):
        ours.pose(k / rate, NOTHING)
    last = 11 / rate
    flown = []
    for k in range(1, 200):
        ours.pose(last + k / rate, np.array([0.5, 0.0, 0.0]))
        flown.append(ours.step(last + k / rate).flies)
    # Counted from the first one there.
    assert 0.0499 < flown.index(True) / rate < 0.0501


@pytest.mark.parametrize("seed", range(3))
def test_random_poses_are_never_accepted(seed):
    random = np.random.default_rng(seed)
    ours = controller()
    last = hold_still(ours)
    for k in range(1, 241):
        # Anywhere on the table except where the craft is.
        x, yaw = random.uniform(0.2, 1) * random.choice([-1, 1]), random.uniform(-3, 3)
        ours.pose(last + k * FRAME, np.array([x, random.uniform(-0.5, 0.5), yaw]))
        idles(ours.step(last + k * FRAME), "jumping pose")


def test_after_a_long_pause_an_old_prediction_does_not_validate_a_pose():
    ours = controller()
    last = hold_still(ours)
    for k in range(1, 25):
        ours.pose(last + k * FRAME, np.array([0.5 * (-1) ** k, 0, 0]))
    ours.pose(last + 25 * FRAME, NOTHING)
    idles(ours.step(last + 25 * FRAME), "jumping pose")
    for k in range(26, 25 + 13):
        ours.pose(last + k * FRAME, NOTHING)
    assert ours.step(last + 37 * FRAME).flies


def test_alternating_poses_are_rejected_for_50_ms():
    ours = controller()
    last = hold_still(ours)
    for k in takewhile(lambda k: k * FRAME < 0.05, count(1)):
        ours.pose(last + k * FRAME, np.array([0.5 * (-1) ** k, 0, 0]))
        idles(ours.step(last + k * FRAME), "jumping pose")
    ours.pose(last + 0.0499, NOTHING)
    assert ours.step(last + 0.0499).flies


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_nan_pose_idles_the_motors_until_the_next_pose(bad):
    ours = controller()
    last = hold_still(ours)
    for place in range(3):
        pose = np.zeros(3)
        pose[place] = bad
        ours.pose(last + 1e-3, pose)
        idles(ours.step(last + 1e-3), "bad input")
    ours.pose(bad, NOTHING)
    idles(ours.step(last + 1e-3), "bad input")
    ours.pose(last + FRAME, NOTHING)
    assert ours.step(last + FRAME).flies


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_a_nan_time_idles_the_motors_once(bad):
    ours = controller()
    last = hold_still(ours)
    idles(ours.step(bad), "bad input")
    assert ours.step(last).flies


@pytest.mark.parametrize("kind", [tuple, list])
def test_a_pose_may_be_any_three_numbers(kind):
    ours, same = controller(), controller()
    for k in range(12):
        ours.pose(k * FRAME, kind((0.001 * k, 0, 0)))
        same.pose(k * FRAME, np.array([0.001 * k, 0, 0]))
    np.testing.assert_array_equal(ours.step(0.05).command, same.step(0.05).command)


@pytest.mark.parametrize("pose", [(0.0, 0.0), np.zeros(6), np.zeros((1, 3))])
def test_a_pose_of_the_wrong_shape_is_rejected_without_side_effects(pose):
    ours = controller()
    with pytest.raises(InputError, match="must be 3 numbers"):
        ours.pose(0.0, pose)
    idles(ours.step(0.0), "no pose")
    last = hold_still(ours)
    with pytest.raises(InputError, match="must be 3 numbers"):
        ours.pose(last + FRAME, pose)
    assert ours.step(last).flies


def test_arrays_of_the_caller_are_copied():
    ours, same = controller(), controller()
    pose, command = np.zeros(3), np.zeros(6)
    for k in range(60):
        now = k / 100
        pose[:], command[:] = [0.001 * k, 0, 0], 0.03
        command[k % 6] = 0.6
        for one, copied in ((ours, False), (same, True)):
            one.pose(now, pose.copy() if copied else pose)
            one.sent(now, command.copy() if copied else command)
    expected = same.filter.predict(0.59)
    np.testing.assert_array_equal(ours.filter.predict(0.59).motor_speed, expected.motor_speed)
    # Also among doubtful poses: each agrees with its predecessor only.
    for k in range(1, 26):
        pose[:] = [0.5 * (-1) ** k, 0, 0]
        ours.pose(0.59 + k * FRAME, pose)
        idles(ours.step(0.59 + k * FRAME), "jumping pose")


@pytest.mark.parametrize("compiled", [True, False])
def test_a_returned_command_is_a_copy(compiled):
    ours = controller(compiled=compiled)
    for last in (0.0, hold_still(ours)):
        step = ours.step(last)
        kept = step.command.copy()
        step.command[:] = 7.0
        np.testing.assert_array_equal(ours.step(last).command, kept)


def flown(told, steps: int = 40) -> tuple[TrackingController, Step]:
    """Hold a pose; `told` changes each command that is reported to the controller."""
    ours = controller(SetPoint(0.05, 0, 0))
    step = ours.step(0.0)
    for k in range(steps):
        now = k / 100
        ours.pose(now, NOTHING)
        step = ours.step(now + 0.001)
        ours.sent(*told(k, now + 0.001, step.command))
    return ours, step


def test_the_filter_uses_on_board_sensors_with_the_noise_of_the_tuning(monkeypatch):
    ours, heard = controller(), []
    ours.pose(0.0, NOTHING)
    for kind in ("imu", "mouse"):
        monkeypatch.setattr(ours.filter, kind, lambda *given: heard.append(given))
    ours.measured(Measurement("imu", 0.01, np.array([0.1, 0.2, 9.8, 7.0, 8.0, 0.3])))
    ours.measured(Measurement("mouse", 0.02, np.array([0.4, 0.5])))
    ours.measured(Measurement("mouse", 0.2, np.array([0.4, 0.5])))  # long after the last pose
    (time, planar, spin, noises), mouse = heard
    noise = ours.tuning.estimation
    assert (time, spin) == (0.01, 0.3)
    np.testing.assert_array_equal(planar, [0.1, 0.2])
    assert noises == (noise.imu_acceleration_m_s2, noise.gyro_rad_s)
    np.testing.assert_array_equal(mouse[1], [0.4, 0.5])
    assert (mouse[0], mouse[2]) == (0.02, noise.mouse_m_s)


@pytest.mark.parametrize("wrong", [-np.inf, np.inf, np.nan])
def test_before_the_first_step_a_command_without_a_time_is_ignored(wrong):
    ours = controller()
    ours.sent(wrong, np.full(6, 0.5))
    ours.pose(0.0, NOTHING)
    np.testing.assert_allclose(ours.filter.predict(1.0).motor_speed, IDLE)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_a_sent_nan_command_is_ignored(bad):
    def told(k, time, command):
        return time, np.where(np.arange(6) == 2, bad, command) if k == 20 else command

    _, step = flown(told)
    assert step.flies
    assert step.estimate is not None
    assert np.isfinite(step.estimate.motor_speed).all()
    # The previous command stays in force for one more period.
    _, other = flown(lambda k, time, command: (time, command))
    np.testing.assert_allclose(step.command, other.command, atol=0.05)


@pytest.mark.parametrize("wrong", [1000.0, 1.0, np.nan, np.inf, -np.inf, 0.045])
def test_an_impossible_sending_time_is_replaced_and_delays_no_other(wrong):
    _, step = flown(lambda k, time, command: (time + wrong if k == 20 else time, command))
    _, other = flown(lambda k, time, command: (time, command))
    tolerance = 0.02 if wrong == 0.045 else 0.0
    np.testing.assert_allclose(step.command, other.command, rtol=0, atol=tolerance)


@pytest.mark.parametrize("command", [np.zeros(4), [0.1] * 7, np.zeros((6, 1))])
def test_a_sent_command_of_the_wrong_shape_is_rejected_without_effect(command):
    ours = controller()
    last = hold_still(ours)
    with pytest.raises(InputError, match="must be 6 numbers"):
        ours.sent(last, command)
    ours.pose(last + FRAME, NOTHING)
    assert ours.step(last + FRAME).flies


@pytest.mark.parametrize("poses", [0, 12])
def test_a_camera_pause_keeps_memory_bounded_and_the_motor_estimate(poses):
    ours = controller()
    hold_still(ours, poses)
    random = np.random.default_rng(0)
    commands = random.uniform(0.03, 0.6, (3000, 6))
    for k, command in enumerate(commands):
        assert not ours.step(0.2 + k / 100).flies
        ours.sent(0.2 + k / 100, command)
        assert len(ours.filter._commands) < 70
    end = 0.2 + 30.0
    ours.pose(end, NOTHING)
    speed, now, acting = IDLE, 0.2, IDLE
    tau = float(MODEL.dynamics.motor_time_constant)
    for k, command in enumerate([*commands, None]):
        begins = 0.2 + k / 100 + MODEL.transport_delay if command is not None else end
        begins = min(begins, end)
        speed = acting + (speed - acting) * np.exp(-(begins - now) / tau)
        now, acting = begins, acting if command is None or begins == end else command
    np.testing.assert_allclose(ours.filter.predict(end).motor_speed, speed, rtol=1e-9)
    assert ours.step(end).flies


def test_a_stamp_in_the_future_idles_the_motors_until_the_next_pose():
    ours = controller(SetPoint(0.1, 0, 0))
    last = hold_still(ours)
    ours.pose(last + 10, NOTHING)
    idles(ours.step(last + FRAME), "stale pose")
    restarts_at_rest(ours, last + 2 * FRAME)


def test_a_failing_solver_idles_the_motors_until_it_works(monkeypatch):
    ours = controller(SetPoint(0.1, 0, 0))
    last = hold_still(ours)
    before = ours.step(last)
    assert before.flies
    with monkeypatch.context() as broken:
        broken.setattr(Daqp, "constrained", lambda *_: None)
        broken.setattr(Daqp, "nearest", lambda *_: None)
        idles(ours.step(last), "failed")
    np.testing.assert_array_equal(ours.step(last).command, before.command)


def test_limits_are_checked_when_set_and_kept_at_every_step():
    ours, fence = controller(law=Walled), Fence(-0.5, -0.4, 0.5, 0.4)
    for wrong in (fence, None, [(0.0, 0.0, 0.1)]):
        with pytest.raises(InputError, match="limits: must be a list of Fence, KeepOut and"):
            ours.limits = wrong  # pyright: ignore[reportAttributeAccessIssue]
    for apart in (Fence(0.6, -0.4, 0.9, 0.4), Fence(-0.5, 0.5, 0.5, 0.9)):
        with pytest.raises(InputError, match="limits: must leave a place that is within all"):
            ours.limits = [apart, fence]
    assert ours.limits == ()
    ours.limits = (one for one in [fence, Fence(0.0, 0.0, 0.9, 0.9)])
    assert ours.limits == (fence, Fence(0.0, 0.0, 0.9, 0.9))


class Walled(Law):
    """A law of a user that reads the limits of the moment."""

    obeys_limits = True


def test_a_warning_about_limits_names_the_line_of_the_user(tmp_path):
    (tmp_path / "own.py").write_text(
        "import airpuck\nkeep = [airpuck.KeepOut(0.3, 0.0, 0.1)]\n"
        "craft, here = airpuck.read_model('paper:M3'), airpuck.SetPoint(0.0, 0.0, 0.0)\n"
        "ours = airpuck.TrackingController(craft, here, limits=keep)\nours.limits = keep\n"
    )
    told = subprocess.run([sys.executable, tmp_path / "own.py"], capture_output=True, text=True)
    assert re.findall(r"own.py:(\d): UserWarning", told.stderr) == ["4", "5"]


def test_a_law_without_limits_rejects_hard_ones_and_warns_about_soft_ones(tmp_path):
    hard, soft = Fence(-0.5, -0.3, 0.5, 0.3, hard=True), KeepOut(0.3, 0.0, 0.1)
    (tmp_path / "deaf.py").write_text("import airpuck\nclass Deaf(airpuck.Law): ...\n")
    for law in ("lqr", "plan", LQR, type("Deaf", (Law,), {}), f"{tmp_path}/deaf.py:Deaf"):
        remedy = 'use law="mpc"$' if law in ("lqr", "plan", LQR) else "if .* `obeys_limits = True`"
        refused = f"^limits: are ignored by [a-z ]+; {remedy}"
        with pytest.raises(InputError, match=refused):
            controller(law=law, limits=[soft, hard])
        with pytest.warns(UserWarning, match="limits are ignored by"):
            ours = controller(law=law, limits=[soft])
        with pytest.raises(InputError, match=refused):
            ours.limits = [hard]
        assert ours.limits == (soft,)
    (tmp_path / "law.py").write_text(
        "import airpuck\nclass Mine(airpuck.Law):\n    obeys_limits = True\n"
    )
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for law in ("mpc", Walled, f"{tmp_path}/law.py:Mine"):
            assert controller(law=law, limits=[hard, soft]).limits == (hard, soft)
        controller(limits=[])
