"""`Model.derivative`, `simulate` and `sample`, each under NumPy, JAX and CasADi."""

from dataclasses import replace

import casadi
import control
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import airpuck
from airpuck.craft.vehicle import default_vehicle
from airpuck.model.model_file import published_model
from airpuck.model.simulation import linearize, trim
from airpuck.physics.rigid_body import acceleration, derivative, rollout

from ..apparatus.beliefs import believed
from ..apparatus.refusals import rejected

M3, NAN = published_model("M3"), np.nan
EFFECTS = replace(
    M3,
    parameters=replace(
        M3.parameters,
        drag=np.array([0.1, 0.2, 0.3, 0.01]),
        inflow=0.1,
        pair_interaction=4.0,
        voltage_sag=0.2,
        tilt=np.array([1e-3, -2e-3]),
        idle_lag=0.8,
    ),
)
MODELS = pytest.mark.parametrize("model", [M3, EFFECTS, published_model("M4")])


def state_and_command(seed: int = 0):
    random = np.random.default_rng(seed)
    return random.normal(size=12) * 0.3 + np.r_[np.zeros(6), np.full(6, 0.5)], random.uniform(
        0, 1, 6
    )


@MODELS
def test_the_derivative_agrees_under_numpy_jax_and_casadi(model):
    state, command = state_and_command()
    with jax.enable_x64(True):
        traced = jax.jit(model.derivative)(jnp.array(state), jnp.array(command))
    z, u = casadi.SX.sym("z", 12), casadi.MX.sym("u", 6)
    symbolic = casadi.Function("f", [z], [model.derivative(z, casadi.SX(command))])(state)
    in_the_command = casadi.Function("f", [u], [model.derivative(casadi.MX(state), u)])(command)
    expected = model.derivative(state, command)
    np.testing.assert_allclose(traced, expected, atol=1e-13)
    np.testing.assert_allclose(symbolic.full()[:, 0], expected, atol=1e-13)
    np.testing.assert_allclose(in_the_command.full()[:, 0], expected, atol=1e-13)


def test_a_craft_at_rest_with_idle_motors_stays():
    assert not M3.derivative(np.zeros(12), np.zeros(6)).any()


@MODELS
def test_a_simulation_solves_the_differential_equation(model):
    state, command = state_and_command(1)
    # Near standstill motors may be slower.
    state[6:] = np.linspace(0.0, 0.2, 6)
    simulated = model.simulate(state, np.tile(command, (800, 1)), 0.25e-3)
    reference = solve_ivp(
        lambda _, z: model.derivative(z, command), (0, 0.2), state, rtol=1e-10, atol=1e-12
    )
    # If the lag depends on the speed, the motors' steps are of second order.
    atol = 1e-9 if model.dynamics.idle_lag is None else 1e-6
    np.testing.assert_allclose(simulated[-1], reference.y[:, -1], rtol=0, atol=atol)


def test_simulations_agree_under_numpy_jax_and_casadi_and_for_a_batch():
    state, _ = state_and_command(2)
    commands = np.random.default_rng(3).uniform(0, 1, (5, 6))
    expected = M3.simulate(state, commands, 0.01)
    with jax.enable_x64(True):
        batch = jax.vmap(lambda z: M3.simulate(z, jnp.array(commands), 0.01))(
            jnp.array([state, 2 * state])
        )
    u = casadi.SX.sym("u", 5, 6)
    symbolic = casadi.Function("f", [u], [M3.simulate(casadi.SX(state), u)])(commands)
    both = M3.simulate(np.stack([state, 2 * state], axis=1), np.stack([commands] * 2, axis=2), 0.01)
    np.testing.assert_allclose(batch[0], expected, atol=1e-12)
    np.testing.assert_allclose(batch[1], both[..., 1], atol=1e-12)
    np.testing.assert_allclose(both[..., 0], expected, atol=1e-12)
    np.testing.assert_allclose(symbolic.full(), expected, atol=1e-12)


@pytest.mark.slow
def test_simulations_are_differentiable_by_commands_and_parameters():
    state, command = state_and_command(4)
    commands = np.tile(command, (10, 1))

    def final(commands, vector):
        moved = replace(M3, parameters=M3.parameters.with_vector(vector))
        return moved.simulate(state, commands, 0.01)[-1, 2]

    vector = M3.parameters.to_vector()
    with jax.enable_x64(True):
        slopes = jax.grad(final, argnums=(0, 1))(jnp.array(commands), jnp.array(vector))
    for argument, slope in enumerate(slopes):
        for entry in [(0, 3), (9, 1)] if argument == 0 else [(0,), (18,), (19,)]:
            arguments = [commands.copy(), vector.copy()]
            ends = []
            step = 1e-6 * max(abs(arguments[argument][entry]), 1e-6)
            for sign in (1, -1):
                moved = [a.copy() for a in arguments]
                moved[argument][entry] += sign * step
                ends.append(final(*moved))
            assert slope[entry] == pytest.approx((ends[0] - ends[1]) / (2 * step), rel=1e-4)


def test_without_lag_motors_are_not_part_of_the_state():
    model = replace(M3, parameters=replace(M3.parameters, motor_time_constant=0.0))
    state, command = state_and_command(5)
    rates = model.derivative(state[:6], command)
    same = M3.derivative(np.r_[state[:6], command], command)
    np.testing.assert_allclose(rates, same[:6], atol=1e-14)


def test_omitted_motor_speeds_start_at_the_first_command():
    state, command = state_and_command(6)
    commands = np.tile(command, (3, 1))
    np.testing.assert_array_equal(
        M3.simulate(state[:6], commands), M3.simulate(np.r_[state[:6], command], commands)
    )


@pytest.mark.parametrize(
    ("call", "field"),
    [
        (lambda: M3.derivative(np.zeros(11), np.zeros(6)), "state"),
        (lambda: M3.derivative(np.zeros(12), np.zeros(4)), "command"),
        (lambda: M3.simulate(np.zeros(12), np.zeros((3, 4))), "commands"),
        (lambda: M3.simulate(np.zeros(11), np.zeros((3, 6))), "state"),
        (lambda: M3.sample(3), "model M3"),
        (lambda: M3.to_statespace(command=np.zeros(4)), "command"),
    ],
)
def test_wrong_shapes_are_rejected(call, field):
    with rejected(field=field):
        call()


def simulated(period):
    return M3.simulate(np.zeros(12), np.zeros((2, 6)), period)


@pytest.mark.parametrize(
    ("field", "value", "used"),
    [
        *(("period", value, simulated) for value in (0, -0.01, NAN, np.array([0.01, 0.0]))),
        *(("period", value, None) for value in (0.0, -1.0, NAN, np.inf)),
        *(("yaw", value, None) for value in (NAN, np.inf)),
        *(("command", np.full(6, value), None) for value in (NAN, -0.1, 1.1)),
    ],
)
def test_a_number_out_of_range_is_rejected(field, value, used):
    with rejected(field=field):
        (used or M3.to_statespace)(**{field: value})


def uncertain(errors: dict[int, float]) -> airpuck.Model:
    """M3 with independent standard errors of some entries."""
    spread = np.zeros(len(M3.free))
    spread[list(errors)] = list(errors.values())
    return believed(M3, spread)


@pytest.mark.slow
def test_samples_have_the_covariance_of_the_estimate():
    entries = {18: 3e-6, 19: 4e-4}  # inertia and lag: some percent of each
    model = uncertain(entries)
    drawn = np.array([m.parameters.to_vector() for m in model.sample(1000, key=1)])
    np.testing.assert_allclose(drawn.std(axis=0)[[18, 19]], list(entries.values()), rtol=0.1)
    untouched = np.delete(np.arange(drawn.shape[1]), [18, 19])
    assert (drawn[:, untouched] == model.parameters.to_vector()[untouched]).all()


@pytest.mark.slow
def test_samples_depend_on_the_key_and_are_valid_craft():
    model = uncertain({0: 0.2, 18: 2e-4})  # wide enough to leave the bounds
    first = [m.parameters.to_vector() for m in model.sample(20, key=jax.random.key(3))]
    again = [m.parameters.to_vector() for m in model.sample(20, key=jax.random.key(3))]
    np.testing.assert_array_equal(first, again)
    lower, upper = model.parameters.bounds()
    assert (np.array(first) >= lower).all() and (np.array(first) <= upper).all()
    airpuck.TrackingController(model.sample(1, key=2)[0], airpuck.SetPoint(0, 0, 0))


@pytest.mark.parametrize("name", ["M0", "M3", "M4"])
def test_a_trimmed_craft_stays_at_rest(name):
    dynamics = published_model(name).dynamics
    command = trim(dynamics)
    assert ((command > 0) & (command < 1)).all()
    np.testing.assert_allclose(acceleration(np, dynamics, np.zeros(4), command), 0, atol=1e-9)


def test_a_craft_with_effects_on_a_tilted_table_can_be_trimmed():
    truth = published_model("M3").parameters
    effects = {"inflow": 0.2, "pair_interaction": 5.0, "voltage_sag": 0.1}
    parameters = replace(truth, **effects, tilt=np.array([0.004, -0.002]))
    dynamics = parameters.dynamics(np, default_vehicle())
    command = trim(dynamics, yaw=0.7)
    assert ((command > 0) & (command < 1)).all()
    motion = np.array([0.7, 0, 0, 0])
    np.testing.assert_allclose(acceleration(np, dynamics, motion, command), 0, atol=1e-9)


#: Motors of which some answer later than the others.
LATER = np.ones((6, 1)), np.linspace(0.0, 0.02, 6)[:, None]


@pytest.mark.parametrize("own_lag", [None, LATER])
def test_the_matrices_match_central_differences(own_lag):
    dynamics = replace(published_model("M3").dynamics, own_lag=own_lag)
    command = trim(dynamics)
    a, b = linearize(dynamics, 0.7, command)
    at = np.concatenate([[0, 0, 0.7, 0, 0, 0], command])
    h = 1e-6
    for j, direction in enumerate(np.eye(12)):
        ahead = derivative(np, dynamics, at + h * direction, command)
        behind = derivative(np, dynamics, at - h * direction, command)
        np.testing.assert_allclose(a[:, j], (ahead - behind) / (2 * h), atol=1e-7)
    np.testing.assert_allclose(b[6:], np.eye(6) / np.broadcast_to(np.ravel(dynamics.lag), 6))
    np.testing.assert_array_equal(b[:6], 0)


def test_small_command_steps_match_the_linear_model():
    model = published_model("M4")
    system = model.to_statespace(yaw=0.4)
    command = trim(model.dynamics)
    step = np.array([1.0, -0.5, 0.3, 0.8, -1.0, 0.2])
    steps, h = 48, 1 / 240
    time = np.arange(steps + 1) * h
    start = np.concatenate([[0, 0, 0.4, 0, 0, 0], command])

    def error(size):
        response = control.forced_response(
            system, time, np.tile(size * step, (steps + 1, 1)).T
        ).outputs
        held = np.tile(command + size * step, (steps, 1))
        flown = rollout(np, model.dynamics, start, held, np.full(steps, h))
        return np.abs(flown[:, :3] - start[:3] - np.asarray(response)[:, 1:].T).max()

    # The remainder of a linearisation is of second order.
    assert error(1e-3) < 1e-5
    assert error(1e-3) / error(1e-4) == pytest.approx(100, rel=0.05)


def test_without_motor_lag_the_linear_model_omits_the_motors():
    system = published_model("M0").to_statespace()
    assert (system.nstates, system.ninputs, system.noutputs) == (6, 6, 3)
    assert published_model("M3").to_statespace().nstates == 12


def test_the_discrete_model_is_the_continuous_one_with_held_inputs():
    model = published_model("M3")
    discrete, continuous = model.to_statespace(period=0.01), model.to_statespace()
    assert discrete.dt == 0.01
    assert discrete.input_labels == list(model.vehicle.propeller_names)
    by_control = control.c2d(continuous, 0.01, "zoh")
    np.testing.assert_allclose(discrete.A, by_control.A, atol=1e-14)
    np.testing.assert_allclose(discrete.B, by_control.B, atol=1e-14)
