"""The plant: a craft between rails, against conservation laws, hand calculation and scipy."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from airpuck.craft.table import Table
from airpuck.craft.vehicle import GRAVITY
from airpuck.model.model_file import published_model
from airpuck.physics.puck import Disc
from airpuck.physics.rigid_body import Dynamics, step
from airpuck.twin.plant import LONGEST_STEP, Plant, advance, build_plant
from airpuck.twin.settings import Effects, default_twin_settings

from ..apparatus.examples import examples

PUBLISHED = published_model("M3")
#: The published craft with an offset that matters, fixed to the body.
MODEL = replace(
    PUBLISHED,
    parameters=replace(
        PUBLISHED.parameters, center_of_mass=np.array([3e-3, -2e-3]), angle_offset=0.0
    ),
    frame="body",
)
EFFECTS = Effects(
    drag_linear_1_s=0.3,
    drag_quadratic_1_m=0.2,
    spin_drag_linear_1_s=0.1,
    spin_drag_quadratic_1_rad=0.05,
    inflow_s_m=0.1,
    pair_interaction_1_N=0.4,
    tilt_rad=(0.004, -0.002),
)
ALL_EFFECTS = default_twin_settings().model_copy(update={"effects": EFFECTS})
#: A disc that is not homogeneous: its inertia differs.
DISC = Disc(0.0, 0.0, radius=0.07, mass=0.14, inertia=0.26e-3)
IDLE = np.zeros(6)
TILTED = default_twin_settings().model_copy(
    update={"effects": Effects(tilt_rad=(0.04, -0.06)), "table": Table(restitution=0.2)}
)


@pytest.fixture(scope="module")
def plant():
    return build_plant(MODEL)


@pytest.fixture(scope="module")
def plant_with_effects():
    return build_plant(MODEL, ALL_EFFECTS)


def coasting(center_of_mass=(0.0, 0.0), n=6):
    """No thrust whatever the motors do."""
    return Dynamics(np.zeros((n, 3)), np.zeros((3, n)), np.array(center_of_mass), 0.03)


def craft(x=0.0, y=0.0, yaw=0.0, vx=0.0, vy=0.0, spin=0.0):
    return np.concatenate([[x, y, yaw, vx, vy, spin], IDLE])


def hit(state, table, center_of_mass=(0.0, 0.0)):
    """Take one step from a state that meets a rail."""
    before = state[3:6].copy()
    after = advance(np, Plant(coasting(center_of_mass), DISC, table), state, IDLE, 1e-4)
    assert not np.allclose(after[3:6], before, atol=1e-6)
    return after


def offset(state, center_of_mass):
    """From the geometric centre to the centre of mass, in the world."""
    cos, sin = np.cos(state[2]), np.sin(state[2])
    rx, ry = center_of_mass
    return cos * rx - sin * ry, sin * rx + cos * ry


def center_velocity(state, center_of_mass):
    rx, ry = offset(state, center_of_mass)
    return np.array([state[3] - state[5] * ry, state[4] + state[5] * rx])


def energy(state, center_of_mass, disc=DISC):
    speed = center_velocity(state, center_of_mass)
    return disc.mass / 2 * (speed**2).sum(axis=0) + disc.inertia / 2 * state[5] ** 2


def crafts(rng, count):
    """Random craft in the middle of the table, as columns."""
    low = np.array([-0.9, -0.4, -3, -2, -2, -8])[:, None]
    motion = rng.uniform(low, -low, (6, count))
    return np.concatenate([motion, np.zeros((6, count))])


def test_without_thrust_the_centre_of_mass_moves_straight_with_constant_spin(plant):
    r = MODEL.parameters.center_of_mass
    first = state = craft(-0.5, 0.1, 0.4, 0.6, -0.2, 5.0)
    velocity = center_velocity(state, r)
    begin = state[:2] + offset(state, r)
    for _ in range(240):
        state, _ = plant.advance(state, IDLE, LONGEST_STEP, np.ones(6))
        assert state[5] == first[5]
        np.testing.assert_allclose(center_velocity(state, r), velocity, atol=1e-10)
    np.testing.assert_allclose(state[:2] + offset(state, r), begin + velocity, atol=1e-9)
    assert state[2] == pytest.approx(0.4 + 5.0, abs=1e-12)


@pytest.mark.slow
def test_two_craft_share_a_compiled_simulation_and_keep_their_own_numbers():
    other = replace(MODEL.parameters, inertia=1e-3, motor_time_constant=0.06)
    other = replace(MODEL, parameters=other)
    given = np.array([1.0, 0.1, 0.3, 2, -0.4, 5, *6 * [0.1]]), np.full(6, 0.5), np.float64(4e-3)
    moved, tilted = [], Effects(tilt_rad=(0, 0.1))
    for effects, craft in ((EFFECTS, MODEL), (EFFECTS, other), (tilted, other)):
        settings = default_twin_settings().model_copy(update={"effects": effects})
        both = [build_plant(craft, settings, compiled=c).advance for c in (True, False)]
        ours, exact = (one(*given, np.ones(6))[0] for one in both)
        np.testing.assert_allclose(ours, exact, rtol=1e-12)
        moved.append(both[0].func)
    assert moved[0] is moved[1] is not moved[2]


def test_elastic_rails_without_friction_conserve_energy():
    r, table = (3e-3, -2e-3), Table(restitution=1.0, friction=0.0)
    state = crafts(np.random.default_rng(1), 20)
    first, hits = energy(state, r), np.zeros(20)
    # At the longest step, spins above 20 rad/s cause errors of 1e-8 between the rails.
    for _ in range(10 * 480):
        new = advance(
            np, Plant(coasting(r), DISC, table), state, np.zeros((6, 20)), LONGEST_STEP / 2
        )
        hits += np.abs(center_velocity(new, r) - center_velocity(state, r)).max(axis=0) > 1e-3
        state = new
    assert np.median(hits) > 12
    np.testing.assert_allclose(energy(state, r), first, rtol=1e-9)


def test_off_centre_hits_turn_the_craft_about_its_centre_of_mass():
    # The impulse J at the contact points along -x and passes below the centre of mass, by r_y:
    # it turns the craft clockwise, I ω = -J r_y. The contact's normal speed equals the normal speed
    # of the middle.
    r, table = (0.0, 4e-3), Table(restitution=1.0, friction=0.0)
    after = hit(craft(x=1.03, vx=1.0), table, r)
    effective = 1 / (1 / DISC.mass + 4e-3**2 / DISC.inertia)
    impulse = 2 * effective
    assert after[5] == pytest.approx(-impulse * 4e-3 / DISC.inertia, rel=1e-9)
    assert center_velocity(after, r)[0] == pytest.approx(1 - impulse / DISC.mass, rel=1e-9)
    assert after[3] == pytest.approx(-1.0, rel=1e-9)


@pytest.mark.parametrize("restitution", [0.0, 0.4, 0.7, 1.0])
@pytest.mark.parametrize(("axis", "side"), [(0, 1), (0, -1), (1, 1), (1, -1)])
def test_a_rail_returns_its_share_of_the_normal_speed(axis, side, restitution):
    state = craft()
    state[axis] = side * (1.03 if axis == 0 else 0.48)
    state[3 + axis] = side * 0.8
    after = hit(state, Table(restitution=restitution))
    assert after[3 + axis] == pytest.approx(-side * 0.8 * restitution, abs=1e-12)
    assert after[4 - axis] == 0
    assert after[5] == 0


@pytest.mark.parametrize("slip", [1, -1])
@pytest.mark.parametrize(
    ("position", "normal"),
    [((1.03, 0), (1, 0)), ((-1.03, 0), (-1, 0)), ((0, 0.48), (0, 1)), ((0, -0.48), (0, -1))],
)
def test_friction_spins_a_sliding_disc(position, normal, slip):
    # Towards the wall at 1 m/s, along it at 2 m/s: friction μ (1 + e) slows it and turns it.
    e, mu = 0.7, 0.1
    outward = np.array(normal)
    along = slip * np.array([-outward[1], outward[0]])
    state = craft(*position)
    state[3:5] = outward + 2 * along
    after = hit(state, Table(restitution=e, friction=mu))
    loss = mu * (1 + e)
    np.testing.assert_allclose(after[3:5], -e * outward + (2 - loss) * along, atol=1e-12)
    # The contact is at R·outward; the force on it points against the slip.
    arm, force = DISC.radius * outward, -along * loss * DISC.mass
    torque = arm[0] * force[1] - arm[1] * force[0]
    assert after[5] == pytest.approx(torque / DISC.inertia, rel=1e-12)


@pytest.mark.parametrize("friction", [0.1, 5.0])  # slips, sticks
def test_friction_conserves_angular_momentum_about_the_contact(friction):
    state = craft(y=0.48, vx=0.7, vy=0.9, spin=-4.0)
    after = hit(state, Table(friction=friction))

    def momentum(z):
        return DISC.mass * DISC.radius * z[3] + DISC.inertia * z[5]

    assert abs(after[5] - state[5]) > 1
    assert momentum(after) == pytest.approx(momentum(state), rel=1e-12)


def test_high_friction_makes_a_disc_roll():
    # The contact stops: v = ω R, and m R v + I ω is what it was.
    after = hit(craft(y=0.48, vx=0.3, vy=1.0), Table(friction=5.0))
    rolling = 0.3 / (1 + DISC.inertia / (DISC.mass * DISC.radius**2))
    assert after[3] == pytest.approx(rolling, rel=1e-12)
    assert after[5] == pytest.approx(rolling / DISC.radius, rel=1e-12)
    assert after[4] == pytest.approx(-0.7, rel=1e-12)


def test_a_rolling_disc_feels_no_friction_from_the_rail():
    after = hit(craft(y=0.48, vx=0.35, vy=1.0, spin=0.35 / DISC.radius), Table(friction=0.5))
    np.testing.assert_allclose(after[3:6], [0.35, -0.7, 5.0], atol=1e-12)


def test_leaving_a_rail_does_not_change_the_velocity():
    state = craft(x=1.031, vx=-0.5, vy=0.3, spin=2.0)
    after = advance(np, Plant(coasting(), DISC, Table()), state, IDLE, 1e-4)
    np.testing.assert_array_equal(after[3:6], state[3:6])


def test_a_craft_rebounds_from_a_corner():
    after = hit(craft(1.03, 0.48, vx=1.0, vy=0.5), Table(restitution=0.5, friction=0.0))
    np.testing.assert_allclose(after[3:5], [-0.5, -0.25], atol=1e-12)


fraction = st.floats(0, 1)


def gained(motion, position, restitution, friction, r):
    """Return the fraction of its energy that a craft gains at a rail."""
    yaw, vx, vy, spin = np.array(motion) * [3, 2, 2, 20]
    table = Table(restitution=restitution, friction=friction)
    state = craft(*position, yaw, vx, vy, spin)
    after = advance(np, Plant(coasting(r), DISC, table), state, IDLE, 1e-9)
    return energy(after, r) / max(energy(state, r), 1e-12) - 1


motions = st.tuples(*[st.floats(-1, 1)] * 4)
places = st.sampled_from([(1.03, 0.0), (-1.03, 0.1), (0.2, 0.48), (0.3, -0.48), (1.03, -0.48)])


@examples(200)
@given(motions, places, fraction, st.floats(0, 1.5))
def test_rails_never_add_energy_to_a_disc(motion, position, restitution, friction):
    assert gained(motion, position, restitution, friction, (0.0, 0.0)) <= 1e-9


@examples(200)
@given(motions, places, st.floats(0, 0.9), st.floats(0, 1.5), st.floats(0, 5e-3))
def test_rails_never_add_energy_to_an_off_centre_disc(motion, position, restitution, friction, r):
    assert gained(motion, position, restitution, friction, (r, 0.0)) <= 1e-9


@pytest.mark.slow
def test_elastic_rails_with_friction_never_add_energy():
    # Kane and Levinson, "Dynamics: Theory and Applications", 1985, section 5.10.
    motion = np.array([4.70093807, 1.28510586, 0.05205187, -4.08070582]) / [3, 2, 2, 20]
    assert gained(motion, (1.03, 0.0), 1.0, 0.3, (5e-3, 0.0)) <= 1e-9


@examples(100)
@given(st.integers(0, 10**6), fraction, st.floats(0, 1))
def test_after_a_hit_the_craft_leaves_the_rail_without_reversing_its_slip(
    seed, restitution, friction
):
    rng = np.random.default_rng(seed)
    state = craft(1.03, 0.0, *rng.uniform(-2, 2, 4))
    state[3] = abs(state[3]) + 0.01
    before, after = (
        z[4] + DISC.radius * z[5]
        for z in (state, hit(state, Table(restitution=restitution, friction=friction)))
    )
    assert after * before >= -1e-12
    assert abs(after) <= abs(before) + 1e-12


@pytest.mark.slow
@pytest.mark.parametrize("restitution", [0.0, 1.0])
def test_a_craft_at_full_power_stays_on_the_table(plant_with_effects, restitution):
    rng = np.random.default_rng(3)
    table = Table(restitution=restitution, friction=0.3)
    state, count = crafts(rng, 30), 30
    disc, touched = plant_with_effects.disc, 0
    reach = np.array(table.reach(disc.radius))[:, None]
    for k in range(6 * 240):
        if k % 120 == 0:
            command = rng.uniform(0, 1, (6, count))
        state = advance(np, replace(plant_with_effects, table=table), state, command, LONGEST_STEP)
        assert (np.abs(state[:2]) <= reach + 1e-4).all()
        touched += (np.abs(state[:2]) > reach - 0.02).any(axis=0).sum()
    assert touched > 100


@pytest.mark.slow
def test_a_craft_on_a_tilted_table_comes_to_rest_in_the_lowest_corner():
    plant = build_plant(MODEL, TILTED)
    state = crafts(np.random.default_rng(4), 5)
    for _ in range(12 * 240):
        state = advance(np, plant, state, np.zeros((6, 5)), LONGEST_STEP)
    x, y = plant.table.reach(plant.disc.radius)
    np.testing.assert_allclose(state[0], x, atol=2e-3)
    np.testing.assert_allclose(state[1], -y, atol=2e-3)


@pytest.mark.parametrize("xp", [np, jnp])
def test_a_batch_equals_single_craft(plant_with_effects, xp):
    rng, plant = np.random.default_rng(5), plant_with_effects
    batch = crafts(rng, 40)
    batch[0, :10], batch[3, :10] = 1.0299, 1.5  # some of them meet a rail, some do not
    batch[1, 10:15], batch[4, 10:15] = -0.4799, -1.0
    batch[6:] = rng.uniform(0, 1, (6, 40))
    command = rng.uniform(0, 1, (6, 40))
    with jax.enable_x64(True):
        together = np.asarray(advance(xp, plant, xp.asarray(batch), xp.asarray(command), 1 / 240))
    single = [advance(np, plant, batch[:, i], command[:, i], 1 / 240) for i in range(40)]
    assert (np.sign(together[3, :10]) == -1).all()
    np.testing.assert_allclose(together, np.stack(single, axis=1), rtol=1e-12, atol=1e-13)


def test_compiled_and_numpy_agree(plant_with_effects):
    rng, plant, bounces = np.random.default_rng(6), plant_with_effects, 0
    for _ in range(100):
        state, command = crafts(rng, 1)[:, 0] * 1.2, rng.uniform(0, 1, 6)
        state[6:] = rng.uniform(0, 1, 6)
        compiled, met = plant.advance(state, command, 1 / 300, np.ones(6))
        plain = advance(np, plant, state, command, 1 / 300)
        assert met == (plain != step(np, plant.dynamics, state, command, 1 / 300)).any()
        bounces += met
        np.testing.assert_allclose(compiled, plain, rtol=1e-12, atol=1e-13)
    assert 0 < bounces < 100


def test_thrust_scales_with_effectiveness(plant):
    state, command = np.concatenate([np.zeros(6), np.full(6, 0.5)]), np.full(6, 0.5)
    state[6], command[0] = 0.9, 0.9
    full, half = (plant.advance(state, command, 1e-3, np.full(6, s))[0] for s in (1.0, 0.5))
    np.testing.assert_allclose(half[3:6], full[3:6] / 2, rtol=1e-4)
    assert abs(full[4]) > 1e-4
    np.testing.assert_array_equal(half[6:], full[6:])


def newton_euler(_, z, command):
    """The craft with all effects, propeller by propeller, as in textbooks."""
    vehicle, parameters = MODEL.vehicle, MODEL.parameters
    mass, inertia, tau = vehicle.mass_kg, parameters.inertia, parameters.motor_time_constant
    velocity, yaw, spin, speed = z[3:5], z[2], z[5], z[6:]
    turn = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
    r = turn @ parameters.center_of_mass
    forces, twin = [], {}
    for first, second in vehicle.pair_indices:
        twin[first], twin[second] = second, first
    for i in range(6):
        arm, push = turn @ vehicle.positions[i], turn @ vehicle.directions[i]
        here = velocity + spin * np.array([-arm[1], arm[0]])
        a, b, c = parameters.thrust[i]
        force = a * speed[i] + b * speed[i] ** 2 + c * speed[i] ** 3
        forces.append((arm, push, force * (1 - EFFECTS.inflow_s_m * (here @ push))))
    total, moment = np.zeros(2), 0.0
    for i, (arm, push, force) in enumerate(forces):
        force = force / (1 + EFFECTS.pair_interaction_1_N * forces[twin[i]][2]) * push
        lever = arm - r
        total = total + force
        moment += lever[0] * force[1] - lever[1] * force[0]
    e = EFFECTS
    drag = -(e.drag_linear_1_s + e.drag_quadratic_1_m * np.hypot(*velocity)) * velocity
    center = total / mass + drag + GRAVITY * np.array(e.tilt_rad)
    rate = e.spin_drag_linear_1_s + e.spin_drag_quadratic_1_rad * abs(spin)
    spin_rate = moment / inertia - rate * spin
    # From the centre of mass back to the geometric one, at -r from it.
    acceleration = center - spin_rate * np.array([-r[1], r[0]]) + spin**2 * r
    return np.concatenate([velocity, [spin], acceleration, [spin_rate], (command - speed) / tau])


#: Spins fast enough never to stop: drag by |ω| ω has a kink there, which would spoil the order.
START = np.array([-0.3, 0.1, 0.5, 0.6, -0.3, 8.0, 0.1, 0.6, 0.3, 0.2, 0.8, 0.4])
COMMANDS = np.random.default_rng(8).uniform(0.03, 1, (4, 6))


@pytest.fixture(scope="module")
def exact():
    """Four commands of 100 ms each, by an adaptive method."""
    state = START
    for command in COMMANDS:
        found = solve_ivp(
            newton_euler, (0, 0.1), state, "DOP853", args=(command,), rtol=1e-12, atol=1e-13
        )
        state = found.y[:, -1]
    return state


def flown(plant, steps):
    state = START
    for command in COMMANDS:
        for _ in range(steps):
            state, _ = plant.advance(state, command, 0.1 / steps, np.ones(6))
    return state


def test_a_powered_flight_with_all_effects_matches_scipy(plant_with_effects, exact):
    assert np.abs(exact - START)[:6].min() > 0.03  # it moves
    np.testing.assert_allclose(flown(plant_with_effects, 200), exact, rtol=1e-9, atol=1e-9)


def test_the_longest_step_is_accurate_to_micrometres(plant_with_effects, exact):
    assert np.abs(flown(plant_with_effects, 24) - exact)[:3].max() < 1e-6


def test_the_flight_converges_at_fourth_order(plant_with_effects, exact):
    errors = [np.abs(flown(plant_with_effects, n) - exact)[:6].max() for n in (24, 48, 96)]
    orders = np.log2(np.divide(errors[:-1], errors[1:]))
    assert (orders > 3.7).all()
    assert (orders < 5).all()
