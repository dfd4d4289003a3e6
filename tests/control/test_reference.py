"""References: values by hand, splines by their definition, and rejected input."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import trapezoid

from airpuck import InputError, Rendezvous, SetPoint, SetPoints, TimedPath, TrackingController
from airpuck.control.reference import Reference, asked, check_inside, read_setpoints
from airpuck.control.tuning import default_tuning
from airpuck.estimate.estimator import Estimate
from airpuck.model.model_file import read_model

from ..apparatus.closed_loops import steer_to
from ..apparatus.refusals import rejected

time = st.floats(-100, 100)


@given(time, st.floats(0, 1))
def test_a_set_point_is_a_constant_pose_with_zero_velocity(now, ahead):
    target = SetPoint(0.1, -0.2, 7.0).at(now, ahead)
    np.testing.assert_array_equal(target.state, [0.1, -0.2, 7.0, 0, 0, 0])
    np.testing.assert_array_equal(target.acceleration, np.zeros(3))


@pytest.mark.parametrize(
    ("now", "x"),
    [(-9.0, 1), (0.0, 1), (0.999, 1), (1.0, 2), (1.5, 2), (2.999, 2), (3.0, 3), (1e6, 3)],
)
def test_a_set_point_holds_from_its_time_until_the_next(now, x):
    points = SetPoints([0.0, 1.0, 3.0], [(1, 10, 0.1), (2, 20, 0.2), (3, 30, 0.3)])
    target = points.at(now, 0.0)
    np.testing.assert_allclose(target.state, [x, 10 * x, 0.1 * x, 0, 0, 0])
    np.testing.assert_array_equal(target.acceleration, np.zeros(3))


def test_a_set_point_is_not_anticipated():
    points = SetPoints([0.0, 1.0], [(1, 0, 0), (2, 0, 0)])
    assert points.at(0.999, ahead=0.5).state[0] == 1


ORIGIN, MOVED = (0.0, 0.0, 0.0), (1.0, 0.0, 0.0)
FINITE, SEVERAL, THREE = "finite", "as many times as poses", "three numbers"


@pytest.mark.parametrize(("kind", "field"), [(SetPoints, "setpoint"), (TimedPath, "path")])
@pytest.mark.parametrize(
    ("times", "poses", "problem"),
    [
        ([], [], "at least"),
        ([0.0, 1.0], [ORIGIN], SEVERAL),
        ([0.0], [ORIGIN, MOVED], SEVERAL),
        (np.zeros((1, 1)), [ORIGIN], SEVERAL),
        ([0.0, 1.0, 2.0], np.zeros((4, 3)), SEVERAL),
        ([0.0, 0.0], [ORIGIN, MOVED], "must increase"),
        ([1.0, 0.0], [ORIGIN, MOVED], "must increase"),
        ([0.0, np.nan], [ORIGIN, MOVED], FINITE),
        ([0.0, np.inf], [ORIGIN, MOVED], FINITE),
        ([0.0, 1.0], [(0.0, np.nan, 0.0), MOVED], FINITE),
        ([0.0, 1.0], [(0, 0), (1, 1), (2, 2)], THREE),
        ([0.0], [(0, 0)], THREE),
        ([0.0, 1.0], [ORIGIN, (1, 1)], THREE),
        ([0.0, 1.0, 2.0], np.zeros(3), THREE),
        ([0.0], np.zeros((1, 3, 3)), THREE),
    ],
)
def test_invalid_times_and_poses_are_rejected(kind, field, times, poses, problem):
    with rejected(match=problem, field=field):
        kind(times, poses)


def path(n: int = 6, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    random = np.random.default_rng(seed)
    return np.cumsum(random.uniform(0.3, 1.0, n)), random.normal(size=(n, 3))


def test_a_path_goes_through_its_poses():
    times, poses = path()
    for t, pose in zip(times, poses, strict=True):
        np.testing.assert_allclose(TimedPath(times, poses).at(float(t), 0).state[:3], pose)


def test_between_two_poses_a_path_is_the_smoothstep():
    # The cubic with its ends at rest: p = 3u² - 2u³.
    move = np.array([1.0, -2.0, 8.0])
    line = TimedPath(np.array([1.0, 3.0]), np.array([np.zeros(3), move]))
    for u in (0.0, 0.1, 0.5, 0.8):
        target = line.at(1 + 2 * u, 0.0)
        np.testing.assert_allclose(target.state[:3], (3 * u**2 - 2 * u**3) * move, atol=1e-14)
        np.testing.assert_allclose(target.state[3:], (6 * u - 6 * u**2) / 2 * move, atol=1e-14)
        np.testing.assert_allclose(target.acceleration, (6 - 12 * u) / 4 * move, atol=1e-13)


@given(st.floats(0, 1), st.integers(0, 9))
def test_velocity_and_acceleration_are_the_derivatives_of_the_pose(share, seed):
    times, poses = path(seed=seed)
    step = 1e-4
    now = float(times[0] + 2 * step + share * (times[-1] - times[0] - 4 * step))
    curve = TimedPath(times, poses)
    before, here, after = (curve.at(now + s, 0.0) for s in (-step, 0.0, step))
    slope = (after.state[:3] - before.state[:3]) / (2 * step)
    np.testing.assert_allclose(here.state[3:], slope, atol=1e-5)
    bend = (after.state[3:] - before.state[3:]) / (2 * step)
    np.testing.assert_allclose(here.acceleration, bend, atol=2e-2)


def test_a_path_has_the_least_curvature_of_all_curves_through_its_poses():
    # Definition of the cubic spline with its ends at rest: the least ∫ a² among all such curves.
    times, poses = path()
    fine = np.linspace(times[0], times[-1], 20001)
    curve = TimedPath(times, poses)
    x = np.array([curve.at(float(t), 0.0).acceleration[0] for t in fine[::10]])
    knots = np.prod([np.subtract.outer(fine, t) for t in times], axis=0)
    bump = knots * (fine - times[0]) * (fine - times[-1])  # zero at the poses, flat at both ends
    bend = np.gradient(np.gradient(bump, fine), fine)[::10]
    product = trapezoid(x * bend, fine[::10])
    scale = np.sqrt(trapezoid(x**2, fine[::10]) * trapezoid(bend**2, fine[::10]))
    assert abs(product) < 1e-3 * scale


@given(time, st.floats(0, 1))
def test_a_path_is_evaluated_ahead_of_time(now, ahead):
    times, poses = path()
    curve = TimedPath(times, poses)
    early, late = curve.at(now, ahead), curve.at(now + ahead, 0.0)
    np.testing.assert_array_equal(early.state, late.state)
    np.testing.assert_array_equal(early.acceleration, late.acceleration)


@given(st.floats(1e-9, 1e3))
def test_outside_its_times_a_path_is_at_rest(away):
    times, poses = path()
    curve = TimedPath(times, poses)
    for now, pose in ((times[0] - away, poses[0]), (times[-1] + away, poses[-1])):
        target = curve.at(float(now), 0.0)
        np.testing.assert_allclose(target.state, np.append(pose, np.zeros(3)), atol=1e-12)
        np.testing.assert_array_equal(target.acceleration, np.zeros(3))


def test_the_yaw_of_a_path_may_exceed_a_full_turn():
    times = np.linspace(0, 4, 41)
    turning = np.stack([0 * times, 0 * times, 2 * np.pi * times], axis=1)
    target = TimedPath(times, turning).at(2.0, 0.0)
    assert target.state[2] == pytest.approx(4 * np.pi)
    assert target.state[5] == pytest.approx(2 * np.pi, rel=1e-6)


def test_set_points_need_one_pose_and_paths_at_least_two():
    with rejected(match="as many times as poses", field="setpoint"):
        SetPoints([0.0], [])
    with rejected(match="at least 2", field="path"):
        TimedPath(np.array([0.0]), np.zeros((1, 3)))


def test_a_path_copies_the_arrays_of_the_caller():
    times, poses = path()
    curve, kept = TimedPath(times, poses), TimedPath(times.copy(), poses.copy())
    times *= 2
    poses *= 2
    np.testing.assert_array_equal(curve.at(1.0, 0.0).state, kept.at(1.0, 0.0).state)


def test_every_target_is_a_reference():
    times, poses = path()
    for reference in (SetPoint(0, 0, 0), SetPoints([0.0], [(0, 0, 0)]), TimedPath(times, poses)):
        assert isinstance(reference, Reference)


@given(st.integers(-5, 5), st.floats(-3, 3))
def test_whole_turns_of_the_target_cause_no_motion(turns, yaw):
    controller = turner()
    craft = Estimate(0.0, np.array([0, 0, yaw, 0, 0, 0.0]), IDLE, np.zeros(3))
    here, there = SetPoint(0.1, 0, 0.5), SetPoint(0.1, 0, 0.5 + 2 * np.pi * turns)
    one, other = (steer_to(controller, craft, point).request for point in (here, there))
    np.testing.assert_allclose(one, other, atol=1e-9)


def test_the_shorter_rotation_is_chosen():
    controller = turner()
    craft = Estimate(0.0, np.array([0, 0, 3.0, 0, 0, 0]), IDLE, np.zeros(3))
    forward = steer_to(controller, craft, SetPoint(0, 0, -3.0)).request
    back = steer_to(controller, craft, SetPoint(0, 0, 2.5)).request
    k = controller.law.gain[2, 2]
    # 2π - 6 ahead, 0.5 back; idling motors turn the craft a little in the first period.
    assert forward[2] - back[2] == pytest.approx(k * (2 * np.pi - 6 + 0.5), rel=1e-9)
    assert forward[2] > 0 > back[2]


MODEL = read_model("paper:M4")
IDLE = np.full(6, MODEL.vehicle.command_min)


def turner() -> TrackingController:
    return TrackingController(MODEL, SetPoint(0, 0, 0), default_tuning(), compiled=False)


@pytest.mark.parametrize(
    ("state", "precision", "field"),
    [
        ((0.0,) * 5, (1.0,) * 6, "state"),
        ((np.nan,) + (0.0,) * 5, (1.0,) * 6, "state"),
        ((0.0,) * 6, (1.0,) * 3, "precision"),
        ((0.0,) * 6, (0.0,) + (1.0,) * 5, "precision"),
        ((0.0,) * 6, (np.nan,) + (1.0,) * 5, "precision"),
    ],
)
def test_an_invalid_rendezvous_is_rejected(state, precision, field):
    with rejected(field=field):
        Rendezvous(1.0, state, precision=precision)


def test_a_rendezvous_targets_its_velocity_until_its_time():
    meet = Rendezvous(1.0, (0.5, 0.1, 0.0, 2.0, 0.0, -1.0), then=SetPoint(0.0, 0.0, 0.3))
    np.testing.assert_allclose(meet.at(0.7, 0.1).state, [0.1, 0.1, 0.2, 2.0, 0.0, -1.0])
    np.testing.assert_allclose(meet.at(1.0, 0.0).state, meet.state)
    # Ahead counts from now: 0.6 s later it is not there yet, 0.8 s later it has left.
    np.testing.assert_allclose(meet.at(0.3, 0.6).state[0], 0.5 - 0.1 * 2.0)
    np.testing.assert_allclose(meet.at(0.3, 0.8).state, [0.0, 0.0, 0.3, 0.0, 0.0, 0.0])
    np.testing.assert_allclose(meet.at(0.95, 0.1).state, [0.0, 0.0, 0.3, 0.0, 0.0, 0.0])
    ahead = meet.over(0.7, np.array([0.1, 0.5]))
    assert ahead.arrival is not None and ahead.arrival.remaining == pytest.approx(0.3)
    after = meet.over(1.1, np.array([0.1, 0.5]))
    assert after.arrival is None
    np.testing.assert_allclose(after.states[:, 2], 0.3)


def test_a_rendezvous_requests_its_state_and_then_its_successor():
    first = Rendezvous(2.0, (-0.2, 0.0, 0.1, -1.0, 0.0, 0.0), then=SetPoint(0.0, 0.0, 0.3))
    meet = Rendezvous(1.0, (0.5, 0.1, 0.0, 2.0, 0.0, -1.0), then=first)
    np.testing.assert_array_equal(asked(meet, -5.0), meet.state)
    np.testing.assert_array_equal(asked(meet, 1.5), first.state)
    np.testing.assert_array_equal(asked(meet, 2.5), [0.0, 0.0, 0.3, 0.0, 0.0, 0.0])
    np.testing.assert_array_equal(asked(SetPoint(1.0, 2.0, 3.0), 0.0), [1, 2, 3, 0, 0, 0])


@pytest.mark.parametrize("x, y", [(1.01, 0.0), (-1.01, 0.0), (0.0, 0.51), (0.0, -0.51)])
def test_set_points_keep_the_border_on_all_sides(x, y):
    check_inside(SetPoint(0.99 * x, 0.97 * y, 0.0), (1.0, 0.5))
    for reference in (SetPoint(x, y, 0.0), SetPoints([0.0], [(x, y, 0.0)])):
        with pytest.raises(InputError, match="outside"):
            check_inside(reference, (1.0, 0.5))


@pytest.mark.parametrize(
    ("x", "yaw", "words"), [(1.01, 0.0, "outside the geofence"), (0.0, 90.0, "is it in degrees")]
)
def test_a_set_point_from_a_file_is_rejected_with_the_name_of_the_file(tmp_path, x, yaw, words):
    path = tmp_path / "points.toml"
    path.write_text(f"[[setpoints]]\nat_s = 0.0\nx_m = {x}\ny_m = 0.0\nyaw_rad = {yaw}\n")
    with pytest.raises(InputError, match=rf"points\.toml: setpoint: .*{words}"):
        check_inside(read_setpoints(path), (1.0, 0.5))
