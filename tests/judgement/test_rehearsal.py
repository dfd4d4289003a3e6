"""Simulated flights for a verdict: craft that a controller brings to rest, and others."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from airpuck.craft.vehicle import read_vehicle
from airpuck.evaluation.effect_errors import EffectErrors, effect_errors
from airpuck.judgement.rehearsal import as_seen, failures, like, settles
from airpuck.model.model_file import Model, nominal_model, published_model
from airpuck.twin.settings import default_twin_settings

from ..apparatus.synthetic_flights import fly

EXAMPLES = Path(__file__).parents[2] / "examples"
MODEL = replace(published_model("M3"), frame="body", indexing="start")


@pytest.fixture(scope="module")
def flight():
    return fly(MODEL, 6.0, seed=3)


def shown(model: Model, flight) -> EffectErrors:
    found = effect_errors(model, flight)
    assert found is not None
    return found


def scaled(factor: np.ndarray) -> Model:
    thrust = factor[:, None] * np.asarray(MODEL.parameters.thrust)
    return replace(MODEL, parameters=replace(MODEL.parameters, thrust=thrust))


def test_the_craft_of_a_recording_has_the_strength_that_it_shows(flight):
    weaker = scaled(np.array([0.8, 1.0, 1.0, 1.2, 1.0, 1.0]))
    seen = as_seen(weaker, shown(weaker, flight))
    full = np.asarray(weaker.parameters.thrust).sum(axis=1)
    true = MODEL.dynamics.configuration * np.asarray(MODEL.parameters.thrust).sum(axis=1)
    np.testing.assert_allclose(seen.dynamics.configuration * full, true, rtol=0.02, atol=0.1)


def test_the_noise_of_the_cameras_is_that_of_the_recording(flight):
    noise = np.array([1e-3, 1e-3, 0.01])
    state = flight.state.copy()
    state[:, :3] += np.random.default_rng(0).normal(size=(len(flight), 3)) * noise
    cameras = like(flight, shown(MODEL, replace(flight, state=state)), MODEL).motion_capture
    assert cameras.position_noise_m == pytest.approx(noise[0], rel=0.1)
    assert cameras.yaw_noise_rad == pytest.approx(noise[2], rel=0.1)
    assert cameras.rate_hz == pytest.approx(240, rel=0.01)
    without = like(flight, shown(MODEL, flight), MODEL).motion_capture
    assert without.position_noise_m < 1e-5 and without.yaw_noise_rad < 1e-4


@pytest.mark.slow
def test_a_controller_settles_on_its_own_craft(flight):
    assert failures(MODEL, flight, shown(MODEL, flight)) == []


@pytest.mark.slow
@pytest.mark.parametrize("name", ["atmos", "freeflyer2"])
def test_a_slow_craft_with_its_own_pwm_settles_with_the_packaged_controller(name):
    model = nominal_model(read_vehicle(EXAMPLES / f"free_flyers/{name}.toml"))
    settings = default_twin_settings()
    room = {"length_m": 4.0, "width_m": 3.0}
    table = settings.table.model_copy(update=room)
    cameras = settings.motion_capture.model_copy(update={"rate_hz": 50.0})
    updates = {"table": table, "motion_capture": cameras}
    assert settles(model, model, settings.model_copy(update=updates))


@pytest.mark.slow
def test_a_controller_does_not_settle_without_a_motor():
    dead = scaled(np.array([1.0, 1.0, 0.0, 1.0, 1.0, 1.0]))
    assert not settles(dead, dead, default_twin_settings())


@pytest.mark.parametrize(
    ("settled", "told"),
    [
        ([True], []),
        ([False, True], ["noise of this recording", "[estimation] position_m"]),
        ([False, False, True], ["not on the craft that the recording shows", "--model auto"]),
        ([False, False, False], ["the modelled craft", "motors are too weak or unequal"]),
    ],
)
def test_what_is_said_names_the_cause(flight, monkeypatch, settled, told):
    """Flights: as seen; with good cameras; of the model itself."""
    outcomes = iter(settled)
    monkeypatch.setattr("airpuck.judgement.rehearsal.settles", lambda *_: next(outcomes))
    said = failures(MODEL, flight, shown(MODEL, flight))
    assert next(outcomes, "no more flights") == "no more flights"
    assert len(said) == bool(told)
    assert all(words in said[0] for words in told)


def test_a_craft_that_settles_only_by_luck_is_not_trusted(flight, monkeypatch):
    """Without a motor nothing turns it one way: it drifts away again."""
    monkeypatch.setattr("airpuck.judgement.rehearsal.settles", lambda *_: True)
    motor = np.array([1.0, 1.0, 1e-3, 1.0, 1.0, 1.0])
    [said] = failures(scaled(motor), flight, shown(MODEL, flight))
    assert said.startswith("No controller can hold the modelled craft")
    motor[2] = 0.03
    assert failures(scaled(motor), flight, shown(MODEL, flight)) == []
    [said] = failures(scaled(motor * (motor > 0.1)), flight, shown(MODEL, flight))
    assert "another motion: back" in said


def test_no_controller_is_no_trust(flight):
    falling = replace(
        MODEL, parameters=replace(MODEL.parameters, thrust=np.tile([1.0, 0.0, -0.9], (6, 1)))
    )
    [said] = failures(falling, flight, shown(MODEL, flight))
    assert said.startswith("No controller can be designed")
