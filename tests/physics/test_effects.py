"""Optional effects, each against a hand calculation."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from airpuck.craft.vehicle import GRAVITY, Vehicle, default_vehicle
from airpuck.model.model_file import published_model
from airpuck.physics.effects import (
    BodyMotion,
    Drag,
    Effect,
    Friction,
    Inflow,
    Layout,
    PairInteraction,
    Tilt,
    VoltageSag,
)
from airpuck.physics.rigid_body import acceleration, register_pytrees
from airpuck.physics.thrust import thrust

VEHICLE = default_vehicle()
PARAMETERS = replace(published_model("M3").parameters, center_of_mass=np.zeros(2), angle_offset=0.0)
LAYOUT = Layout(VEHICLE)
BASE = PARAMETERS.dynamics(np, VEHICLE)
STILL, STOPPED = np.zeros(4), np.zeros(6)
ALL = (
    Inflow.of(LAYOUT, 0.1),
    PairInteraction.of(LAYOUT, 0.5),
    VoltageSag.of(LAYOUT, 0.2),
    Drag(0.3, 0.2, 0.1, 0.05),
    Tilt(0.01, -0.02),
)
yaws = st.floats(-7, 7)
motions = st.tuples(yaws, st.floats(-3, 3), st.floats(-3, 3), st.floats(-15, 15))


def accelerate(effects, motion=STILL, speed=STOPPED, base=BASE):
    return np.array(acceleration(np, replace(base, effects=effects), np.array(motion), speed))


def felt(forward=0.0, left=0.0, spin=0.0):
    return BodyMotion(forward, left, spin, 1.0, 0.0)


def named(name):
    return VEHICLE.propeller_names.index(name)


@pytest.mark.parametrize(
    ("drag", "offset", "moving", "expected"),
    [
        (Drag(linear=0.5, spin_linear=0.2), 0.0, [2.0, -1.0, 3.0], [-1.0, 0.5, -0.6]),
        # |v| = 5: 0.1·5·(3, -4); spin 0.05·4².
        (Drag(quadratic=0.1, spin_quadratic=0.05), 0.0, [3.0, -4.0, -4.0], [-1.5, 2.0, 0.8]),
        # Only the spin is braked: the geometric centre then accelerates by r × ω'.
        (Drag(spin_linear=2.0), 0.01, [0.0, 0.0, 3.0], [0.01 * 9, 0.01 * 6, -6]),
    ],
    ids=["linear", "quadratic", "about the centre of mass"],
)
def test_drag_matches_a_hand_calculation(drag, offset, moving, expected):
    base = replace(BASE, center_of_mass=np.array([offset, 0.0]))
    found = accelerate((drag,), [0.0, *moving], base=base)
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-12)


@given(motions)
def test_drag_opposes_the_motion_at_any_yaw(motion):
    found = accelerate((Drag(0.5, 0.1, 0.2, 0.05),), motion)
    _, vx, vy, spin = motion
    rate = 0.5 + 0.1 * np.hypot(vx, vy)
    np.testing.assert_allclose(found[:2], [-rate * vx, -rate * vy], atol=1e-6)
    assert found[2] == pytest.approx(-(0.2 + 0.05 * abs(spin)) * spin, abs=1e-12)


def test_spin_drag_only_turns_and_drag_only_pushes():
    assert accelerate((Drag(0.5, 0.1),), [1.0, 2.0, 1.0, 9.0])[2] == 0
    np.testing.assert_array_equal(
        accelerate((Drag(spin_linear=1.0, spin_quadratic=1.0),), [1.0, 2.0, 1.0, 9.0])[:2], 0
    )


@given(yaws)
def test_a_tilt_pulls_in_a_fixed_world_direction(yaw):
    found = accelerate((Tilt(0.01, -0.02),), [yaw, 1.0, 1.0, 0.0])
    np.testing.assert_allclose(found, [9.81 * 0.01, -9.81 * 0.02, 0], atol=1e-12)


def test_gravity_is_standard_gravity():
    assert pytest.approx(9.81, abs=0.01) == GRAVITY


def test_a_propeller_moving_along_its_thrust_loses_thrust():
    # motor_a_1 pushes left: moving left at 2 m/s costs 0.1·2, moving right gains as much.
    inflow, one = Inflow.of(LAYOUT, 0.1), np.ones(6)
    a_1, a_2 = named("motor_a_1"), named("motor_a_2")
    leftward = inflow.thrust(np, one, felt(left=2.0))
    assert leftward[a_1] == pytest.approx(0.8)
    assert leftward[a_2] == pytest.approx(1.2)
    rightward = inflow.thrust(np, one, felt(left=-2.0))
    assert rightward[a_1] == pytest.approx(1.2)
    # Motion across the thrust has no effect.
    assert inflow.thrust(np, one, felt(forward=2.0))[a_1] == pytest.approx(1.0)


def test_inflow_follows_the_direction_of_each_propeller():
    # motor_b_1 pushes to 210 degrees, that is against forward motion by cos 30.
    change = Inflow.of(LAYOUT, 0.1).thrust(np, np.ones(6), felt(forward=1.0)) - 1
    assert change[named("motor_b_1")] == pytest.approx(0.1 * np.sqrt(3) / 2)
    assert change[named("motor_b_2")] == pytest.approx(-0.1 * np.sqrt(3) / 2)


def test_spin_contributes_to_the_inflow_of_propellers():
    # motor_a_1 sits 44 mm ahead and pushes left: at ω = 10 rad/s it moves left at 0.44 m/s.
    found = Inflow.of(LAYOUT, 0.1).thrust(np, np.ones(6), felt(spin=10.0))
    expected = 0.1 * 10 * 0.044048012075
    assert found[named("motor_a_1")] == pytest.approx(1 - expected)
    # Its twin pushes right from the same distance; the craft has a symmetry of a third of a turn.
    assert found[named("motor_a_2")] == pytest.approx(1 + expected)
    np.testing.assert_allclose(found, np.tile(found[:2], 3), atol=1e-9)


@given(motions)
def test_inflow_damps_any_motion(motion):
    # With all motors at the same thrust it takes power from every motion, F·v < 0.
    base = replace(BASE, thrust=np.tile([1.0, 0.0, 0.0], (6, 1)))
    speed = np.full(6, 0.5)
    change = accelerate((Inflow.of(LAYOUT, 0.1),), motion, speed, base) - accelerate(
        (), motion, speed, base
    )
    _, vx, vy, spin = motion
    force, moment = VEHICLE.mass_kg * change[:2], PARAMETERS.inertia * change[2]
    # Each takes c F v²: over the pairs 3 v², over all 6 arms ω². The rest cancels.
    arm = 0.044048012075
    expected = -0.1 * 0.5 * (3 * (vx**2 + vy**2) + 6 * (arm * spin) ** 2)
    assert force @ [vx, vy] + moment * spin == pytest.approx(expected, rel=1e-6, abs=1e-9)


def test_pair_interaction_matches_a_hand_calculation():
    # 0.4 N and 0.1 N with c = 0.5: 0.4 / 1.05 and 0.1 / 1.2; an unpaired propeller loses nothing.
    force = np.array([0.4, 0.1, 0.3, 0.0, 0.0, 0.0])
    found = PairInteraction.of(LAYOUT, 0.5).thrust(np, force, felt())
    np.testing.assert_allclose(found, [0.4 / 1.05, 0.1 / 1.2, 0.3, 0, 0, 0], rtol=1e-14)


def test_pairs_come_from_the_vehicle():
    pairs = (("motor_a_1", "motor_b_2"),)
    craft = Vehicle.model_validate({**VEHICLE.model_dump(), "pairs": pairs})
    twins = PairInteraction.of(Layout(craft), 1.0).twins
    assert twins.sum() == 2
    assert twins[0, 3] == twins[3, 0] == 1


def test_battery_sag_matches_a_hand_calculation():
    # 4 N in all and c = 1/2: q = 2 / (1 + √9) = 1/2, so a quarter of each thrust remains. The
    # load at that voltage, 1 N, costs c · 1 N = 1/2 of the voltage: the equation is satisfied.
    force = np.array([1.6, 0.4, 1.0, 0.0, 0.7, 0.3])
    found = VoltageSag.of(LAYOUT, 0.5).thrust(np, force, felt())
    np.testing.assert_allclose(found, force / 4, rtol=1e-14)


@given(st.floats(0, 5), st.lists(st.floats(0, 2), min_size=6, max_size=6))
def test_voltage_and_load_of_a_battery_agree(coefficient, thrusts):
    force = np.array(thrusts)
    left = VoltageSag.of(LAYOUT, coefficient).thrust(np, force, felt())
    voltage = 1 - coefficient * left.sum()
    np.testing.assert_allclose(left, voltage**2 * force, rtol=1e-9, atol=1e-300)


def test_effects_act_in_sequence():
    # The pair interaction acts on the thrusts after the inflow effect.
    speed, motion = np.linspace(0.2, 0.9, 6), [0.0, 0.0, 2.0, 0.0]
    forces = thrust(BASE.thrust, speed) * (1 - 0.1 * VEHICLE.directions[:, 1] * 2.0)
    partner = forces[[1, 0, 3, 2, 5, 4]]
    expected = BASE.configuration @ (forces / (1 + 0.5 * partner))
    found = accelerate(ALL[:2], motion, speed)
    np.testing.assert_allclose(found, expected, rtol=1e-9)


@pytest.mark.parametrize(
    "effects",
    [
        (),
        (Effect(),),
        (Drag(),),
        (Tilt(),),
        (Inflow.of(LAYOUT, 0.0),),
        (PairInteraction.of(LAYOUT, 0.0),),
        (VoltageSag.of(LAYOUT, 0.0),),
    ],
)
@given(motions)
def test_an_effect_with_zero_coefficients_changes_nothing(effects, motion):
    speed = np.linspace(0.1, 0.9, 6)
    np.testing.assert_array_equal(
        accelerate(effects, motion, speed), acceleration(np, BASE, np.array(motion), speed)
    )


@pytest.mark.parametrize("effect", ALL, ids=lambda effect: type(effect).__name__)
def test_every_effect_changes_the_motion(effect):
    motion, speed = [0.4, 1.0, -0.5, 2.0], np.linspace(0.1, 0.9, 6)
    change = accelerate((effect,), motion, speed) - accelerate((), motion, speed)
    assert np.abs(change).max() > 0.05


def test_a_batch_equals_single_craft():
    rng = np.random.default_rng(0)
    motion, speed = rng.normal(size=(4, 20)), rng.uniform(0, 1, (6, 20))
    dynamics = replace(BASE, effects=ALL)
    together = np.array(acceleration(np, dynamics, motion, speed))
    for i in range(20):
        np.testing.assert_allclose(
            together[:, i], accelerate(ALL, motion[:, i], speed[:, i]), rtol=1e-12
        )


@pytest.mark.slow
@pytest.mark.parametrize("motion", [STILL, np.array([0.4, 1.0, -0.5, 2.0])])
def test_jax_agrees_and_has_finite_derivatives_even_at_rest(motion):
    dynamics, speed = replace(BASE, effects=ALL), np.full(6, 0.3)

    def found(motion):
        return jnp.stack(jnp.asarray(acceleration(jnp, dynamics, motion, jnp.asarray(speed))))

    with jax.enable_x64(True):
        np.testing.assert_allclose(found(motion), accelerate(ALL, motion, speed), rtol=1e-12)
        slope = np.asarray(jax.jacobian(found)(jnp.asarray(motion)))
    assert np.isfinite(slope).all()
    step = 1e-5
    for i, unit in enumerate(np.eye(4)):
        ends = [accelerate(ALL, motion + s * unit, speed) for s in (-step, step)]
        np.testing.assert_allclose(slope[:, i], (ends[1] - ends[0]) / (2 * step), atol=1e-5)


def test_jax_tells_effects_with_as_many_coefficients_apart():
    register_pytrees()
    assert jax.tree.structure(Tilt()) != jax.tree.structure(Friction())
