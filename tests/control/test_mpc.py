"""The predictive law: closed loops on simulated craft, and every way in which it can fail."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from airpuck.boundary.errors import InputError
from airpuck.control.horizon import Condensed
from airpuck.control.law import FLYING, Step
from airpuck.control.limits import Fence, HalfPlane, KeepOut

# A weight inside the plan has no visible effect on a flight, so compare it with least squares.
from airpuck.control.mpc import MPC, _way_left
from airpuck.control.predictive import PredictiveSettings, SoftLimits
from airpuck.control.reference import Reference, Rendezvous, SetPoint, TimedPath
from airpuck.control.tracking import TrackingController
from airpuck.control.tuning import Tuning, default_tuning
from airpuck.craft.table import Table
from airpuck.estimate.estimator import Estimate
from airpuck.model.model_file import published_model
from airpuck.physics.rigid_body import derivative, rollout
from airpuck.physics.rigid_body import step as physics

from ..apparatus.closed_loops import HOME, fly
from ..apparatus.examples import examples

MODEL = published_model("M3")
H = 0.01


def tuned(**limits) -> Tuning:
    return default_tuning().with_law("mpc", limits=SoftLimits(**limits))


def law(table: Table | None = None, **limits) -> TrackingController:
    return TrackingController(MODEL, HOME, tuned(**limits), table=table)


def runge_kutta(state: np.ndarray, command: np.ndarray) -> np.ndarray:
    """Move the craft on by a period."""
    for _ in range(2):
        state = physics(np, MODEL.dynamics, state, command, H / 2)
    return state


@jax.jit
def eighth_order(state, command):
    """Move the craft on by a period; by diffrax, from the rates of change alone."""
    return diffrax.diffeqsolve(
        diffrax.ODETerm(lambda t, z, u: derivative(jnp, MODEL.dynamics, z, u)),
        diffrax.Dopri8(),
        t0=0.0,
        t1=H,
        dt0=H,
        y0=state,
        args=command,
        stepsize_controller=diffrax.PIDController(rtol=1e-10, atol=1e-12),
    ).ys[-1]


def closed_loop(
    ours: TrackingController,
    reference: Reference,
    duration: float,
    start: np.ndarray,
    *,
    advance: Callable[[np.ndarray, np.ndarray], np.ndarray] = runge_kutta,
) -> tuple[np.ndarray, list[Step]]:
    """Steer a craft without delay and with known state; return states at 100 Hz, and steps."""
    ours.reference = reference
    state = np.concatenate([start, np.full(6, MODEL.vehicle.command_min)])
    states, steps = [state], []
    delay = ours.model.transport_delay
    for k in range(round(duration / H)):
        estimate = Estimate(k * H, state[:6], state[6:], np.zeros(3))
        # Sent one delay earlier, so that it acts now.
        steps.append(ours.steer(estimate, k * H - delay))
        state = advance(state, steps[-1].command)
        states.append(state)
    return np.array(states), steps


@cache
def free() -> TrackingController:
    """One without limits, made at first use."""
    return law()


def at_rest(x: float, y: float, yaw: float) -> np.ndarray:
    return np.array([x, y, yaw, 0.0, 0.0, 0.0])


@pytest.mark.slow
def test_mpc_reaches_set_points_sooner_than_lqr():
    target, settled = np.array([0.6, -0.2, 2.8]), []
    for ours in (free(), TrackingController(MODEL, HOME)):
        states, steps = closed_loop(ours, SetPoint(*target), 2.0, at_rest(-0.6, 0.2, 0.0))
        apart = np.abs(states[:, :3] - target)
        far = (np.hypot(*apart[:, :2].T) > 0.01) | (apart[:, 2] > 0.05)
        settled.append(np.flatnonzero(far)[-1] * H)
        assert all(one.status in FLYING for one in steps)
    assert settled[0] < 0.75 * settled[1]
    np.testing.assert_allclose(states[-1, :3], target, atol=0.02)


def test_mpc_flies_a_craft_whose_delay_differs_from_the_model():
    ours = TrackingController(MODEL, SetPoint(0.3, 0.1, 1.0), tuned())
    _, poses, steps = fly(ours, 1.5)
    np.testing.assert_allclose(poses[-1], [0.3, 0.1, 1.0], atol=5e-3)
    assert {one.status for one in steps[5:]} <= {"optimal", "softened"}


@pytest.mark.slow
def test_the_closed_loop_matches_an_independent_integration():
    target, start = SetPoint(0.5, 0.1, 1.5), at_rest(-0.2, 0.0, 0.0)
    with jax.enable_x64(True):

        def advance(state: np.ndarray, command: np.ndarray) -> np.ndarray:
            return np.asarray(eighth_order(jnp.asarray(state), jnp.asarray(command)))

        theirs, answers = closed_loop(law(), target, 0.8, start, advance=advance)
    ours, steps = closed_loop(law(), target, 0.8, start)
    assert np.abs(theirs[-1, 0]) > 0.4  # it has flown
    np.testing.assert_allclose(ours, theirs, atol=5e-5)
    commands = np.array([[step.command for step in each] for each in (steps, answers)])
    np.testing.assert_allclose(*commands, atol=2e-4)


def test_the_predicted_states_are_flown():
    states, steps = closed_loop(free(), SetPoint(0.5, 0.1, 1.0), 0.6, at_rest(0.0, 0.0, 0.0))
    ahead = steps[20].prediction
    assert ahead is not None
    k = round(ahead.times[4] / H)
    np.testing.assert_allclose(ahead.states[4, :3], states[20 + k, :3], atol=8e-3)
    assert "motor" in ahead.active


def test_the_first_step_after_a_new_set_point_predicts_its_own_commands():
    ours, craft = law(), Estimate(0.0, at_rest(0.0, 0.0, 0.0), np.full(6, 0.3), np.zeros(3))
    for _ in range(10):
        ours.steer(craft, 0.0)
    ours.reference = SetPoint(0.002, -0.001, 0.005)  # small enough for linearity
    expected, controller = ours.steer(craft, 0.0).prediction, ours.law
    assert isinstance(controller, MPC) and expected is not None
    # By the physics, under the commands that were found in this step.
    start, owner = np.concatenate([craft.state, craft.motor_speed]), controller._blocks.owner
    lengths = np.full(len(owner), controller._blocks.step)
    states = rollout(np, MODEL.dynamics, start, ours.state.plan[owner], lengths)
    apart, way = np.abs(expected.states - states[:, :6])[:, :3], np.abs(states[:, :3])
    assert (apart.max(axis=0) < 0.1 * way.max(axis=0)).all()
    assert states[-1, 0] > 0.001


def test_a_path_is_followed_without_lag():
    times = np.linspace(0, 2, 21)
    poses = np.stack([0.4 * np.sin(2 * times), 0.2 * np.sin(4 * times), times], axis=1)
    path = TimedPath(times, poses)
    start = np.concatenate([poses[0], np.zeros(3)])
    states, _ = closed_loop(free(), path, 2.0, start)
    wanted = np.array([path.at(k * H, 0.0).state for k in range(len(states))])
    # It begins at rest, and has caught up by then.
    assert np.abs(states[90:190, :2] - wanted[90:190, :2]).max() < 0.006


@pytest.mark.parametrize("yaw", [1.0, np.inf])
def test_a_rendezvous_is_kept(yaw):
    met = np.array([0.5, 0.15, 1.0, 0.4, -0.9, 0.0])
    precision = (0.002, 0.002, 0.05 if np.isfinite(yaw) else np.inf, 0.05, 0.05, np.inf)
    meeting = Rendezvous(0.9, met, precision=precision, then=SetPoint(0.0, 0.0, 0.0))
    states, _ = closed_loop(free(), meeting, 2.2, at_rest(-0.3, -0.2, 0.0))
    arrived = states[90]
    np.testing.assert_allclose(arrived[:2], met[:2], atol=0.004)
    np.testing.assert_allclose(arrived[3:5], met[3:5], atol=0.09)
    if np.isfinite(yaw):
        assert arrived[2] == pytest.approx(1.0, abs=0.06)
    np.testing.assert_allclose(states[-1, :2], 0.0, atol=0.01)  # then it follows the next target


@pytest.mark.parametrize("sharp", [(1e9, 1e9), (1e9, 0.0), (0.0, 1e9), (0.0, 0.0), (3.0, 0.2)])
def test_the_path_to_a_rendezvous_has_minimum_cost(sharp):
    # A double integrator with an error and a drift, under piecewise constant pushes: least squares.
    left, effort, apart, drift = 0.7, 0.3, 0.2, -0.5
    pieces = 500
    h = left / pieces
    to_go = left - h * (np.arange(pieces) + 0.5)
    arriving = np.array([apart + drift * left, drift])
    moved = np.stack([h * to_go, np.full(pieces, h)])
    weighted = np.sqrt(sharp)[:, None]
    rows = np.concatenate([weighted * moved, np.sqrt(effort * h) * np.eye(pieces)])
    asked = np.concatenate([-weighted[:, 0] * arriving, np.zeros(pieces)])
    best = np.linalg.lstsq(rows, asked)[0]
    cost = np.sum((rows @ best - asked) ** 2)
    weight = _way_left(left, np.full(3, effort), np.repeat(sharp, 3))
    for axis in range(3):
        error = np.zeros(6)
        error[[axis, axis + 3]] = apart, drift
        assert error @ weight @ error == pytest.approx(cost, rel=1e-4)
    if sharp[0] == sharp[1] > 1:
        closed = 12 * apart**2 / left**3 + 12 * apart * drift / left**2 + 4 * drift**2 / left
        assert cost == pytest.approx(effort * closed, rel=1e-4)


def test_it_stops_before_a_rail_if_the_target_is_beyond():
    states, steps = closed_loop(free(), SetPoint(3.0, 0.0, 0.0), 1.5, at_rest(0.0, 0.0, 0.0))
    border = Table().reach(MODEL.vehicle.radius_m)[0]
    assert states[:, 0].max() < border
    assert states[-1, 0] > border - 0.02
    assert "rail" in steps[-1].prediction.active


@pytest.mark.parametrize(("axis", "side"), [(0, 1), (0, -1), (1, 1), (1, -1)])
def test_it_keeps_the_margin_to_the_rails(axis, side):
    margin = 0.03
    goal, start = np.zeros(3), at_rest(0.0, 0.0, 0.0)
    border = Table().reach(MODEL.vehicle.radius_m)[axis] - margin
    goal[axis], start[axis] = 3.0 * side, (border - 0.1) * side
    states, steps = closed_loop(law(margin_m=margin), SetPoint(*goal), 0.8, start)
    outwards = side * states[:, axis]
    assert outwards.max() < border + 1e-3
    assert outwards[-1] > border - 0.01
    assert "rail" in steps[-1].prediction.active


@pytest.mark.parametrize("after", [0.1, 0.5, 0.7])
def test_an_arrival_between_two_steps_is_weighted_by_their_distance(after):
    """As if the error at the arrival were interpolated: the nearer end of a step counts more."""
    precision = np.array([0.01, 0.02, 0.1, 0.5, 0.4, 1.0])
    settings, delay, count = law().tuning.of(PredictiveSettings), 0.03, 4
    step, efforts = settings.step_s, np.tile(settings.weights.efforts, 2)
    meeting = Rendezvous(delay + (count + after) * step, np.zeros(6), precision=precision)
    controller = law().law
    assert isinstance(controller, MPC)
    (_, _, _, _, weights, terminal, *_), _ = controller.posed(
        controller.init(), meeting, 0.0, delay, controller.fence, np.zeros((0, 5))
    )
    expected = np.zeros_like(weights)
    # Row k belongs to the end of step k, counted from 0.
    expected[count - 1] = (1 - after) * efforts / precision**2
    expected[count] = after * efforts / precision**2
    np.testing.assert_allclose(weights, expected, rtol=1e-9, atol=1e-9)
    assert not terminal.any()


@pytest.mark.slow
def test_speed_spin_fence_and_disc_limits_are_kept():
    ours = law(
        speed_m_s=0.8,
        spin_rad_s=4.0,
        fence_m=(-0.9, -0.4, 0.55, 0.4),
        keep_out_m=((0.0, 0.0, 0.2),),
    )
    states, steps = closed_loop(ours, SetPoint(0.6, 0.02, 3.0), 2.5, at_rest(-0.6, 0.0, 0.0))
    assert np.hypot(*states[:, 3:5].T).max() < 0.84
    assert np.abs(states[:, 5]).max() < 4.2
    assert states[:, 0].max() < 0.553
    assert np.hypot(*states[:, :2].T).min() > 0.197
    assert states[-1, 0] > 0.5
    active = {kind for one in steps if one.prediction for kind in one.prediction.active}
    assert {"speed", "spin", "disc", "rail"} <= active


def test_a_table_smaller_than_the_craft_still_gives_a_command():
    ours = law(Table(length_m=0.1, width_m=0.1))
    _, steps = closed_loop(ours, SetPoint(0.5, 0.0, 0.0), 0.2, at_rest(0.2, 0.0, 0.0))
    assert {one.status for one in steps} <= {"softened", "iteration limit"}


def test_a_law_accepts_any_number_of_limits():
    ours, craft = law(), Estimate(0.0, at_rest(0, 0, 0), np.full(6, 0.3), np.zeros(3))
    ours.reference = SetPoint(0.3, 0.0, 0.0)
    there, away = KeepOut(0.0, 0.0, 0.1), KeepOut(9.0, 9.0, 0.1)
    for limits, status, active in (
        ([], "optimal", set()),
        ([there], "softened", {"disc"}),
        ([away], "optimal", set()),
        ([Fence(0.1, -0.4, 0.5, 0.4)], "softened", {"rail"}),
        # Two fences: both hold.
        ([Fence(-0.5, -0.4, 0.5, 0.4), Fence(0.1, -0.4, 0.9, 0.4)], "softened", {"rail"}),
        ([HalfPlane(0.1, 0.0, 0.0)], "softened", {"half plane"}),
        ([HalfPlane(0.5, 0.0, np.pi)], "optimal", set()),
        ([away, away, there], "softened", {"disc"}),
    ):
        ours.limits = limits
        ours.state = ours.law.init()
        step = ours.steer(craft, 0.0)
        assert (step.status, {*step.prediction.active} - {"motor"}) == (status, active), limits


def test_a_hard_limit_is_kept_where_a_soft_one_is_exceeded():
    """A craft too fast to stop before a line: softly exceeded, or no plan at all."""
    moving = Estimate(0.0, np.array([0.0, 0, 0, 1.0, 0, 0]), np.full(6, 0.3), np.zeros(3))
    for hard, status in ((False, "softened"), (True, "fallback")):
        ours = law()
        ours.limits = [HalfPlane(0.02, 0.0, np.pi, hard=hard)]
        assert ours.steer(moving, 0.0).status == status
    # What can be kept is kept, by either.
    for hard in (False, True):
        ours = law()
        ours.reference = SetPoint(0.3, 0.0, 0.0)
        ours.limits = [HalfPlane(0.1, 0.0, np.pi, hard=hard), KeepOut(0.0, 0.3, 0.1, hard=hard)]
        rest = Estimate(0.0, at_rest(0, 0, 0), np.full(6, 0.3), np.zeros(3))
        for k in range(5):
            step = ours.steer(rest, 0.01 * k)
            assert step.status == "optimal"
        assert step.prediction.states[:, 0].max() < 0.1 + 1e-3


def test_an_invalid_limit_is_rejected():
    for wrong in ((0.1, 0, -0.1, 9), (0, 0.1, 9, -0.1), (0.0, np.nan, 1.0, 1.0)):
        with pytest.raises(InputError, match=r"lowest x and y|low_y: must be from -100 to 100"):
            Fence(*wrong)
    for radius in (np.inf, -1.0, 0.0):
        with pytest.raises(InputError, match=r"radius: must be (above 0|from -100)"):
            KeepOut(0.0, 0.0, radius)


@pytest.mark.parametrize("name", ["fence", "keep_out"])
def test_limits_set_on_the_law_as_in_earlier_versions_are_rejected(name):
    with pytest.raises(InputError, match=rf"{name}: is set by controller\.limits now"):
        setattr(law().law, name, (-0.9, -0.4, 0.9, 0.4))


def test_without_a_solution_the_old_plan_then_lqr_then_idling_follow(monkeypatch):
    ours = law()
    controller = ours.law
    assert isinstance(controller, MPC)
    craft = Estimate(0.0, at_rest(0.1, 0.0, 0.5), np.full(6, 0.3), np.zeros(3))
    first = ours.steer(craft, 0.0)
    assert first.status == "optimal"
    monkeypatch.setattr(Condensed, "solve", lambda self, formed: None)
    later = [ours.steer(craft, 0.01 * k) for k in range(1, 16)]
    assert [one.status for one in later] == ["iteration limit"] * 10 + ["fallback"] * 5
    for one in later:
        assert one.flies
    lost = replace(craft, state=np.full(6, np.nan))
    idle = ours.steer(lost, 0.2)
    assert idle.status == "failed"
    np.testing.assert_array_equal(idle.command, np.full(6, MODEL.vehicle.command_min))


def test_a_shifted_plan_meets_the_motor_limits_exactly(monkeypatch):
    ours = law()
    monkeypatch.setattr(Condensed, "solve", lambda self, formed: None)
    most = MODEL.vehicle.command_max
    for k in range(200):
        begun = ours.law.init()
        full = np.full_like(begun.plan, most)
        ours.state = begun._replace(plan=full, since=0.0, answered=0.0)
        step = ours.steer(
            Estimate(0.0, at_rest(0.0, 0.0, 0.0), np.full(6, 0.3), np.zeros(3)), k * 5e-4
        )
        assert step.status == "iteration limit"
        assert (step.command <= most).all()


def test_the_fallback_lqr_has_the_weights_of_the_tuning(monkeypatch):
    ours, lqr = law(), TrackingController(MODEL, HOME)
    craft = Estimate(0.0, at_rest(0.1, 0.0, 0.5), np.full(6, 0.3), np.zeros(3))
    monkeypatch.setattr(Condensed, "solve", lambda self, formed: None)
    one, other = ours.steer(craft, 0.0), lqr.steer(craft, 0.0)
    assert one.status == "fallback"
    np.testing.assert_allclose(one.command, other.command, atol=1e-9)


anything = st.floats(allow_nan=True, allow_infinity=True) | st.floats(-5, 5)


@examples(60)
@given(st.lists(anything, min_size=6, max_size=6), st.lists(anything, min_size=3, max_size=3))
def test_for_any_estimate_commands_are_finite_and_within_limits(state, push):
    with np.errstate(all="ignore"):
        craft = Estimate(0.0, np.array(state), np.full(6, 0.3), np.array(push))
        free().reference = SetPoint(0.4, 0.0, 1.0)
        found = free().steer(craft, 0.0)
    assert np.isfinite(found.command).all()
    assert (found.command >= MODEL.vehicle.command_min).all()
    assert (found.command <= MODEL.vehicle.command_max).all()
