"""The tracking controller: closed loops on simulated craft, and everything that can go wrong."""

from dataclasses import replace
from itertools import count, takewhile
from pathlib import Path

import control
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from airpuck.control.allocation import Daqp
from airpuck.control.discretization import motor_lag
from airpuck.control.reference import Reference, SetPoint, SetPoints, TimedPath
from airpuck.control.tracking import Step, TrackingController
from airpuck.errors import InputError
from airpuck.estimate.estimator import Estimate
from airpuck.model.parameters import nominal_parameters
from airpuck.model.rigid_body import acceleration, derivative
from airpuck.model_file import read_model
from airpuck.vehicle import Vehicle

MODEL = read_model("paper:M4")
LEAST = MODEL.vehicle.command_min
IDLE = np.full(6, LEAST)
HOME = SetPoint(0.0, 0.0, 0.0)
FRAME = 1 / 240
NOTHING = np.zeros(3)
LONG = 0.15  # transport delay of a slow radio [s]


def controller(reference: Reference = HOME, **options) -> TrackingController:
    return TrackingController(MODEL, reference, **{"compiled": False, **options})


def fly(
    ours: TrackingController,
    duration: float,
    push: np.ndarray = NOTHING,
    delay: float = MODEL.transport_delay,
    start: np.ndarray = NOTHING,
) -> tuple[np.ndarray, np.ndarray, list[Step]]:
    """Fly the published M4 under an extra acceleration: times, poses and steps at 100 Hz.

    Runge and Kutta's method, with a pose 200 times a second.
    """
    h, dynamics = 1 / 200, MODEL.dynamics

    def rate(z: np.ndarray, command: np.ndarray) -> np.ndarray:
        slope = derivative(np, dynamics, z, command)
        slope[3:6] += push
        return slope

    z = np.concatenate([start, np.zeros(3), IDLE])
    sent: list[tuple[float, np.ndarray]] = []
    steps, times, poses, acting = [], [], [], IDLE
    for k in range(round(duration / h)):
        now = k * h
        ours.pose(now, z[:3].copy())
        if k % 2 == 0:
            step = ours.step(now)
            ours.sent(now, step.command)
            sent.append((now + delay, step.command))
            steps.append(step)
            times.append(now)
            poses.append(z[:3])
        # Parts of the step with one command each.
        begin = now
        while begin < now + h - 1e-12:
            if sent and sent[0][0] <= begin + 1e-12:
                acting = sent.pop(0)[1]
                continue
            end = min(now + h, sent[0][0]) if sent else now + h
            d = end - begin
            k1 = rate(z, acting)
            k2 = rate(z + d / 2 * k1, acting)
            k3 = rate(z + d / 2 * k2, acting)
            z = z + d / 6 * (k1 + 2 * k2 + 2 * k3 + rate(z + d * k3, acting))
            begin = end
    return np.array(times), np.array(poses), steps


def hold_still(ours: TrackingController, frames: int = 12, x: float = 0.0) -> float:
    """Feed good poses; return the time of the last."""
    for k in range(frames):
        ours.pose(k * FRAME, np.array([x, 0, 0]))
    return (frames - 1) * FRAME


def test_the_loop_on_the_nominal_craft_is_python_controls_linear_one():
    # While nothing saturates, what the motors give is what the regulator asked for one period ago:
    # x⁺ = A x + B v, v⁺ = -K (x⁺ - target). Thrusts, motors and turning drop out.
    target = np.array([0.02, -0.03, 0.4, 0, 0, 0])
    ours = controller(SetPoint(*target[:3].tolist()))
    h, dynamics = ours.tuning.period_s, MODEL.dynamics
    lag, drive = motor_lag(float(dynamics.motor_time_constant), h)
    double = control.ss(np.eye(6, k=3), np.eye(6, 3, k=-3), np.eye(6), np.zeros((6, 3)))
    plant, k = control.c2d(double, h, "zoh"), ours.gain
    # Motors that already hold a middle thrust, for the request to be met from the beginning.
    speed = np.full(6, 0.35)
    x = np.zeros(6)
    first = np.array(acceleration(np, dynamics, x[2:], speed))
    states = [x]
    for _ in range(400):
        step = ours.steer(Estimate(0.0, x, speed, NOTHING), ours.reference.at(0.0, 0.0))
        assert step.status == "exact"
        given = np.array(acceleration(np, dynamics, x[2:], speed))
        x = plant.A @ x + plant.B @ given
        speed = lag * speed + drive * step.command
        states.append(x)
    # Theirs, with the acceleration among the states.
    a = np.block([[plant.A, plant.B], [-k @ plant.A, -k @ plant.B]])
    b = np.vstack([np.zeros((6, 6)), k])
    loop = control.ss(a, b, np.eye(9), np.zeros((9, 6)), dt=h)
    response = control.forced_response(
        loop,
        np.arange(401) * h,
        np.tile(target[:, None], 401),  # pyright: ignore[reportArgumentType]
        np.append(np.zeros(6), first),  # pyright: ignore[reportArgumentType]
    )
    theirs = np.asarray(response.outputs)[:6].T
    np.testing.assert_allclose(np.array(states), theirs, atol=1e-9)
    np.testing.assert_allclose(states[-1], target, atol=1e-3)


def test_compiled_and_numpy_give_the_same_commands():
    random = np.random.default_rng(0)
    pair = [controller(SetPoint(0.05, 0, 0.3), compiled=c) for c in (True, False)]
    pose, outcomes = np.zeros(3), set()
    for k in range(150):
        now = k / 100
        pose = pose + 0.003 * random.normal(size=3)
        for one in pair:
            one.pose(now, pose)
        steps = [one.step(now + 0.002) for one in pair]
        assert steps[0].status == steps[1].status
        outcomes.add(steps[0].status)
        np.testing.assert_allclose(steps[0].command, steps[1].command, atol=1e-7)
        np.testing.assert_allclose(steps[0].request, steps[1].request, rtol=1e-7, atol=1e-7)
        for one, step in zip(pair, steps, strict=True):
            one.sent(now + 0.002, step.command)
    assert len(outcomes) > 1


def idles(step: Step, status: str) -> None:
    assert step.status == status
    assert not step.flies
    np.testing.assert_array_equal(step.command, IDLE)


def test_without_a_pose_the_motors_idle():
    ours = controller()
    idles(ours.step(0.0), "no pose")
    ours.pose(0.0, NOTHING)
    assert ours.step(0.0).flies


def test_a_stale_pose_idles_the_motors_until_the_next():
    ours = controller(SetPoint(0.1, 0, 0))
    last = hold_still(ours)
    assert ours.step(last + 0.049).flies
    idles(ours.step(last + 0.051), "stale pose")
    idles(ours.step(last + 10), "stale pose")
    ours.pose(last + 10, np.array([0.05, 0.0, 0.0]))
    step = ours.step(last + 10)
    assert step.flies
    # Begun anew there, at rest.
    np.testing.assert_allclose(step.request[0], ours.gain[0, 0] * 0.05, atol=0.02)


@pytest.mark.parametrize("jump", [[0.2, 0, 0], [0, -0.2, 0], [0, 0, 2.0]])
def test_a_single_jump_idles_once_and_is_forgotten(jump):
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
def test_what_a_craft_can_do_is_no_jump(jump):
    ours = controller()
    last = hold_still(ours)
    ours.pose(last + FRAME, np.array(jump))
    assert ours.step(last + FRAME).flies


@pytest.mark.parametrize("rate", [240.0, 400.0])
def test_a_craft_that_was_moved_is_believed_after_50_ms(rate):
    ours = controller()
    last = hold_still(ours)
    flown = {}
    for k in range(1, 40):
        now = last + k / rate
        ours.pose(now, np.array([0.5, 0.0, 0.0]))
        step = ours.step(now)
        flown[k] = step.flies
        if not step.flies:
            idles(step, "jumping pose")
        elif step.estimate is not None:
            assert step.estimate.state[0] == pytest.approx(0.5, abs=0.01)
    first = min(k for k, flies in flown.items() if flies)
    assert all(flies for k, flies in flown.items() if k >= first)
    assert 0.025 < first / rate <= 0.055


@pytest.mark.parametrize("rate", [100.0, 1000.0, 2000.0])
def test_it_is_time_that_makes_poses_credible_not_their_number(rate):
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
def test_poses_at_random_are_never_believed(seed):
    random = np.random.default_rng(seed)
    ours = controller()
    last = hold_still(ours)
    for k in range(1, 241):
        # Anywhere on the table but where the craft is.
        x, yaw = random.uniform(0.2, 1) * random.choice([-1, 1]), random.uniform(-3, 3)
        ours.pose(last + k * FRAME, np.array([x, random.uniform(-0.5, 0.5), yaw]))
        idles(ours.step(last + k * FRAME), "jumping pose")


def test_after_long_doubts_the_old_prediction_is_no_reason_to_believe():
    ours = controller()
    last = hold_still(ours)
    for k in range(1, 25):
        ours.pose(last + k * FRAME, np.array([0.5 * (-1) ** k, 0, 0]))
    ours.pose(last + 25 * FRAME, NOTHING)
    idles(ours.step(last + 25 * FRAME), "jumping pose")
    for k in range(26, 25 + 13):
        ours.pose(last + k * FRAME, NOTHING)
    assert ours.step(last + 37 * FRAME).flies


def test_poses_that_jump_to_and_fro_are_not_believed_for_50_ms():
    ours = controller()
    last = hold_still(ours)
    for k in takewhile(lambda k: k * FRAME < 0.05, count(1)):
        ours.pose(last + k * FRAME, np.array([0.5 * (-1) ** k, 0, 0]))
        idles(ours.step(last + k * FRAME), "jumping pose")
    ours.pose(last + 0.0499, NOTHING)
    assert ours.step(last + 0.0499).flies


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_pose_that_is_not_a_number_idles_the_motors_until_the_next(bad):
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
def test_a_time_that_is_not_a_number_idles_the_motors_once(bad):
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
def test_a_pose_of_another_shape_is_refused_and_leaves_no_trace(pose):
    ours = controller()
    with pytest.raises(InputError, match="give 3 numbers"):
        ours.pose(0.0, pose)
    idles(ours.step(0.0), "no pose")
    last = hold_still(ours)
    with pytest.raises(InputError, match="give 3 numbers"):
        ours.pose(last + FRAME, pose)
    assert ours.step(last).flies


def test_arrays_that_the_caller_uses_again_are_copied():
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
    # Among poses in doubt too: each agrees with the one before, none with itself.
    for k in range(1, 26):
        pose[:] = [0.5 * (-1) ** k, 0, 0]
        ours.pose(0.59 + k * FRAME, pose)
        idles(ours.step(0.59 + k * FRAME), "jumping pose")


@pytest.mark.parametrize("compiled", [True, False])
def test_commands_belong_to_the_caller(compiled):
    ours = controller(compiled=compiled)
    for last in (0.0, hold_still(ours)):
        step = ours.step(last)
        kept = step.command.copy()
        step.command[:] = 7.0
        np.testing.assert_array_equal(ours.step(last).command, kept)


def flown(told, steps: int = 40) -> tuple[TrackingController, Step]:
    """Fly at one place; `told` changes what the controller hears of each command."""
    ours = controller(SetPoint(0.05, 0, 0))
    step = ours.step(0.0)
    for k in range(steps):
        now = k / 100
        ours.pose(now, NOTHING)
        step = ours.step(now + 0.001)
        ours.sent(*told(k, now + 0.001, step.command))
    return ours, step


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_a_sent_command_that_is_not_a_number_is_taken_as_not_sent(bad):
    def told(k, time, command):
        return time, np.where(np.arange(6) == 2, bad, command) if k == 20 else command

    _, step = flown(told)
    assert step.flies
    assert step.estimate is not None
    assert np.isfinite(step.estimate.motor_speed).all()
    # What was sent before stays in force for the time of one more command.
    _, other = flown(lambda k, time, command: (time, command))
    np.testing.assert_allclose(step.command, other.command, atol=0.05)


@pytest.mark.parametrize("wrong", [1000.0, 1.0, np.nan, np.inf, -np.inf])
def test_a_command_is_sent_now_if_its_time_cannot_be(wrong):
    def told(k, time, command):
        return (time + wrong if k == 20 else time), command

    ours, step = flown(told)
    _, other = flown(lambda k, time, command: (time, command))
    np.testing.assert_array_equal(step.command, other.command)
    assert len(ours.filter._pending) < 5


def test_a_command_stamped_a_little_late_does_not_hold_up_the_next():
    ours, step = flown(lambda k, time, command: (time + 0.045 * (k == 20), command))
    _, other = flown(lambda k, time, command: (time, command))
    np.testing.assert_allclose(step.command, other.command, atol=0.02)
    assert len(ours.filter._pending) < 5


@pytest.mark.parametrize("command", [np.zeros(4), [0.1] * 7, np.zeros((6, 1))])
def test_a_sent_command_of_another_shape_is_refused_and_leaves_no_trace(command):
    ours = controller()
    last = hold_still(ours)
    with pytest.raises(InputError, match="give 6 numbers"):
        ours.sent(last, command)
    ours.pose(last + FRAME, NOTHING)
    assert ours.step(last + FRAME).flies


@pytest.mark.parametrize("poses", [0, 12])
def test_a_pause_of_the_cameras_costs_neither_memory_nor_knowledge_of_the_motors(poses):
    ours = controller()
    hold_still(ours, poses)
    random = np.random.default_rng(0)
    commands = random.uniform(0.03, 0.6, (3000, 6))
    for k, command in enumerate(commands):
        assert not ours.step(0.2 + k / 100).flies
        ours.sent(0.2 + k / 100, command)
        assert len(ours.filter._pending) < 70
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


def test_an_old_pose_is_ignored():
    ours, spared = controller(), controller()
    last = hold_still(ours)
    hold_still(spared)
    ours.pose(last, np.array([0.05, 0, 0]))
    ours.pose(last - 0.02, np.array([0.05, 0, 0]))
    np.testing.assert_array_equal(ours.step(last).command, spared.step(last).command)


def test_a_stamp_in_the_future_idles_the_motors_until_the_next_pose():
    ours = controller(SetPoint(0.1, 0, 0))
    last = hold_still(ours)
    ours.pose(last + 10, NOTHING)
    idles(ours.step(last + FRAME), "stale pose")
    ours.pose(last + 2 * FRAME, np.array([0.05, 0.0, 0.0]))
    step = ours.step(last + 2 * FRAME)
    assert step.flies
    # Begun anew there, at rest.
    np.testing.assert_allclose(step.request[0], ours.gain[0, 0] * 0.05, atol=0.02)


def test_a_solver_that_fails_idles_the_motors_until_it_works(monkeypatch):
    ours = controller(SetPoint(0.1, 0, 0))
    last = hold_still(ours)
    before = ours.step(last)
    assert before.flies
    with monkeypatch.context() as broken:
        broken.setattr(Daqp, "constrained", lambda *_: None)
        broken.setattr(Daqp, "nearest", lambda *_: None)
        idles(ours.step(last), "failed")
    np.testing.assert_array_equal(ours.step(last).command, before.command)


@pytest.mark.parametrize("far", [SetPoint(100, -100, 0), SetPoint(0, 0, 3.1), SetPoint(1e6, 0, 0)])
def test_a_request_too_large_is_no_error(far):
    ours = controller(far)
    last = hold_still(ours)
    step = ours.step(last)
    assert step.flies
    assert step.status in ("scaled", "nearest")
    # As far as it goes, towards the target: the direction is kept.
    x = step.estimate
    assert x is not None
    lag, drive = motor_lag(float(MODEL.dynamics.motor_time_constant), ours.tuning.period_s)
    given = np.array(
        acceleration(np, MODEL.dynamics, x.state[2:], lag * x.motor_speed + drive * step.command)
    )
    assert given @ step.request > 0


def test_a_disturbance_is_rejected():
    push = np.array([0.1, -0.06, 2.0])
    ours = controller(compiled=True)
    _, poses, steps = fly(ours, 4.0, push)
    np.testing.assert_allclose(poses[-50:, :2], 0, atol=3e-4)
    np.testing.assert_allclose(poses[-50:, 2], 0, atol=3e-3)
    estimate = steps[-1].estimate
    assert estimate is not None
    np.testing.assert_allclose(estimate.disturbance, push, rtol=0.05)


def test_without_rejection_the_offset_is_disturbance_over_gain():
    push = np.array([0.1, -0.06, 2.0])
    ours = controller(compiled=True, reject_disturbance=False)
    _, poses, _ = fly(ours, 4.0, push)
    # At rest nothing accelerates: 0 = -K e + d.
    gains = np.diag(ours.gain[:, :3])
    np.testing.assert_allclose(poses[-50:].mean(axis=0), push / gains, rtol=0.03)


def test_set_points_are_reached_and_the_yaw_turns_the_shorter_way():
    points = [(0.0, 0.0, 0.0), (0.3, -0.2, 1.5), (0.1, 0.2, -2.5), (0.1, 0.2, 2.8)]
    ours = controller(SetPoints([0.0, 0.5, 3.5, 6.5], points), compiled=True)
    times, poses, steps = fly(ours, 9.5)
    for end, point in ((3.5, points[1]), (6.5, points[2]), (9.5, points[3])):
        arrived = poses[(times > end - 0.3) & (times < end)]
        turn = (arrived[:, 2] - point[2] + np.pi) % (2 * np.pi) - np.pi
        np.testing.assert_allclose(arrived[:, :2], [point[:2]] * len(arrived), atol=2e-3)
        np.testing.assert_allclose(turn, 0, atol=2e-2)
    # From 1.5 on to -2.5 + 2π, then on by -0.98 to 2.8: never below zero, never a turn too much.
    assert poses[:, 2].min() > -0.1
    assert poses[:, 2].max() < 2 * np.pi - 2.5 + 0.5
    commands = np.array([step.command for step in steps])
    assert (commands >= LEAST).all()
    assert (commands <= MODEL.vehicle.command_max).all()
    assert all(step.flies for step in steps)


def test_a_path_is_followed_closely_thanks_to_its_feed_forward():
    times = np.linspace(0, 4, 41)
    angle = 2 * np.pi * np.clip(times - 0.5, 0, 3) / 3
    circle = np.stack([0.15 * (1 - np.cos(angle)), 0.15 * np.sin(angle), 0 * angle], axis=1)
    path = TimedPath(times, circle)

    class Bare:
        """The same poses, without rates and accelerations."""

        def at(self, now, ahead):
            target = path.at(now, ahead)
            state = np.append(target.state[:3], np.zeros(3))
            return replace(target, state=state, acceleration=np.zeros(3))

    errors = []
    for reference in (path, Bare()):
        flown, poses, _ = fly(controller(reference, compiled=True), 3.4)
        wanted = np.array([path.at(float(t), 0.0).state[:2] for t in flown])
        errors.append(np.abs(poses[:, :2] - wanted)[flown > 1.5].max())
    assert errors[0] < 0.01
    assert errors[0] < 0.2 * errors[1]


def test_a_path_is_followed_in_time_though_the_radio_is_slow():
    # 0.3 m/s: a path read one transport delay too early or too late is 5 cm away.
    times = np.linspace(0, 4, 41)
    angle = 2 * np.pi * np.clip(times - 0.5, 0, 3) / 3
    circle = np.stack([0.15 * (1 - np.cos(angle)), 0.15 * np.sin(angle), 0 * angle], axis=1)
    path = TimedPath(times, circle)
    late = replace(MODEL, transport_delay=LONG)
    when, poses, _ = fly(TrackingController(late, path), 3.4, delay=LONG)
    wanted = np.array([path.at(float(t), 0.0).state[:2] for t in when])
    assert np.abs(poses[:, :2] - wanted)[when > 1.5].max() < 0.012


def test_a_reference_is_asked_for_when_the_command_will_have_acted():
    asked = []

    class Asked:
        def at(self, now, ahead):
            asked.append((now, ahead))
            return HOME.at(now, ahead)

    ours = controller(Asked())
    last = hold_still(ours)
    ours.step(last + 0.001)
    assert asked == [(last + 0.001, MODEL.transport_delay + ours.tuning.period_s)]


def test_with_the_delay_compensated_the_craft_flies_as_without_one_only_later():
    # Smith's predictor, with a perfect model.
    target, flown = SetPoint(0.02, -0.01, 1.0), {}
    for delay, compensated in ((0.0, True), (LONG, True), (LONG, False)):
        late = replace(MODEL, transport_delay=delay)
        ours = TrackingController(late, target, compensate_delay=compensated)
        _, flown[delay, compensated], _ = fly(ours, 2.0, delay=delay)
    prompt, shift = flown[0.0, True], round(LONG / 0.01)
    # What is left is the drift with idling motors until the first command arrives.
    np.testing.assert_allclose(flown[LONG, True][shift:], prompt[:-shift], atol=1e-3)
    # Without compensation the yaw, whose gains are highest, swings far beyond.
    assert prompt[:, 2].max() < 1.03
    assert flown[LONG, False][:, 2].max() > 1.1


@given(
    st.lists(st.floats(-100, 100), min_size=6, max_size=6),
    st.lists(st.floats(0, 1), min_size=6, max_size=6),
    st.lists(st.floats(-100, 100), min_size=3, max_size=3),
    st.lists(st.floats(-1e3, 1e3), min_size=3, max_size=3),
)
def test_commands_are_within_limits_wherever_the_craft_is(state, speed, disturbance, target):
    craft = Estimate(0.0, np.array(state), np.array(speed), np.array(disturbance))
    step = LIMITED.steer(craft, SetPoint(*target).at(0, 0))
    assert np.isfinite(step.command).all()
    assert (step.command >= 0.1).all()
    assert (step.command <= 0.8).all()


LIMITED = TrackingController(
    replace(
        MODEL, vehicle=MODEL.vehicle.model_copy(update={"command_min": 0.1, "command_max": 0.8})
    ),
    HOME,
    compiled=False,
)


def test_a_falling_thrust_curve_is_refused():
    curves = MODEL.parameters.thrust.copy()
    curves[2] = [0.5, 0.0, -0.4]  # steepest downwards at full speed
    falling = replace(MODEL, parameters=replace(MODEL.parameters, thrust=curves))
    with pytest.raises(InputError, match="thrust curve of propeller 3 falls"):
        TrackingController(falling, HOME, compiled=False)


def test_propellers_that_cannot_turn_the_craft_are_refused():
    matrix = MODEL.dynamics.configuration.copy()
    matrix[2] = 0
    straight = replace(MODEL.parameters, configuration_matrix=matrix)
    with pytest.raises(InputError, match="cannot push and turn in every direction"):
        TrackingController(replace(MODEL, parameters=straight), HOME, compiled=False)


def test_propellers_that_all_push_along_one_line_are_refused():
    old = MODEL.vehicle
    propellers = tuple(
        p.model_copy(update={"direction_deg": 180.0 * i}) for i, p in enumerate(old.propellers)
    )
    # Made anew, since a copy would carry what the old one has computed already.
    vehicle = Vehicle(**{**dict(old), "propellers": propellers})
    parameters = nominal_parameters(vehicle)
    free = parameters.mask(frozenset())
    model = replace(MODEL, vehicle=vehicle, parameters=parameters, free=free)
    with pytest.raises(InputError, match="cannot push and turn in every direction"):
        TrackingController(model, HOME, compiled=False)


def test_the_first_example_of_the_documentation_runs(tmp_path, monkeypatch):
    text = (Path(__file__).parents[2] / "docs" / "control.md").read_text()
    example = text.split("```python\n")[1].split("```")[0]
    monkeypatch.chdir(tmp_path)
    MODEL.save("model.toml")
    sent = []
    names = {"stamp": 0.0, "x": 0.4, "y": -0.3, "yaw": 0.9, "now": 0.001, "send": sent.append}
    exec(example, names)
    assert names["step"].flies
    np.testing.assert_array_equal(sent, [names["step"].command])
