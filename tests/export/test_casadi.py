"""CasADi functions: equal to NumPy's dynamics, with JAX's derivatives, also after saving."""

import json
import runpy
import sys

import casadi
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from airpuck import InputError, export
from airpuck.export.casadi import functions
from tests.apparatus.export_crafts import (
    ALL_EFFECTS,
    DISH,
    EXAMPLES,
    FOUR,
    HELD,
    PAPER,
    random_states,
    with_vector,
)

CRAFT = {**HELD, "dish": DISH}


def numbers(value):
    full = value.full()
    return full[:, 0] if full.shape[1] == 1 else full


@pytest.mark.parametrize("model", CRAFT.values(), ids=CRAFT)
def test_casadi_functions_equal_the_dynamics_of_the_package(model):
    made = functions(model)
    for state, command in zip(*random_states(model, 50), strict=True):
        rate, scale = model.derivative(state, command), 1 + np.abs(state).max()
        np.testing.assert_allclose(numbers(made["continuous"](state, command)), rate, rtol=1e-12)
        after = model.simulate(state, command[None], 0.01)[0, : len(state)]
        np.testing.assert_allclose(
            numbers(made["discrete"](state, command, 0.01)), after, rtol=0, atol=1e-12 * scale
        )


@pytest.mark.parametrize("model", [PAPER["M3"], ALL_EFFECTS], ids=["M3", "all effects"])
def test_derivatives_of_casadi_functions_agree_with_jax(model):
    z, u = casadi.SX.sym("z", 12), casadi.SX.sym("u", 6)
    rate = functions(model)["continuous"](z, u)
    slopes = casadi.Function("slopes", [z, u], [casadi.jacobian(rate, z), casadi.jacobian(rate, u)])
    with jax.enable_x64(True):
        expected = jax.jit(jax.jacobian(model.derivative, argnums=(0, 1)))
        for state, command in zip(*random_states(model, 20), strict=True):
            for found, by_jax in zip(
                slopes(state, command), expected(jnp.array(state), jnp.array(command)), strict=True
            ):
                scale = 1 + np.abs(by_jax).max()
                np.testing.assert_allclose(found.full(), by_jax, rtol=0, atol=1e-12 * scale)


@pytest.mark.parametrize("model", CRAFT.values(), ids=CRAFT)
def test_free_parameters_become_an_argument(model):
    direct = model.parameters.configuration_matrix is not None
    fixed = {"transport_delay"} | ({"inertia", "angle_offset"} if direct else set())
    if not model.dynamics.motor_time_constant > 0:
        fixed.add("motor_time_constant")
    free = [q.name for q in model.parameters.quantities if q.name not in fixed]
    made, mask = functions(model, free), model.parameters.mask(frozenset(free))
    vector, random = model.parameters.to_vector(), np.random.default_rng(1)
    for state, command in zip(*random_states(model, 5), strict=True):
        moved = np.where(mask, vector * random.uniform(0.9, 1.1, len(vector)), vector)
        other = with_vector(model, moved)
        np.testing.assert_allclose(
            numbers(made["continuous"](state, command, moved[mask])),
            other.derivative(state, command),
            rtol=1e-11,
            atol=1e-12,
        )
        np.testing.assert_allclose(
            numbers(made["discrete"](state, command, 0.02, moved[mask])),
            other.simulate(state, command[None], 0.02)[0, : len(state)],
            rtol=1e-11,
            atol=1e-12,
        )


def test_a_parameter_without_effect_is_rejected():
    for model, name in ((PAPER["M3"], "transport_delay"), (PAPER["M0"], "motor_time_constant")):
        with pytest.raises(InputError, match=f"no parameter '{name}'; choose from thrust"):
            functions(model, [name])


def test_saved_functions_name_their_arguments(tmp_path):
    model = PAPER["M3"]
    written = export.write(model, "casadi", tmp_path)
    content = json.loads((tmp_path / "arguments.json").read_text("utf-8"))
    loaded = {
        name: casadi.Function.load(str(tmp_path / name))
        for name in written.files
        if name.endswith(".casadi")
    }
    state, command = (rows[0] for rows in random_states(model, 1))
    free = loaded["discrete_free.casadi"]
    assert free.name_in() == ["state", "command", "period", "theta"]
    assert list(content["state"])[:3] == ["x", "y", "yaw"]
    assert len(content["state"]) == free.size1_in("state")
    assert content["theta"]["center_of_mass x"] == model.parameters.center_of_mass[0]
    after = loaded["discrete.casadi"](state=state, command=command, period=0.01)["next_state"]
    again = free(state, command, 0.01, list(content["theta"].values()))
    np.testing.assert_allclose(numbers(again), numbers(after), rtol=0, atol=1e-14)
    np.testing.assert_allclose(
        numbers(after), model.simulate(state, command[None], 0.01)[0], rtol=0, atol=1e-12
    )


def test_without_learned_parameters_there_is_no_free_function(tmp_path):
    written = export.write(FOUR, "casadi", tmp_path)
    assert written.files == ("arguments.json", "continuous.casadi", "discrete.casadi")


def test_an_optimal_control_problem_takes_ten_lines(tmp_path, monkeypatch, capsys):
    export.write(PAPER["M3"], "casadi", tmp_path)
    monkeypatch.setattr(sys, "argv", ["least_effort.py", str(tmp_path)])
    found = runpy.run_path(str(EXAMPLES / "optimal_control/least_effort.py"))
    commands = found["solved"].value(found["command"])
    assert ((commands > 0.03 - 1e-6) & (commands < 1 + 1e-6)).all()
    flown = PAPER["M3"].simulate(np.r_[np.zeros(6), np.full(6, 0.03)], commands.T, 0.025)
    np.testing.assert_allclose(flown[-1, :6], [0, 0.5, np.pi / 2, 0, 0, 0], atol=1e-6)
    assert "mean squared command: 0.05" in capsys.readouterr().out
