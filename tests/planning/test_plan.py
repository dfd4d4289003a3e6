"""Plans, against hand calculations and an independent integrator."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import airpuck
from airpuck import Goal, InputError, Limits, Plan, Table, Vehicle
from airpuck.control.reference import Reference
from airpuck.craft.vehicle import GRAVITY, Nominal, Propeller
from airpuck.model.model_file import nominal_model
from airpuck.planning import transcription
from airpuck.planning.plan import read_plan
from airpuck.planning.request import checked_request
from airpuck.planning.search import search

from ..apparatus.one_axis_craft import ACCELERATION, at_rest, one_axis, ring

M3 = airpuck.read_model("paper:M3")
EFFECTS = replace(
    M3,
    frame="body",
    parameters=replace(
        M3.parameters,
        center_of_mass=np.array([2e-3, -1e-3]),
        drag=np.array([0.1, 0.05, 0.2, 0.0]),
        tilt=np.array([2e-3, -1e-3]),
        idle_lag=0.5,
        pair_interaction=0.2,
        voltage_sag=0.05,
    ),
)


@pytest.fixture(scope="module")
def metre():
    return airpuck.plan(M3, (-0.5, 0, 0), (0.5, 0, 0), table=Table())


def fastest(start, goal, near=None, *, table=None, limits=None, intervals=40):
    """Search without the lower bound, which takes most of a plan's time."""
    asked = checked_request(M3, start, goal, (), table, (), limits or Limits())
    return search(asked, intervals, near)[0]


def integrated(model, path):
    """The final state by diffrax, from the start state and the commands alone."""
    # It takes seconds to import.
    import diffrax

    times, commands = jnp.array(path.times), jnp.array(path.commands)

    def rates(t, state, _):
        last = jnp.clip(jnp.searchsorted(times, t, side="right") - 1, 0, len(commands) - 1)
        return model.derivative(state, commands[last])

    # A step never crosses a switch.
    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(rates),
        diffrax.Tsit5(),
        0.0,
        float(times[-1]),
        1e-3,
        jnp.array(path.states[0]),
        stepsize_controller=diffrax.ClipStepSizeController(
            diffrax.PIDController(rtol=1e-9, atol=1e-10), jump_ts=times[1:-1]
        ),
        max_steps=100_000,
    )
    return np.asarray(solution.ys[-1])


@pytest.mark.slow
def test_a_double_integrator_needs_two_root_d_over_a():
    for distance, via in ((0.3, ()), (1.0, [(0.5, 0.0)])):  # the way point is where it brakes
        found = airpuck.plan(one_axis(), at_rest(0), at_rest(distance), via=via, intervals=20)
        known = 2 * np.sqrt(distance / ACCELERATION)
        assert found.duration == pytest.approx(known, rel=1e-4)
        assert 0.97 * known < found.lower_bound <= known
        # It switches once, from full ahead to full back.
        forward, back = found.commands.T[:2]
        half = len(forward) // 2
        np.testing.assert_allclose(forward, np.arange(len(forward)) < half, atol=1e-3)
        np.testing.assert_allclose(back, np.arange(len(back)) >= half, atol=1e-3)


@pytest.mark.slow
def test_the_papers_craft_has_its_known_times(metre):
    assert metre.duration == pytest.approx(0.798, rel=5e-3)  # by an independent prototype
    turned = airpuck.plan(M3, (-0.5, 0, 0), (-0.5, 0, 2 * np.pi / 3), intervals=20)
    for found in (metre, turned):
        assert 0.9 * found.duration < found.lower_bound <= found.duration


@pytest.mark.slow
def test_lag_increases_both_time_and_bound():
    lag = 0.05
    slow = airpuck.plan(one_axis(lag), at_rest(0), at_rest(0.5), intervals=20)
    quick = 2 * np.sqrt(0.5 / ACCELERATION)
    assert quick < slow.lower_bound <= slow.duration < quick + 2 * lag


@pytest.mark.slow
@pytest.mark.parametrize("push", [0.5 * ACCELERATION, -0.5 * ACCELERATION])
def test_a_slope_costs_as_much_uphill_as_downhill(push):
    # Speeding up at a + b and braking at a - b takes 2 sqrt(d a / (a^2 - b^2)).
    level = one_axis()
    slope = np.array([push / GRAVITY, 0.0])
    tilted = replace(level, parameters=replace(level.parameters, tilt=slope))
    found = airpuck.plan(tilted, at_rest(0), at_rest(0.5), intervals=20)
    known = 2 * np.sqrt(0.5 * ACCELERATION / (ACCELERATION**2 - push**2))
    assert found.duration == pytest.approx(known, rel=1e-6)
    assert 0.97 * known < found.lower_bound <= known


@pytest.mark.slow
def test_half_a_turn_takes_a_quarter_of_a_second():
    goal = Goal(0.0, 0.0, np.pi, turn="exact")
    found = fastest((0, 0, 0), goal, limits=Limits(spin=40.0), intervals=20)
    assert found.time == pytest.approx(0.252, rel=5e-3)


@pytest.mark.slow
@pytest.mark.parametrize("model", [M3, EFFECTS], ids=["M3", "effects"])
def test_an_independent_integration_ends_at_the_goal(model):
    start = (-0.3, -0.1, 0.5, 0.8, 0.3, 2.0)
    asked = checked_request(model, start, (0.2, 0.1, -0.3), (), Table(), (), Limits())
    path = search(asked, 12)[0].path
    with jax.enable_x64(True):
        end = integrated(model, path)[:6]
    away = end - np.array([0.2, 0.1, -0.3, 0, 0, 0])
    assert np.abs(away[:2]).max() < 1e-3
    assert np.abs(away[3:5]).max() < 1e-3
    assert abs(away[2]) < 1e-3


@pytest.mark.parametrize(
    ("propellers", "goal", "spin"),
    [
        (0, (0.2, 0.0, 1.5), 2.0),
        pytest.param(5, (0.3, 0.0, 1.5), 2.0, marks=pytest.mark.slow),
        # These take 5 to 20 s.
        pytest.param(0, (0.02, 0.0, 0.6), 1.0, marks=pytest.mark.study),
        pytest.param(0, (0.3, 0.0, 3.0), 3.0, marks=pytest.mark.study),
        pytest.param(0, (0.0, 0.0, 0.3), 0.5, marks=pytest.mark.study),
        pytest.param(4, (0.3, 0.0, 1.5), 1.0, marks=pytest.mark.study),
        pytest.param(8, (0.02, 0.0, 0.6), 1.0, marks=pytest.mark.study),
    ],
)
def test_a_low_spin_limit_determines_the_time(propellers, goal, spin):
    model = ring(propellers) if propellers else M3
    asked = checked_request(model, at_rest(0), goal, (), None, (), Limits(spin=spin))
    found, _ = search(asked, 20)
    least = goal[2] / spin
    assert least < found.time < 1.1 * least + 0.1
    _, states = found.path.simulated(model, found.path.times, 10)
    assert np.abs(states[:, 5]).max() < 1.002 * spin


@pytest.mark.slow
def test_the_search_finds_one_of_the_best_final_yaws():
    """With the start's yaw as the only initial guess, this plan was 3 % slower than the best."""
    asked = checked_request(M3, (0, 0, 0.4), Goal(0.3, 0.0, None), (), None, (), Limits())
    found, tried = search(asked, 20)
    times = [start.time_s for start in tried if start.time_s is not None]
    assert len(times) > 5
    assert found.time < 0.445
    assert tried[0].time_s > 1.01 * found.time


@pytest.mark.study
def test_a_four_times_finer_grid_agrees(metre):
    finer = airpuck.plan(M3, (-0.5, 0, 0), (0.5, 0, 0), intervals=160)
    assert finer.duration == pytest.approx(metre.duration, rel=5e-3)


@pytest.mark.slow
def test_a_neighbouring_plan_can_start_a_search(metre):
    found = airpuck.plan(M3, (-0.48, 0.01, 0), (0.5, 0, 0), table=Table(), warm=metre)
    assert [start.name for start in found.starts] == ["the neighbouring plan"]
    assert found.duration == pytest.approx(metre.duration, rel=0.05)


@pytest.mark.slow
def test_waypoints_rails_discs_and_limits_are_respected():
    table = Table(length_m=1.1, width_m=0.6)
    limits = Limits(reserve=0.1, spin=6.0, speed=0.8, margin=0.02)
    disc, point = (0.1, 0.0, 0.05), (-0.1, 0.15)
    asked = checked_request(M3, (-0.3, -0.1, 0), (0.3, 0.1, 0.5), [point], table, [disc], limits)
    path = search(asked, 20)[0].path
    _, states = path.simulated(M3, path.times, 10)
    assert np.hypot(*(states[:, :2] - point).T).min() < 2e-3
    away = np.hypot(*(states[:, :2] - disc[:2]).T).min()
    # It passes the disc and the rail as near as it may, as fast as it may.
    assert away == pytest.approx(disc[2] + M3.vehicle.radius_m + limits.margin, abs=1e-3)
    reach = table.reach(M3.vehicle.radius_m + limits.margin)
    assert np.abs(states[:, 0]).max() < reach[0]
    assert np.abs(states[:, 1]).max() == pytest.approx(reach[1], abs=3e-3)
    assert np.abs(path.states[:, 3:5]).max() == pytest.approx(limits.speed, abs=1e-6)
    assert np.abs(path.states[:, 5]).max() < limits.spin + 1e-6
    full = M3.dynamics.thrust.sum(axis=1)
    curves = M3.dynamics.thrust
    force = sum(curves[:, k] * path.commands ** (k + 1) for k in range(3))
    assert (force <= 0.9 * full + 1e-6).all()


@pytest.mark.slow
def test_a_goal_with_free_components_is_reached_sooner(metre):
    goal = Goal(0.5, 0.0, None, None)
    free = airpuck.plan(M3, (-0.5, 0, 0), goal, table=Table(), intervals=20)
    assert 0.9 * free.duration < free.lower_bound < free.duration < 0.8 * metre.duration


@pytest.mark.slow
def test_a_plan_feeds_its_accelerations_forward(metre):
    flown = metre.starting(2.0)
    assert isinstance(flown, Reference)
    np.testing.assert_allclose(flown.at(1.0, 0.1).state, [-0.5, 0, 0, 0, 0, 0], atol=1e-9)
    np.testing.assert_allclose(flown.at(5.0, 0.1).state, [0.5, 0, 0, 0, 0, 0], atol=1e-3)
    times = np.linspace(0, metre.duration, 4001)
    targets = [flown.at(2.0 + t - 0.02, 0.02) for t in times]
    gained = np.trapezoid([target.acceleration for target in targets], times, axis=0)
    middle = int(np.argmax([target.state[3] for target in targets]))
    velocity = np.trapezoid(
        [target.acceleration for target in targets[: middle + 1]], times[: middle + 1], axis=0
    )
    np.testing.assert_allclose(gained, 0, atol=0.02)
    np.testing.assert_allclose(velocity, targets[middle].state[3:], atol=0.02)
    assert targets[middle].state[3] == pytest.approx(metre.states[:, 3].max(), rel=0.01)
    assert flown.motors_at(2.0, 0.0) == pytest.approx(metre.commands[0])
    assert flown.motors_at(9.0, 0.0) == pytest.approx(np.full(6, M3.vehicle.command_min))
    ahead = np.linspace(-0.1, metre.duration + 0.1, 57)
    for together in (flown.state_at, flown.motors_at):
        one_by_one = [together(2.0, float(t)) for t in ahead]
        np.testing.assert_array_equal(together(2.0, ahead), one_by_one)


@pytest.fixture
def coasting() -> Plan:
    """Half a second at 1 m/s with all motors at their smallest command."""
    states = np.zeros((2, 12))
    states[:, 3] = 1.0
    states[1, 0] = 0.5
    return Plan(M3, np.array([0.0, 0.5]), states, np.full((1, 6), M3.vehicle.command_min), None)


def test_a_plan_rests_before_its_start_and_after_its_end(coasting):
    flown = coasting.starting(2.0)
    before, during, after = (flown.at(now, 0.01).state for now in (1.9, 2.2, 2.6))
    np.testing.assert_allclose(before, np.zeros(6))
    np.testing.assert_allclose(during[:5], [0.21, 0, 0, 1, 0], atol=0.01)
    np.testing.assert_allclose(after, [0.5, 0, 0, 0, 0, 0], atol=0.05)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("times_s = [0.0, 0.5]", "times_s = [0.0]", "times_s: must have two entries"),
        ("times_s = [0.0, 0.5]", "times_s = [0.0, 0.0]", "times_s: must increase from 0"),
        ("times_s = [0.0, 0.5]", "times_s = [0.1, 0.5]", "times_s: must increase from 0"),
        ("    [0.5, ", "    [", "states: must be finite numbers of the shape"),
        ("    [0.0, 0.0, ", "    [", "states: must be finite numbers of the shape"),
        ("    [0.03, ", "    [", "commands: must be finite numbers of the shape"),
        (
            "commands = [",
            "commands = [\n    [0.1, 0.1, 0.1, 0.1, 0.1, 0.1],",
            "commands: must be finite",
        ),
    ],
)
def test_inconsistent_rows_of_a_plan_file_are_rejected(coasting, tmp_path, old, new, said):
    path = tmp_path / "plan.toml"
    coasting.save(path)
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(InputError, match=said):
        read_plan(path, M3)


@pytest.mark.slow
def test_smoother_switching_costs_little_time(metre):
    gentle = fastest((-0.5, 0, 0), (0.5, 0, 0), limits=Limits(smoothing=2e-4), intervals=30)
    assert metre.duration < gentle.time < 1.02 * metre.duration
    hardest = [np.abs(np.diff(p.commands, axis=0)).max() for p in (metre, gentle.path)]
    assert hardest[1] < 0.6 * hardest[0]


@pytest.mark.slow
def test_a_plan_file_round_trips(metre, tmp_path):
    path = tmp_path / "plan.toml"
    metre.save(path)
    again = read_plan(path, M3)
    np.testing.assert_array_equal(again.states, metre.states)
    np.testing.assert_array_equal(again.commands, metre.commands)
    assert (again.lower_bound, again.duration) == (metre.lower_bound, metre.duration)
    with pytest.raises(InputError, match="is for the motors"):
        read_plan(path, one_axis())
    path.write_text(path.read_text().replace("airpuck plan 1", "airpuck plan 9"))
    with pytest.raises(InputError, match="format"):
        read_plan(path, M3)


@pytest.mark.slow
def test_an_unconverged_plan_is_rejected(metre, monkeypatch):
    # The disc blocks the table from rail to rail.
    asked = {"start": (-0.9, 0, 0), "goal": (0.9, 0, 0), "table": Table()}
    with pytest.raises(InputError, match="no plan was found from any of 1 starts"):
        airpuck.plan(M3, **asked, keep_out=[(0, 0, 0.6)], warm=metre, intervals=20)
    monkeypatch.setitem(transcription._OPTIONS["ipopt"], "max_iter", 3)
    with pytest.raises(InputError, match=r"any of 10 starts \(Maximum_Iterations_Exceeded\)"):
        airpuck.plan(one_axis(), **asked, keep_out=[(0, 0, 0.3)], intervals=20)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("start", "goal", "found"),
    [
        # The best of eight random starts; 1.0 and 1.3 % slower without first turning the other way.
        ((0, 0, 0.522, -0.41, -0.397, 1.483), (0.56589, -0.8585), 0.7672),
        pytest.param(
            *((0, 0, -3.009, 0.447, 0.166, -0.482), (0.0729, 0.32041), 0.4311),
            marks=pytest.mark.study,
        ),
    ],
)
def test_random_starts_do_not_beat_the_search_over_a_free_yaw(start, goal, found):
    request = checked_request(M3, start, Goal(*goal), (), None, (), Limits())
    assert search(request, 20)[0].time < 1.005 * found


@pytest.mark.slow
def test_a_craft_that_pushes_one_way_turns_round_to_brake():
    # Three propellers, and at most 4.6 rad/s of spin: start and stop each need half a turn.
    model = craft_of_three()
    goal = Goal(0.03, 0.05, -0.3, turn="exact")
    request = checked_request(model, (0, 0, 0), goal, (), None, (), Limits(spin=4.6))
    solved, tried = search(request, 20)
    assert "turned round" in tried[-1].name
    assert np.pi / 4.6 < solved.time < 3.0


def craft_of_three():
    """A ring of three skewed propellers, which push in one direction only without a moment."""
    return nominal_model(
        Vehicle(
            name="three",
            mass_kg=0.25,
            propellers=tuple(
                Propeller(
                    name=f"p{k}",
                    position_m=(0.05 * np.cos(angle), 0.05 * np.sin(angle)),
                    direction_deg=float(np.rad2deg(angle) + (140.0 if k == 1 else -140.0)),
                )
                for k, angle in enumerate(2 * np.pi * np.arange(3) / 3)
            ),
            nominal=Nominal(thrust_N=(0.1, 0.4), inertia_kg_m2=5e-4, motor_time_constant_s=0.08),
        )
    )
