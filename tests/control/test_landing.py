"""A craft whose motors do not suffice lands: by hand, against linear programs, and on the twin."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest

from airpuck import SetPoint, SetPoints, Step, TrackingController, Twin, TwinSettings, Vehicle
from airpuck.control.authority import LEAST_EFFORT, control_authority, weakest_effort
from airpuck.control.landing import Landing
from airpuck.control.tuning import default_tuning
from airpuck.estimate.estimator import ActuationEstimate, Estimate
from airpuck.flight.loop import fly
from airpuck.model.model_file import nominal_model, published_model
from airpuck.twin.settings import Motors, Weakness

from ..apparatus.models import scaled

CORNERS = ((0.05, 0.05, 315), (0.05, -0.05, 45), (-0.05, 0.05, 225), (-0.05, -0.05, 135))
TWICE = nominal_model(
    Vehicle.model_validate(
        {
            "name": "craft with two propellers at each corner",
            "mass_kg": 0.2,
            "radius_m": 0.08,
            "command_min": 0.0,
            "propellers": [
                {"name": f"p{k}", "position_m": (x, y), "direction_deg": angle}
                for k, (x, y, angle) in enumerate(CORNERS * 2)
            ],
            "nominal": {"thrust_N": (0.0, 1.0), "inertia_kg_m2": 4e-4},
        }
    )
)
IDLE = np.zeros(8)
REFERENCE = SetPoint(0.5, 0.0, 0.0)


def test_a_craft_keeps_flying_while_its_motors_can_push_and_turn_everywhere():
    for dead in (each for count in range(4) for each in combinations(range(8), count)):
        running = ~np.isin(np.arange(8), dead)
        steers = weakest_effort(TWICE, running) >= LEAST_EFFORT
        assert steers == (not control_authority(scaled(TWICE, running)).missing), dead


def step(*dead, speed=0.5, deviation=0.02, turning=0.0):
    """A step of a law on a craft that moves along x, with the motors that do not run."""
    effectiveness = np.where(np.isin(np.arange(8), dead), 0.0, 1.0)
    found = ActuationEstimate(effectiveness, np.full(8, deviation))
    state = np.array([0.1, 0.2, 0.3, speed, 0.0, 0.4])
    estimate = Estimate(0.0, state, np.full(8, turning), np.zeros(3), found)
    return Step(np.full(8, 0.5), "nearest", estimate=estimate)


UNKNOWN = replace(step(), estimate=replace(step().estimate, actuation=None))


@pytest.mark.parametrize(
    "sent", [step(), step(0), step(0, 4, deviation=0.2), step(*range(8)), UNKNOWN, Step(IDLE)]
)
def test_a_law_is_obeyed_if_it_can_steer_or_all_motors_idle(sent):
    landing = Landing(TWICE)
    assert landing.land(1.0, sent) is sent
    assert landing.reference(REFERENCE) is REFERENCE
    assert not landing.retries(100.0)


def test_a_craft_without_a_corner_brakes_and_then_rests():
    landing, moving = Landing(TWICE), step(0, 4)
    assert landing.land(1.0, moving) is moving
    target = landing.reference(REFERENCE).at(1.0, 0.0)
    np.testing.assert_array_equal(target.state, [0.1, 0.2, 0.3, 0, 0, 0.4])
    landed = landing.land(1.5, step(0, 4, speed=0.02))
    assert (landed.status, landed.flies) == ("cannot steer", False)
    np.testing.assert_array_equal(landed.command, IDLE)
    # A craft that coasts on does not run its motors again.
    assert not landing.land(1.6, step(0, 4)).flies


def test_braking_ends_after_three_seconds():
    landing = Landing(TWICE)
    flying = [time for time in np.arange(0, 5, 0.1) if landing.land(time, step(0, 4)).flies]
    assert flying[-1] == pytest.approx(3.0)


def test_landing_ends_when_the_remaining_motor_thrust_stops_the_craft():
    # Motors 1 and 5 push with 0.3 N each, along 45° + 0.3 rad, and fade with the lag.
    curves = np.tile([0.0, 1.0], (8, 1))
    lagging = replace(
        TWICE, parameters=replace(TWICE.parameters, thrust=curves, motor_time_constant=0.1)
    )
    running, speed = np.isin(np.arange(8), [1, 5]), np.sqrt(0.3)
    # The thrust falls with the square of the speed: half of the lag at its first value.
    gained = 2 * 0.3 / 0.2 * 0.1 / 2 * np.array([np.cos(np.pi / 4 + 0.3), np.sin(np.pi / 4 + 0.3)])
    for off, lands in ((0.04, True), (0.06, False)):
        landing, moving = Landing(lagging), step(0, 4)
        landing.land(1.0, moving)
        state = moving.estimate.state.copy()
        state[3:5] = off * gained / np.linalg.norm(gained) - gained
        estimate = replace(moving.estimate, state=state, motor_speed=running * speed)
        assert landing.land(1.1, replace(moving, estimate=estimate)).flies != lands


def test_a_landing_ends_if_the_clock_is_set_back_or_the_estimate_is_lost():
    landing = Landing(TWICE)
    landing.land(100.0, step(0, 4, speed=0.0))
    assert landing.land(1.0, step()).flies
    lost = replace(step(0, 4).estimate, state=np.full(6, np.nan))
    landing.land(2.0, step(0, 4))
    landing.land(2.1, replace(step(0, 4), estimate=lost))
    assert landing.reference(REFERENCE).at(2.1, 0.0).state.shape == (6,)


def test_a_long_flight_resets_the_count_of_landings():
    landing, down, later = Landing(TWICE), step(0, 4, speed=0.0), 0.0
    for _ in range(5):
        landing.land(later, down)
        assert landing.retries(later + 2.5)
        later += 40.0


def test_motors_are_retried_twice():
    landing, tried = Landing(TWICE), []
    for now in np.arange(0, 30, 0.01):
        landing.land(now, step(0, 4, speed=0.0))
        if landing.retries(now):
            tried.append(now)
            assert landing.reference(REFERENCE) is REFERENCE
    assert tried == pytest.approx([2.0, 4.01])


def test_a_craft_held_by_hand_flies_once_released():
    model = replace(published_model("M3"), frame="body", indexing="start")
    tuning = default_tuning().with_law("lqr").with_estimator("learning")
    controller = TrackingController(model, SetPoint(0.3, 0.2, 0.0), tuning)
    for k in range(200):
        for frame in range(2):
            controller.pose((2 * k + frame) * 0.005, np.zeros(3))
        sent = controller.step(0.01 * k + 0.005)
        controller.sent(0.01 * k + 0.005, sent.command)
        assert sent.status != "cannot steer"


def test_a_craft_with_a_dead_motor_comes_to_rest_before_a_rail():
    model = replace(published_model("M3"), frame="body", indexing="start")
    dead = Weakness(motor=model.vehicle.columns[0], start_s=0.5, stop_s=60.0, share=0.0)
    settings = TwinSettings(motors=Motors(weak=(dead,)))
    tuning = default_tuning().with_law("lqr").with_estimator("learning")
    points = SetPoints([0.0, 1.0], [(0.4, 0.2, 1.0), (-0.3, -0.1, -1.0)])
    controller = TrackingController(model, points, tuning)
    twin, statuses = Twin(model, settings, seed=1), []
    steps = controller.step
    controller.step = lambda time: statuses.append(steps(time)) or statuses[-1]
    fly(controller, twin, 5.0)
    assert "cannot steer" in {each.status for each in statuses}
    assert twin.contacts == []
