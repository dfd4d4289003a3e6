"""Simulated flights for a verdict: craft that a controller brings to rest, and others."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from airpuck.craft.vehicle import read_vehicle
from airpuck.deviation.effect_errors import EffectErrors, effect_errors
from airpuck.judgement.findings import next_step
from airpuck.judgement.rehearsal import GOAL, NEAR, as_seen, flown_margin, like, rehearse
from airpuck.model.model_file import Model, nominal_model, published_model
from airpuck.model.uncertainty import Cameras
from airpuck.twin.settings import default_twin_settings

from ..apparatus.models import scaled
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


def test_the_rehearsed_craft_has_the_strength_seen_in_the_recording(flight):
    weaker = scaled(MODEL, [0.8, 1.0, 1.0, 1.2, 1.0, 1.0])
    seen = as_seen(weaker, shown(weaker, flight))
    full = np.asarray(weaker.parameters.thrust).sum(axis=1)
    true = MODEL.dynamics.configuration * np.asarray(MODEL.parameters.thrust).sum(axis=1)
    np.testing.assert_allclose(seen.dynamics.configuration * full, true, rtol=0.02, atol=0.1)


@pytest.mark.parametrize("delay", [0.015, 0.03, 0.045])
def test_the_rehearsed_craft_has_the_delay_seen_in_the_recording(flight, delay):
    true = 0.03
    sent = flight.command_time - true
    recorded = replace(flight, command_time=sent, delay=true, delay_known=True)
    model = MODEL.with_delay(delay)
    assert as_seen(model, shown(model, recorded)).transport_delay == pytest.approx(true, abs=2e-4)


@pytest.mark.slow
def test_a_craft_stopped_by_a_rail_near_the_goal_has_not_settled():
    """A rail 5 mm before the goal stops it within the tolerance."""
    settings = default_twin_settings().without_on_board()
    length = 2 * (GOAL[0] - 0.005 + MODEL.vehicle.radius_m)
    table = settings.table.model_copy(update={"length_m": length})
    assert NEAR[0] > 0.01
    assert flown_margin(MODEL, MODEL, settings.model_copy(update={"table": table})) == 0


def test_the_simulated_cameras_match_the_recording():
    seen = Cameras(rate_hz=120, position_noise_m=1e-3, yaw_noise_rad=0.01, stamp_jitter_s=2.887e-4)
    cameras = like(seen, MODEL).motion_capture
    assert (cameras.position_noise_m, cameras.yaw_noise_rad, cameras.rate_hz) == (1e-3, 0.01, 120)
    assert cameras.stamp_step_s == pytest.approx(1e-3, rel=1e-3)


@pytest.mark.slow
def test_a_controller_settles_on_its_own_craft(flight):
    found = rehearse(MODEL, flight, shown(MODEL, flight))
    assert found.settles and found.remedy == "" and found.margin > 1.5


@pytest.mark.slow
@pytest.mark.parametrize("rate", [118.0, 122.0, 130.0])
def test_rounded_stamps_of_an_ordinary_camera_do_not_prevent_settling(rate):
    seen = Cameras(rate_hz=rate, position_noise_m=1.5e-4, yaw_noise_rad=1.8e-3, stamp_jitter_s=3e-4)
    slow = replace(MODEL.parameters, motor_time_constant=0.06, transport_delay=0.035)
    model = replace(MODEL, parameters=slow, cameras=seen)
    assert flown_margin(model, model, like(seen, model)) > 1.4


@pytest.mark.slow
@pytest.mark.parametrize("name", ["atmos", "freeflyer2"])
def test_a_slow_craft_with_pwm_settles_with_the_packaged_controller(name):
    model = nominal_model(read_vehicle(EXAMPLES / f"free_flyers/{name}.toml"))
    settings = default_twin_settings()
    room = {"length_m": 4.0, "width_m": 3.0}
    table = settings.table.model_copy(update=room)
    cameras = settings.motion_capture.model_copy(update={"rate_hz": 50.0})
    updates = {"table": table, "motion_capture": cameras}
    assert flown_margin(model, model, settings.model_copy(update=updates)) >= 1


@pytest.mark.parametrize(
    ("margins", "margin"), [([2.0], 2.0), ([1.3, 0.8, 1.2], 0.8), ([0.9], 0.9)]
)
def test_a_close_first_margin_is_repeated_and_the_smallest_counts(monkeypatch, margins, margin):
    monkeypatch.setattr("airpuck.judgement.rehearsal._margin", lambda *given: margins[given[-1]])
    assert flown_margin(MODEL, MODEL, default_twin_settings()) == margin


@pytest.mark.slow
def test_a_controller_does_not_settle_without_a_motor():
    dead = scaled(MODEL, [1.0, 1.0, 0.0, 1.0, 1.0, 1.0])
    assert flown_margin(dead, dead, default_twin_settings()) < 1


@pytest.mark.parametrize(
    ("margins", "told"),
    [
        ([1.5], ""),
        ([0.5, 2.0, 2.0], "settles with position_m = 0.00015, yaw_rad = 0.0018"),
        ([0.5, 2.0, 0.5], "Improve the cameras"),
        ([0.5, 0.5, 2.0], "not on the craft that the recording shows"),
        ([0.5, 0.5, 0.5], "motors are too weak or unequal"),
    ],
)
def test_further_flights_determine_the_remedy(flight, monkeypatch, margins, told):
    """Flights: as seen; with good cameras; with a calmer tuning, or of the model itself."""
    outcomes = iter(margins)
    monkeypatch.setattr("airpuck.judgement.rehearsal.flown_margin", lambda *_: next(outcomes))
    found = rehearse(MODEL, flight, shown(MODEL, flight))
    assert next(outcomes, "no more flights") == "no more flights"
    assert found.margin == margins[0]
    assert told in found.remedy and found.settles == (not told)


def test_a_craft_that_settles_by_luck_is_not_trusted(flight, monkeypatch):
    """Without a motor nothing turns it one way: it drifts away again."""
    monkeypatch.setattr("airpuck.judgement.rehearsal.flown_margin", lambda *_: 2.0)
    motor = np.array([1.0, 1.0, 1e-3, 1.0, 1.0, 1.0])
    said = rehearse(scaled(MODEL, motor), flight, shown(MODEL, flight)).remedy
    assert said.startswith("No controller can hold the modelled craft")
    motor[2] = 0.03
    assert rehearse(scaled(MODEL, motor), flight, shown(MODEL, flight)).settles
    said = rehearse(scaled(MODEL, motor * (motor > 0.1)), flight, shown(MODEL, flight)).remedy
    assert "another motion: back" in said


@pytest.mark.slow
def test_mpc_is_flown_on_request(flight):
    assert rehearse(MODEL, flight, shown(MODEL, flight), "mpc").settles


def test_a_model_without_a_stable_controller_is_not_trusted(flight):
    falling = replace(
        MODEL, parameters=replace(MODEL.parameters, thrust=np.tile([1.0, 0.0, -0.9], (6, 1)))
    )
    found = rehearse(falling, flight, shown(MODEL, flight))
    assert found.remedy.startswith("No controller can be designed") and not found.settles


def test_the_next_step_was_not_taken_yet():
    assert "Leave out `--model`" in next_step(replace(MODEL, name="M2+drag"))
    for name in ("M3", "M3+tilt"):  # as the library chooses it
        words = next_step(replace(MODEL, name=name))
        assert "`airpuck resid`" in words and "--model" not in words
