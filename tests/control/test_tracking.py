"""The tracking controller: closed loops on simulated craft."""

from dataclasses import replace
from pathlib import Path

import control
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from airpuck import InputError, Model, SetPoint, SetPoints, TimedPath, TrackingController
from airpuck.control import tracking
from airpuck.control.lqr import motor_lag
from airpuck.control.tuning import default_tuning
from airpuck.estimate.estimator import Estimate
from airpuck.model.parameters import nominal_parameters
from airpuck.physics.rigid_body import acceleration
from airpuck.twin.plant import varied

from ..apparatus.changes import with_propellers
from ..apparatus.closed_loops import (
    HOME,
    LEAST,
    LONG,
    MODEL,
    NOTHING,
    controller,
    fly,
    hold_still,
    steer_to,
)


def test_the_nominal_loop_agrees_with_python_control():
    # Without saturation the motors give what the regulator requested one period ago:
    # x⁺ = A x + B v, v⁺ = -K (x⁺ - target). Thrusts, motors and turning drop out.
    target = np.array([0.02, -0.03, 0.4, 0, 0, 0])
    ours = controller(SetPoint(*target[:3].tolist()))
    h, dynamics = ours.tuning.period_s, MODEL.dynamics
    lag, drive = motor_lag(float(dynamics.motor_time_constant), h)
    double = control.ss(np.eye(6, k=3), np.eye(6, 3, k=-3), np.eye(6), np.zeros((6, 3)))
    plant, k = control.c2d(double, h, "zoh"), ours.law.gain
    # Motors that already hold a middle thrust, for the request to be met from the beginning.
    speed = np.full(6, 0.35)
    x = np.zeros(6)
    first = np.array(acceleration(np, dynamics, x[2:], speed))
    states = [x]
    for _ in range(400):
        step = ours.steer(Estimate(0.0, x, speed, NOTHING), 0.0)
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


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1])  # the second craft uses the first one's programs
def test_compiled_and_numpy_give_the_same_commands(seed):
    random, craft = np.random.default_rng(0), varied(MODEL, 0.1 * seed, seed)
    pair = [TrackingController(craft, SetPoint(0.05, 0, 0.3), compiled=c) for c in (True, False)]
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


@pytest.mark.parametrize("compensate", [True, False])
def test_one_step_equals_prediction_followed_by_steering(monkeypatch, compensate):
    # If JAX runs programs of any size in the calling thread, the controller has one for both.
    monkeypatch.setattr(tracking, "large_programs_are_fast", lambda: True)
    point, random = SetPoint(0.4, -0.2, 2.0), np.random.default_rng(1)
    pair = [controller(point, compiled=c, compensate_delay=compensate) for c in (True, False)]
    for k in range(60):
        now = k / 100
        pose = 0.003 * k * np.array([1.0, -0.5, 2.0]) + 1e-4 * random.normal(size=3)
        for one in pair:
            one.pose(now, pose)
            whole, parts = one.step(now), one.steer(one.predict(now), now)
            assert whole.status == parts.status
            np.testing.assert_allclose(whole.request, parts.request, rtol=1e-11, atol=1e-11)
            np.testing.assert_allclose(whole.command, parts.command, atol=1e-11)
            assert whole.estimate is not None
            assert parts.estimate is not None
            np.testing.assert_allclose(whole.estimate.state, parts.estimate.state, atol=1e-13)
            one.sent(now, whole.command)


@pytest.mark.parametrize("far", [SetPoint(100, -100, 0), SetPoint(0, 0, 3.1), SetPoint(1e6, 0, 0)])
def test_a_request_beyond_the_limits_is_not_an_error(far):
    ours = controller(far)
    last = hold_still(ours)
    step = ours.step(last)
    assert step.flies
    assert step.status in ("scaled", "nearest")
    # Scaled down, but towards the target: the direction is kept.
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
    gains = np.diag(ours.law.gain[:, :3])
    np.testing.assert_allclose(poses[-50:].mean(axis=0), push / gains, rtol=0.03)


@pytest.mark.slow
def test_set_points_are_reached_by_the_shorter_rotation():
    points = [(0.0, 0.0, 0.0), (0.3, -0.2, 1.5), (0.1, 0.2, -2.5), (0.1, 0.2, 2.8)]
    ours = controller(SetPoints([0.0, 0.5, 3.5, 6.5], points), compiled=True)
    times, poses, steps = fly(ours, 9.5)
    for end, point in ((3.5, points[1]), (6.5, points[2]), (9.5, points[3])):
        arrived = poses[(times > end - 0.3) & (times < end)]
        turn = (arrived[:, 2] - point[2] + np.pi) % (2 * np.pi) - np.pi
        np.testing.assert_allclose(arrived[:, :2], [point[:2]] * len(arrived), atol=2e-3)
        np.testing.assert_allclose(turn, 0, atol=2e-2)
    # From 1.5 to -2.5 + 2π, then by -0.98 to 2.8: never below zero, and without an extra turn.
    assert poses[:, 2].min() > -0.1
    assert poses[:, 2].max() < 2 * np.pi - 2.5 + 0.5
    commands = np.array([step.command for step in steps])
    assert (commands >= LEAST).all()
    assert (commands <= MODEL.vehicle.command_max).all()
    assert all(step.flies for step in steps)


def circle() -> TimedPath:
    """Once around at 0.3 m/s, between half a second of rest."""
    times = np.linspace(0, 4, 41)
    angle = 2 * np.pi * np.clip(times - 0.5, 0, 3) / 3
    poses = np.stack([0.15 * (1 - np.cos(angle)), 0.15 * np.sin(angle), 0 * angle], axis=1)
    return TimedPath(times, poses)


@pytest.mark.slow
def test_a_path_is_followed_closely_thanks_to_its_feed_forward():
    path = circle()

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


def test_a_path_is_followed_on_time_over_a_slow_radio():
    # A path read one transport delay too early or too late is 5 cm away.
    path = circle()
    late = MODEL.with_delay(LONG)
    when, poses, _ = fly(TrackingController(late, path), 3.4, delay=LONG)
    wanted = np.array([path.at(float(t), 0.0).state[:2] for t in when])
    assert np.abs(poses[:, :2] - wanted)[when > 1.5].max() < 0.012


def test_a_reference_is_evaluated_when_the_command_takes_effect():
    asked = []

    class Asked:
        def at(self, now, ahead):
            asked.append((now, ahead))
            return HOME.at(now, ahead)

    ours = controller(Asked())
    last = hold_still(ours)
    ours.step(last + 0.001)
    assert asked == [(last + 0.001, MODEL.transport_delay + ours.tuning.period_s)]


@pytest.mark.slow
def test_with_delay_compensation_the_flight_is_only_delayed():
    # Smith's predictor, with a perfect model.
    target, flown = SetPoint(0.02, -0.01, 1.0), {}
    for delay, compensated in ((0.0, True), (LONG, True), (LONG, False)):
        late = MODEL.with_delay(delay)
        ours = TrackingController(late, target, compensate_delay=compensated)
        _, flown[delay, compensated], _ = fly(ours, 2.0, delay=delay)
    prompt, shift = flown[0.0, True], round(LONG / 0.01)
    # The remainder is the drift with idling motors until the first command arrives.
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
    step = steer_to(LIMITED, craft, SetPoint(*target))
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


def with_curves() -> Model:
    curves = MODEL.parameters.thrust.copy()
    curves[2] = [0.5, 0.0, -0.4]  # steepest downwards at full speed
    return replace(MODEL, parameters=replace(MODEL.parameters, thrust=curves))


def that_cannot_turn() -> Model:
    matrix = MODEL.dynamics.configuration.copy()
    matrix[2] = 0
    return replace(MODEL, parameters=replace(MODEL.parameters, configuration_matrix=matrix))


def on_other_propellers(change) -> Model:
    """The model of the vehicle whose propellers have other keys, by their number."""
    vehicle = with_propellers(MODEL.vehicle, change)
    parameters = nominal_parameters(vehicle)
    free = parameters.mask(frozenset())
    return replace(MODEL, vehicle=vehicle, parameters=parameters, free=free)


def one_way(k: int, _) -> dict:
    """Three tangential propellers span all accelerations, but only with negative thrusts."""
    position = (0.05 * np.cos(2.0944 * k), 0.05 * np.sin(2.0944 * k))
    return {"direction_deg": 90.0 + 120.0 * k, "position_m": position}


@pytest.mark.parametrize(
    ("model", "says"),
    [
        (with_curves(), "thrust curve of propeller 3 falls"),
        (that_cannot_turn(), "cannot push and turn in every direction"),
        (
            on_other_propellers(lambda k, _: {"direction_deg": 180.0 * k}),
            r"no propeller .*no controller can steer it",
        ),
        (on_other_propellers(one_way), "cannot push and turn in every direction"),
    ],
    ids=["a falling curve", "no turn", "one line", "one sense of rotation"],
)
def test_a_craft_that_cannot_be_steered_is_rejected(model, says):
    with pytest.raises(InputError, match=says):
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


@pytest.mark.slow
@pytest.mark.parametrize("law", ["lqr", "mpc"])
def test_motors_run_at_least_at_the_lowest_command_of_the_tuning(law):
    turning = default_tuning().model_copy(update={"least_command": 0.08})
    commands = {}
    for tuning in (default_tuning(), turning):
        ours = controller(SetPoint(0.3, 0.1, 0.5), tuning=tuning, law=law)
        _, poses, steps = fly(ours, 2.0)
        np.testing.assert_allclose(poses[-1], [0.3, 0.1, 0.5], atol=0.02)
        commands[tuning.least_command] = np.array([step.command for step in steps])
    assert commands[0.0].min() == LEAST
    assert commands[0.08][1:].min() == pytest.approx(0.08)


def test_a_lowest_command_outside_the_crafts_range_is_rejected():
    tuning = default_tuning().model_copy(update={"least_command": 1.0})
    with pytest.raises(InputError, match="least_command"):
        controller(tuning=tuning)
