"""The excitation experiment's pilot: signals, mixing, and keeping to the table."""

import numpy as np
import pytest
from scipy.stats import kstest

from airpuck import InputError, SetPoint, Vehicle
from airpuck.control.authority import control_authority, weakest_effort
from airpuck.control.excitation import Excitation
from airpuck.control.settings import ExcitationPlan, read_excitation_plan
from airpuck.craft.vehicle import default_vehicle
from airpuck.model.model_file import nominal_model

from ..apparatus.refusals import rejected

VEHICLE = default_vehicle()
MODEL = nominal_model(VEHICLE)
IDLE = VEHICLE.command_min
PERIOD = 0.01
#: A hair of a command above idle.
ABOVE = IDLE + 1e-9
#: The controller's own command to a motor at rest in the centre: slightly above idling.
AT_REST = 0.02


def pilot(model=MODEL, **values):
    return Excitation(model, **values)


def at_rest(excitation, steps, pose=(0.0, 0.0, 0.0), start=0.0):
    """Return the commands to a craft that is held in place, whatever the motors do."""
    commands = []
    for k in range(steps):
        now = start + k * PERIOD
        excitation.pose(now, np.array(pose))
        commands.append(excitation.step(now).command)
    return np.array(commands)


def craft(count, pairs=()):
    """Propellers that push in directions all around, and turn the craft either way."""
    propellers = []
    for i in range(count):
        push = 90 + 360 * i / count
        angle = np.deg2rad(push + (90 if i % 2 else -90))
        position = (0.05 * np.cos(angle), 0.05 * np.sin(angle))
        propellers.append({"name": f"m{i}", "position_m": position, "direction_deg": push})
    content = {**VEHICLE.model_dump(), "propellers": propellers, "pairs": pairs}
    return nominal_model(Vehicle.model_validate(content))


def signal_of(commands):
    """Return the signal of each pair, with the sign of the motor that runs."""
    first, second = commands[:, 0::2], commands[:, 1::2]
    return np.where(first > second, first, -second)


def test_at_rest_one_motor_of_each_pair_runs_and_the_other_idles():
    commands = at_rest(pilot(), 600)
    first, second = commands[:, 0::2], commands[:, 1::2]
    np.testing.assert_allclose(np.minimum(first, second), IDLE, atol=1e-12)
    assert (np.maximum(first, second) > ABOVE).mean() > 0.9
    # Each of the six runs at some time.
    assert ((commands > 0.2).mean(axis=0) > 0.15).all()


@pytest.mark.parametrize("amplitude", [0.8, (1.0, 0.0, 0.4)])
def test_the_first_motor_gets_the_signal_and_the_second_its_opposite(amplitude):
    # The same numbers as the generator's: one per pair, even for a silent one, and 200 ms.
    commands = at_rest(pilot(amplitude=amplitude, seed=5), 200)
    drawn = np.random.default_rng(5).uniform(-1, 1, (10, 3)) * amplitude
    signals = np.repeat(drawn, 20, axis=0)
    np.testing.assert_allclose(commands[:, 0::2], np.clip(signals, IDLE, 1), atol=1e-6)
    np.testing.assert_allclose(commands[:, 1::2], np.clip(-signals, IDLE, 1), atol=1e-6)


@pytest.mark.parametrize("hold", [0.01, 0.05, 0.33])
def test_signals_are_held_for_the_requested_time(hold):
    commands = at_rest(pilot(hold=hold, seed=2), 500)
    times = PERIOD * np.arange(500)
    turn = np.floor((times + 1e-6) / hold)
    changed = np.abs(np.diff(commands, axis=0)).max(axis=1) > 1e-3
    np.testing.assert_array_equal(changed, np.diff(turn) > 0)


def test_signals_follow_the_clock_when_steps_are_missed():
    whole = at_rest(pilot(seed=3), 200)
    excitation = pilot(seed=3)
    at_rest(excitation, 1)
    late = at_rest(excitation, 40, start=1.6)
    np.testing.assert_allclose(late, whole[160:], atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("amplitude", [1.0, pytest.param(0.4, marks=pytest.mark.study)])
def test_signals_are_uniform_and_independent(amplitude):
    commands = at_rest(pilot(amplitude=amplitude, hold=PERIOD, seed=7), 3000)
    signals = signal_of(commands)
    # Below idle, the command does not reveal the signal.
    told = np.abs(signals) > ABOVE
    assert 1 - told.mean() == pytest.approx(IDLE / amplitude, abs=0.006)
    for column, clear in zip(signals.T, told.T, strict=True):
        size = (np.abs(column[clear]) - IDLE) / (amplitude - IDLE)
        assert kstest(size, "uniform").pvalue > 1e-3
        assert (column[clear] > 0).mean() == pytest.approx(0.5, abs=4 * 0.5 / np.sqrt(3000))
    assert np.abs(np.corrcoef(signals.T) - np.eye(3)).max() < 4 / np.sqrt(3000)
    assert np.abs((signals[1:] * signals[:-1]).mean(axis=0)).max() < 4 * amplitude**2 / 3 / 54


def test_a_seed_determines_the_signals():
    one, same, other = (at_rest(pilot(seed=seed), 60) for seed in (1, 1, 2))
    np.testing.assert_array_equal(one, same)
    assert np.abs(one - other).max() > 0.1


def test_the_signal_is_added_to_the_thrust_that_the_controller_requests():
    # Held 10 cm to the left: w is the difference of what the controller alone gives the two.
    pose = (0.0, 0.1, 0.3)
    excitation = pilot(amplitude=0.3, seed=4)
    found = at_rest(excitation, 10, pose)
    alone = pilot(seed=4).controller
    alone.pose(0.0, np.array(pose))
    command = alone.step(0.0).command
    signal = np.random.default_rng(4).uniform(-0.3, 0.3, 3)
    wanted = command[0::2] - command[1::2] + signal
    assert np.abs(command[0::2] - command[1::2]).max() > 0.1
    np.testing.assert_allclose(found[0, 0::2], np.clip(wanted, IDLE, 1), atol=1e-6)
    np.testing.assert_allclose(found[0, 1::2], np.clip(-wanted, IDLE, 1), atol=1e-6)


@pytest.mark.parametrize("count", [4, 6])
def test_unpaired_propellers_have_their_own_signals(count):
    model = craft(count)
    commands = at_rest(pilot(model, amplitude=0.5, seed=6), 400)
    alone = pilot(model, seed=6).controller
    alone.pose(0.0, np.zeros(3))
    base = alone.step(0.0).command
    signals = np.random.default_rng(6).uniform(-0.5, 0.5, (20, count))
    expected = np.clip(base + np.repeat(signals, 20, axis=0), IDLE, 1)
    np.testing.assert_allclose(commands, expected, atol=0.02)
    assert (np.ptp(commands, axis=0) > 0.2).all()


def test_pairs_and_single_propellers_can_be_combined():
    commands = at_rest(pilot(craft(6, [("m0", "m3")]), seed=8), 1200)
    np.testing.assert_allclose(np.minimum(commands[:, 0], commands[:, 3]), IDLE, atol=AT_REST)
    both = (commands[:, 1] > 0.1) & (commands[:, 4] > 0.1)
    assert both.mean() > 0.1


@pytest.mark.parametrize(
    ("settings", "field", "says"),
    [
        # Opposed forces, equal moments; and opposed moments, forces at right angles.
        ({"model": craft(4, [("m0", "m2")])}, "pairs", "m0 and m2 .* do not oppose"),
        ({"model": craft(4, [("m0", "m1")])}, "pairs", "m0 and m1 .* do not oppose"),
        *(({"margin": wrong}, "margin", None) for wrong in (-0.01, 0.5, np.nan)),
        *(({"amplitude": wrong}, "amplitude", None) for wrong in (0.0, -0.5, 1.01, np.nan)),
        *(
            ({"amplitude": wrong}, "amplitude", "3: of each pair")
            for wrong in ((), (1, 1), (0, 0, 0), (1, 1.01, 1), (1, -0.1, 1), (1, np.nan, 1))
        ),
        *(({"hold": wrong}, "hold", r"0\.01 s") for wrong in (0.0, -1.0, 0.009, np.nan)),
    ],
)
def test_invalid_excitation_settings_are_rejected(settings, field, says):
    with rejected(match=says, field=field):
        pilot(**settings)


def test_a_craft_that_turns_one_way_only_is_rejected():
    content = craft(4).vehicle.model_dump()
    for propeller in content["propellers"]:
        push = np.deg2rad(propeller["direction_deg"])
        propeller["position_m"] = (0.05 * np.sin(push), -0.05 * np.cos(push))
    with pytest.raises(InputError, match="turn it both ways"):
        pilot(nominal_model(Vehicle.model_validate(content)))


def test_three_propellers_that_only_push_are_too_few():
    with pytest.raises(InputError, match="cancel in force and in moment"):
        pilot(craft(3))


def test_the_weakest_direction_agrees_with_a_random_search():
    for model in (MODEL, craft(4), craft(5), craft(6)):
        found = weakest_effort(model)
        gyration = np.sqrt(model.parameters.inertia / model.vehicle.mass_kg)
        each = model.dynamics.configuration * np.array([[1.0], [1.0], [gyration]])
        each = each * model.dynamics.thrust.sum(axis=1)
        ways = np.random.default_rng(0).normal(size=(20000, 3))
        ways /= np.linalg.norm(ways, axis=1, keepdims=True)
        tried = np.maximum(ways @ each, 0).sum(axis=1).min()
        assert found <= tried + 1e-9
        assert found == pytest.approx(tried, rel=0.05)


def moving(excitation, position, velocity, steps=15):
    """The last command to a craft that passes a place at a constant velocity."""
    for k in range(steps):
        now = k * PERIOD
        back = (steps - 1 - k) * PERIOD
        excitation.pose(now, np.array([*(np.array(position) - back * np.array(velocity)), 0.0]))
        step = excitation.step(now)
    return step


def controlled(position, velocity):
    """Return the command of the controller alone."""
    controller = pilot().controller
    moving(controller, position, velocity)
    return controller.step(14 * PERIOD).command


@pytest.mark.parametrize(
    ("position", "velocity"),
    [
        ((0.99, 0.0), (0.0, 0.0)),
        ((-0.99, 0.0), (0.0, 0.0)),
        ((0.0, 0.44), (0.0, 0.0)),
        ((0.0, -0.44), (0.0, 0.0)),
        ((0.0, 0.35), (0.0, 1.2)),
        ((0.9, 0.0), (1.5, 0.0)),
    ],
)
def test_signals_pause_where_the_craft_could_not_stop(position, velocity):
    excitation = pilot(seed=1)
    step = moving(excitation, position, velocity)
    assert excitation.pauses > 0
    # The controller's own command, not one motor of each pair.
    np.testing.assert_allclose(step.command, controlled(position, velocity), atol=1e-9)


@pytest.mark.parametrize(
    ("position", "velocity"),
    [((0.4, 0.0), (0.0, 0.0)), ((0.0, 0.35), (0.0, 0.0)), ((0.7, 0.0), (-1.5, 0.0))],
)
def test_signals_continue_where_the_craft_can_stop(position, velocity):
    excitation = pilot(seed=1)
    step = moving(excitation, position, velocity)
    assert excitation.pauses == 0
    assert np.abs(step.command - controlled(position, velocity)).max() > 0.02
    np.testing.assert_allclose(np.minimum(step.command[0::2], step.command[1::2]), IDLE)


def test_a_wider_margin_pauses_the_signals_earlier():
    for y, pauses in ((0.26, False), (0.29, True)):
        excitation = pilot(seed=1, margin=0.2)
        moving(excitation, (0.0, y), (0.0, 0.0))
        assert (excitation.pauses > 0) == pauses  # 0.55 m - radius - margin is 0.28 m


def pauses_just_beyond(stop, velocity=(0.8, 0.0), y=0.0, hair=0.01, sent=None, **settings):
    """Check that signals pause beyond the place from which the craft needs this way to stop."""
    limit = 2.2 / 2 - 0.07 - 0.05 - stop
    for offset, pauses in ((-hair, False), (hair, True)):
        excitation = pilot(seed=1, **settings)
        moving(excitation, (limit + offset, y), velocity, steps=30)
        if sent is not None:
            excitation.sent(28 * PERIOD, sent)
        now = excitation.controller.filter.predict(29 * PERIOD).state
        assert sent is not None or now[3] == pytest.approx(velocity[0], abs=0.02)
        paused = excitation.pauses
        excitation.step(29 * PERIOD)
        assert (excitation.pauses > paused) == pauses


def test_the_braking_distance_agrees_with_a_hand_calculation():
    # In its weakest direction the paper's craft pushes with two and with one half propeller.
    full = sum(VEHICLE.nominal.thrust_N)
    weakest = min(
        sum(max(np.cos(np.deg2rad(p.direction_deg) - a), 0) for p in VEHICLE.propellers)
        for a in np.linspace(0, 2 * np.pi, 3601)
    )
    braking = 0.5 * weakest * full / VEHICLE.mass_kg
    pauses_just_beyond(0.8**2 / (2 * braking))


@pytest.mark.parametrize("late", [0.0, 0.1])
def test_near_a_rail_a_slow_craft_pushes_back_and_ignores_its_yaw(late):
    excitation = pilot(seed=1, reaction=late)
    # Turned by 1 rad, which the regulator corrects unless the craft answers late.
    for now in (0.0, PERIOD):
        excitation.pose(now, np.array([1.05, 0.0, 1.0]))
        step = excitation.step(now)
    assert step.request[0] < -0.5
    assert (abs(step.request[2]) < 1e-6) == (late > 0)
    excitation.pose(0.5, np.array([0.3, 0.0, 1.0]))
    excitation.step(0.5)
    assert excitation.controller.reference is excitation.reference


def weakest_push() -> float:
    """The largest acceleration along the weakest axis that does not turn the craft."""
    alone = control_authority(MODEL).alone
    return min(alone[way] for way in ("forward", "back", "left", "right"))


@pytest.mark.parametrize("pull", [-0.3, 0.3, 9.0])
def test_a_craft_on_a_slope_brakes_earlier_downhill(pull):
    # With idle motors it gains speed for 0.1 s; then brakes and slope act together.
    weakest, late, speed = weakest_push(), 0.1, 0.6
    faster = speed + pull * late
    # However much pulls, a quarter of the braking is left.
    braking = max(0.5 * weakest - pull, 0.125 * weakest)
    stop = (speed + faster) / 2 * late + faster**2 / (2 * braking)
    # Braking after what was gained, or from now on: the longer way counts.
    stop = max(stop, speed * late + speed**2 / (2 * braking))
    pauses_just_beyond(stop, (speed, 0.0), hair=0.015, reaction=late, pull=(pull, 0.0))


def test_a_craft_moving_diagonally_shares_its_braking_force():
    # 0.3 and 0.4 m/s are 0.5 m/s in all, of which the brakes take three fifths along x.
    braking, late = 0.5 * weakest_push(), 0.05
    stop = 0.3 * late + 0.3 * 0.5 / (2 * braking)
    pauses_just_beyond(stop, (0.3, 0.4), y=-0.2, reaction=late)


@pytest.mark.parametrize("forward", [True, False])
def test_a_slow_craft_brakes_earlier_if_its_motors_push_outwards(forward):
    # For 0.1 s its motors go on pushing forward; then it brakes. Idle motors push nowhere.
    full = sum(VEHICLE.nominal.thrust_N) / VEHICLE.mass_kg
    directions = np.deg2rad([p.direction_deg for p in VEHICLE.propellers])
    angles = np.linspace(0, 2 * np.pi, 3601)
    pushes = np.maximum(np.cos(directions[:, None] - angles), 0).sum(axis=0) * full
    late, speed = 0.1, 0.4
    faster = speed + forward * pushes[0] * late
    stop = (speed + faster) / 2 * late + faster**2 / (2 * 0.5 * min(pushes.min(), weakest_push()))
    command = np.where(forward & (np.cos(directions) > 1e-6), 1.0, IDLE)
    pauses_just_beyond(stop, (speed, 0.0), hair=0.015, sent=command, reaction=late)


def test_motors_idle_during_a_long_pause_of_poses_and_then_resume():
    excitation = pilot(seed=3)
    at_rest(excitation, 10)
    step = excitation.step(0.09 + 0.2)
    assert not step.flies
    np.testing.assert_array_equal(step.command, IDLE)
    assert at_rest(excitation, 5, start=0.4).max() > 0.1


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_a_nan_time_idles_the_motors_once(bad):
    whole, excitation = at_rest(pilot(seed=3), 60), pilot(seed=3)
    assert excitation.step(bad).status == "bad input"
    found = at_rest(excitation, 30)
    assert excitation.step(bad).status == "bad input"
    np.testing.assert_allclose(at_rest(excitation, 30, start=0.3), whole[30:], atol=1e-6)
    np.testing.assert_allclose(found, whole[:30], atol=1e-6)


@pytest.mark.timeout(60)
def test_a_clock_jump_costs_no_time_and_the_signals_continue():
    # A year has 10⁸ changes: drawn one by one they would take minutes.
    excitation = pilot(seed=3)
    at_rest(excitation, 5)
    year = 3e7
    after = at_rest(excitation, 40, start=year)
    assert np.abs(np.diff(after, axis=0)).max() > 0.1
    # And back: the signals restart.
    back = at_rest(excitation, 60, start=-5.0)
    changed = np.flatnonzero(np.abs(np.diff(back, axis=0)).max(axis=1) > 1e-3) + 1
    np.testing.assert_array_equal(changed, [20, 40])


def test_it_steers_to_the_middle_by_default():
    np.testing.assert_array_equal(pilot().reference.at(0.0, 0.0).state, 0)
    elsewhere = pilot(reference=SetPoint(0.5, 0.1, 1.0)).reference
    np.testing.assert_array_equal(elsewhere.at(0.0, 0.0).state, [0.5, 0.1, 1.0, 0, 0, 0])


def test_commands_stay_within_limits_for_any_motion():
    rng, excitation = np.random.default_rng(0), pilot(seed=9)
    for k in range(500):
        pose = rng.normal(size=3) if k % 7 == 0 else np.array([0.9 * np.sin(k / 9), 0.2, k / 50])
        excitation.pose(k * PERIOD, pose)
        command = excitation.step(k * PERIOD).command
        assert ((command >= IDLE) & (command <= VEHICLE.command_max)).all()


@pytest.mark.parametrize("amplitude", [0.7, (0.1 + 0.2, 0.0, 1.0)])
def test_a_plan_round_trips(tmp_path, amplitude):
    plan = ExcitationPlan(amplitude=amplitude, hold_s=1 / 3, duration_s=60.0, margin_m=0.1)
    plan.save(tmp_path / "plan.toml")
    assert read_excitation_plan(tmp_path / "plan.toml") == plan


def test_missing_keys_default_to_the_values_of_the_paper(tmp_path):
    (tmp_path / "plan.toml").write_text("hold_s = 0.1\n")
    plan = read_excitation_plan(tmp_path / "plan.toml")
    assert plan == ExcitationPlan(amplitude=1.0, hold_s=0.1, duration_s=90.0, margin_m=0.05)


@pytest.mark.parametrize(
    ("text", "field"),
    [("amplitude = 1.5", "amplitude"), ("hold_s = 0", "hold_s"), ("pause_s = 1", "pause_s")],
)
def test_an_invalid_plan_is_rejected_by_field(tmp_path, text, field):
    (tmp_path / "plan.toml").write_text(text)
    with pytest.raises(InputError) as caught:
        read_excitation_plan(tmp_path / "plan.toml")
    assert caught.value.field.startswith(field)
    assert "plan.toml" in str(caught.value)


def test_a_craft_whose_idle_thrusts_push_sideways_is_excited():
    content = default_vehicle().model_dump(mode="json")
    one, curve = content["propellers"][0], content["nominal"]["thrust_N"][0]
    content |= {"pairs": [], "command_min": 0.3}
    content["nominal"]["thrust_N"] = [curve] * 5
    content["propellers"] = [
        one
        | {"name": f"m{k}", "direction_deg": float(direction)}
        | {"position_m": [0.06 * np.cos(np.radians(at)), 0.06 * np.sin(np.radians(at))]}
        for k, (at, direction) in enumerate(
            [(300, 270), (30, 130), (50, 10), (160, 70), (200, 160)]
        )
    ]
    model = nominal_model(Vehicle.model_validate(content))
    assert min(control_authority(model).alone.values()) == 0.0
    excitation = Excitation(model, seed=1, reaction=0.02, compiled=False)
    for k in range(10):
        excitation.pose(k * PERIOD, np.zeros(3))
        command = excitation.step(k * PERIOD).command
        assert np.isfinite(command).all()
    assert excitation.pauses == 0
