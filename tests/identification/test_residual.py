"""The optional neural term: its physics, its file, its training."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, cast

import casadi
import jax.numpy as jnp
import numpy as np
import pytest

from airpuck.boundary.errors import InputError
from airpuck.evaluation.evaluate import evaluate
from airpuck.export import write
from airpuck.identification.fit import identify
from airpuck.identification.fit_result import Fit
from airpuck.identification.objective import Quadratic
from airpuck.identification.residual import first_weights, with_residual
from airpuck.model.model_file import Model, published_model, read_model
from airpuck.model.rungs import named_rung
from airpuck.physics.effects import BodyMotion, Envelope, Residual
from airpuck.physics.rigid_body import acceleration
from airpuck.preprocessing.pipeline import preprocess
from airpuck.twin.batch import TwinBatch
from airpuck.twin.experiments import excite
from airpuck.twin.settings import Effects, default_twin_settings
from airpuck.twin.twin import Twin

from ..apparatus.beliefs import believed

BASE = replace(published_model("M3"), frame="body")


def neural(scale: float = 0.5, seed: int = 0) -> Model:
    """Return the published M3 with a network of random weights."""
    weights = first_weights(BASE.vehicle)
    weights = np.random.default_rng(seed).normal(0, scale, len(weights))
    parameters = replace(BASE.parameters, residual=weights)
    free = parameters.mask(named_rung("M3").free | {"residual"})
    return replace(BASE, name="M3+residual", parameters=parameters, free=free)


def test_the_network_is_added_to_the_accelerations_of_the_physics():
    model, rng = neural(), np.random.default_rng(1)
    motion, speed = rng.normal(size=4), rng.uniform(0, 1, 6)
    found = np.array(acceleration(np, model.dynamics, motion, speed))
    plain = np.array(acceleration(np, BASE.dynamics, motion, speed))
    # The same by hand, with the documented order of the weights.
    yaw, vx, vy, spin = motion
    cos, sin = np.cos(yaw), np.sin(yaw)
    force = np.array(BASE.dynamics.thrust) @ [0, 0, 0] + sum(
        np.array(BASE.dynamics.thrust)[:, p] * speed ** (p + 1) for p in range(3)
    )
    body = np.array([cos * vx + sin * vy, cos * vy - sin * vx])
    inputs = np.concatenate([body / 0.5, [spin / 3.0], force / 0.3, [1.0]])
    weights = model.parameters.residual
    outputs = weights[60:].reshape(3, 6) @ np.tanh(weights[:60].reshape(6, 10) @ inputs)
    forward, left, angular = outputs * [1.0, 1.0, 10.0]
    rx, ry = BASE.parameters.center_of_mass
    rx, ry = cos * rx - sin * ry, sin * rx + cos * ry
    added = [
        cos * forward - sin * left + ry * angular,
        sin * forward + cos * left - rx * angular,
        angular,
    ]
    np.testing.assert_allclose(found - plain, added, rtol=1e-9, atol=1e-12)


def test_numpy_jax_and_casadi_agree_on_the_network():
    model, rng = neural(), np.random.default_rng(2)
    state, command = np.concatenate([rng.normal(size=6), rng.uniform(0, 1, 6)]), np.full(6, 0.4)
    expected = model.derivative(state, command)
    np.testing.assert_allclose(model.derivative(jnp.array(state), command), expected, rtol=1e-5)
    symbols = casadi.SX.sym("z", 12), casadi.SX.sym("u", 6)
    function = casadi.Function("f", symbols, [model.derivative(*symbols)])
    np.testing.assert_allclose(np.ravel(function(state, command)), expected, rtol=1e-12)


def test_the_network_stays_within_its_stated_bound():
    effect = next(e for e in neural(2.0).dynamics.effects if isinstance(e, Residual))
    rng, (linear, angular) = np.random.default_rng(3), (0.0, 0.0)
    motion = rng.normal(0, 2, (5, 4000))
    felt = BodyMotion(*motion, thrust=rng.uniform(0, 1, (6, 4000)))
    forward, left, spin = effect.acceleration(np, felt)
    linear, angular = effect.acceleration_bound(Envelope(1.0, 1.0))
    assert np.hypot(forward, left).max() <= linear
    assert np.abs(spin).max() <= angular
    assert np.abs(spin).max() > 0.3 * angular


def test_a_model_file_keeps_the_network_exactly(tmp_path):
    model = neural()
    model.save(tmp_path / "model.toml")
    read = read_model(tmp_path / "model.toml")
    np.testing.assert_array_equal(read.parameters.residual, model.parameters.residual)
    np.testing.assert_array_equal(read.free, model.free)
    text = (tmp_path / "model.toml").read_text()
    first = str(model.parameters.residual[0])
    shorter = text.replace(f"{first}, ", "", 1)
    assert shorter != text
    (tmp_path / "short.toml").write_text(shorter)
    with pytest.raises(InputError, match="must be 78 numbers"):
        read_model(tmp_path / "short.toml")


@pytest.mark.parametrize("kind", ["c", "fmu", "matlab", "mjcf", "holohover"])
def test_formats_that_cannot_represent_the_network_reject_it_by_name(tmp_path, kind):
    with pytest.raises(InputError, match="Residual"):
        write(neural(), kind, tmp_path / "out")


def test_the_twin_and_a_batch_fly_the_network_equally():
    model, command = neural(), np.full(6, 0.3) + 0.1 * np.arange(6) / 6
    settings = default_twin_settings()
    twin = Twin(model, settings, seed=1)
    batch = TwinBatch([model, neural(seed=5)], 2, 1.0, settings=settings)
    batch.reset(np.arange(2), np.zeros((2, 3)), seeds=(1, 1))
    for k in range(30):
        twin.wait_until(k * 0.01)
        twin.send(command)
        batch.step(np.tile(command, (2, 1)))
    twin.wait_until(0.3)
    np.testing.assert_allclose(batch.state[:, 0], twin.state, rtol=1e-6, atol=1e-9)
    assert np.abs(batch.state[:6, 1] - twin.state[:6]).max() > 1e-4


def test_the_physics_of_a_residual_rung_is_the_rung_without_it():
    rung = named_rung("M3+drag+residual").physics
    assert (rung.name, rung.effects) == ("M3+drag", ("drag",))
    assert rung.initial(BASE.vehicle).residual is None


def test_a_user_effect_may_share_the_networks_name(tmp_path):
    code = tmp_path / "residual_drag.py"
    code.write_text(
        "import dataclasses\nimport airpuck\n\n"
        "@dataclasses.dataclass(frozen=True, eq=False)\n"
        "class CrossDrag(airpuck.Effect):\n    value: float = 0.0\n"
    )
    name = f"M3+{code}:CrossDrag"
    assert named_rung(f"{name}+residual").physics.name == name


def flown(seed: int, effects: Effects | None = None):
    """Return an excitation of the published M3 on the twin, with other effects or not."""
    settings = default_twin_settings().without_on_board()
    if effects is not None:
        settings = settings.model_copy(update={"effects": effects})
    recording = excite(BASE, 16.0, seed, settings=settings)
    return preprocess(recording, BASE.vehicle)


class LinearInWeights:
    """A loss of 16 blocks of time whose errors are linear in the network's weights."""

    def __init__(self, mine, noise: float) -> None:
        rng = np.random.default_rng(0)
        self.mine, self.truth = mine, rng.normal(size=mine.sum())
        self.rows = rng.normal(size=(16, 40, mine.sum()))
        self.seen = self.rows @ self.truth + rng.normal(0, noise, (16, 40))

    def errors(self, weights):
        return self.rows @ weights - self.seen

    def quadratic(self, parameters) -> Quadratic:
        errors = self.errors(parameters.to_vector()[self.mine])
        scores = np.zeros((16, len(self.mine)))
        scores[:, self.mine] = 2 * np.einsum("grw,gr->gw", self.rows, errors)
        informations = np.zeros((16, len(self.mine), len(self.mine)))
        informations[:, *np.ix_(self.mine, self.mine)] = (
            2 * np.swapaxes(self.rows, 1, 2) @ self.rows
        )
        return Quadratic((errors**2).sum(axis=1), scores, informations)


def test_training_solves_the_least_squares_of_three_blocks_in_four():
    mine = neural().parameters.mask(frozenset({"residual"}))
    loss = LinearInWeights(mine, 2.0)
    model = believed(BASE, 0.01 * np.ones(len(BASE.free)))
    fit = Fit(model, 1.0, (), True, "", 1, 0.0, (), objective=cast(Any, loss))
    found = with_residual(fit).model
    held = np.arange(16) % 4 == 3
    rows, seen = loss.rows[~held].reshape(-1, mine.sum()), loss.seen[~held].ravel()
    expected = np.linalg.lstsq(rows, seen, rcond=None)[0]
    # It stops before the last step; noise alone moves a weight by 0.09.
    np.testing.assert_allclose(found.parameters.residual, expected, atol=0.05)
    before, after = (
        (loss.errors(weights)[held] ** 2).sum()
        for weights in (first_weights(BASE.vehicle), found.parameters.residual)
    )
    assert found.known is not None
    assert found.known.notes[-1].endswith(f"not trained on by {100 * (1 - after / before):.0f} %")


@pytest.mark.slow
def test_a_trained_network_improves_predictions_if_physics_is_missing():
    strange = Effects.model_validate({"spin_drag_quadratic_1_rad": 0.15, "inflow_s_m": 0.25})
    train, other = flown(0, strange), flown(1, strange)
    plain = identify(train, "M3")
    fit = with_residual(plain)
    assert fit.model.name == "M3+residual"
    # The physics is frozen.
    physics = ~fit.model.parameters.mask(frozenset({"residual"}))
    np.testing.assert_array_equal(
        fit.model.parameters.to_vector()[physics], plain.model.parameters.to_vector()
    )
    before, after = (evaluate(one.model, other).rmse for one in (plain, fit))
    assert after[2] < 0.8 * before[2]
    assert (after[:2] < 1.02 * before[:2]).all()
    assert fit.model.known is not None
    assert any("neural" in note for note in fit.model.known.notes)
