"""Experiments on the twin: excitation, recovery of the truth, and set points."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import airpuck
from airpuck import InputError, SetPoint, SetPoints, Table, Vehicle, read_recording, write_bag
from airpuck.control.tuning import default_tuning
from airpuck.craft.vehicle import default_vehicle
from airpuck.flight.track import Track
from airpuck.model.model_file import nominal_model, published_model
from airpuck.twin import experiments as module
from airpuck.twin.experiments import COURSES, course_plan, excite, passes, race, track
from airpuck.twin.plant import build_plant
from airpuck.twin.settings import Motors, Radio, Stall, default_twin_settings
from airpuck.twin.tracking_study import SET_POINTS, tracking_study

from ..apparatus.excited_flights import TRUTH, fit_of_flown, flown
from ..apparatus.recovery import assert_recovered
from ..apparatus.refusals import rejected

# All courses are on the table; flying each takes minutes.

M3 = airpuck.read_model("paper:M3")
COARSE = {"intervals": 20}


@pytest.fixture(scope="module")
def planned():
    # A grid half as fine as a user's.
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "plan", lambda *what, **how: airpuck.plan(*what, **how | COARSE))
        # Further starts do not make it faster.
        patch.setattr("airpuck.planning.plan._DOUBTFUL", 0.0)
        return course_plan("straight", M3, default_twin_settings())


@pytest.mark.slow
def test_a_plan_takes_its_time_and_a_set_point_twice_as_long(planned):
    found = race(planned, M3, seeds=1)
    assert found.contacts == 0
    for raced, alone in zip(found.flown, found.set_point, strict=True):
        assert planned.lower_bound < raced < 1.1 * planned.duration
        assert alone > 1.6 * raced
    figures = found.to_json()
    assert figures["planned_s"] == planned.duration
    assert figures["flown_s"] == list(found.flown)
    assert figures["lower_bound_s"] == planned.lower_bound


def test_courses_lie_on_the_table():
    reach = Table().reach(M3.vehicle.radius_m)
    for start, goal, via in COURSES.values():
        for point in (start, goal, *via):
            assert abs(point[0]) < reach[0] - 0.02
            assert abs(point[1]) < reach[1] - 0.02


def test_a_point_counts_as_passed_at_any_yaw_and_speed():
    point = (0.3, -0.2)
    states = np.array([[0.3, 0.3, 0, 0, 0, 0], [0.301, -0.2, 3, 5, 5, 9], [-0.3, -0.2, 0, 0, 0, 0]])
    assert passes(states, np.array(point)).tolist() == [False, True, False]


@pytest.mark.slow
def test_plans_with_waypoints_or_a_moving_start_have_no_set_point_flight(planned):
    states = planned.samples[1]
    x, y = states[len(states) // 2, :2].tolist()  # the plan passes there
    past = replace(planned, via=((x, y),), keep_out=((x, y, 0.05),))
    found = race(past, M3)
    assert found.set_point is None
    assert found.to_json()["set_point_s"] is None
    assert found.flown[0] == pytest.approx(planned.duration, rel=0.1)
    assert found.touches == 1
    missed = race(replace(planned, via=((x, y + 0.3),)), M3)
    assert missed.flown == (None,)
    states = planned.states.copy()
    states[0, 3] = 0.5
    with pytest.raises(InputError, match="starts in motion"):
        race(replace(planned, states=states), M3)


def test_a_twin_of_another_craft_is_rejected(planned):
    examples = Path(__file__).parents[2] / "examples"
    other = nominal_model(airpuck.read_vehicle(examples / "free_flyers/atmos.toml"))
    with pytest.raises(InputError, match="has 6 motors, the twin 8"):
        race(planned, other)


M0, M4 = published_model("M0"), published_model("M4")
SETTINGS = default_twin_settings()


@pytest.fixture(scope="module")
def plant():
    return build_plant(TRUTH)


@pytest.fixture(scope="module")
def plant_m4():
    return build_plant(M4)


@pytest.fixture(scope="module")
def fit():
    return fit_of_flown(SETTINGS.radio.jitter_s, 40.0)


@pytest.mark.slow
def test_an_excitation_stays_off_the_rails_and_moves_around():
    pose = flown(SETTINGS.radio.jitter_s, 40.0).trajectory.state[:, :3]
    reach = SETTINGS.table.reach(TRUTH.vehicle.radius_m)
    assert (np.abs(pose[:, :2]) < np.array(reach) - 0.01).all()
    assert (np.ptp(pose[:, :2], axis=0) > 0.2).all()
    assert np.abs(np.diff(np.unwrap(pose[:, 2])) * 240).max() > 3


@pytest.mark.slow
def test_a_seed_determines_the_excitation(plant):
    one, same, other = (excite(TRUTH, 1.0, seed, plant=plant) for seed in (1, 1, 2))
    assert one.streams.keys() == same.streams.keys() >= {"pose", "command", "reference"}
    for name, stream in one.streams.items():
        assert stream == same.streams[name]
        assert name == "reference" or stream != other.streams[name]


def test_amplitude_and_hold_time_affect_the_signals(plant):
    recording = excite(TRUTH, 2.0, 1, amplitude=0.1, hold=0.5, plant=plant)
    commands = recording["command"].values[10:]  # the first ones wait for a pose
    # From rest at the set point, the controller adds little.
    assert commands[:40].max() < 0.25
    held = np.abs(np.diff(recording["command"].values, axis=0)).max(axis=1)
    assert held[49] > 2 * np.median(held)


@pytest.mark.slow
def test_identification_recovers_the_truth(fit):
    assert_recovered(fit.model.parameters, TRUTH.parameters)


@pytest.mark.slow
def test_identification_does_not_just_return_its_initial_guess(fit):
    start, truth = nominal_model(TRUTH.vehicle).parameters, TRUTH.parameters
    assert abs(start.inertia / truth.inertia - 1) > 0.1
    assert abs(start.angle_offset - truth.angle_offset) > 0.03
    assert np.abs(start.center_of_mass - truth.center_of_mass).max() > 0.9e-3


@pytest.mark.slow
def test_identification_recovers_the_delay_to_one_sample(fit):
    assert fit.model.transport_delay == pytest.approx(TRUTH.transport_delay, abs=1.01 / 240)


@pytest.mark.slow
def test_the_true_model_reaches_its_set_points_within_six_seconds():
    (flight,) = tracking_study([M4], M4, dwell=6.0)
    for result, pose in zip(flight.results, SET_POINTS[1:], strict=True):
        assert result.pose == pytest.approx(pose)
        assert np.abs(result.steady_state_error[:2]).max() < 5e-3
        assert abs(result.steady_state_error[2]) < 0.02
    assert set(flight.outcomes) <= {"exact", "scaled", "nearest", "no pose"}


@pytest.mark.study
def test_after_two_seconds_a_poor_model_is_off_and_the_true_one_is_not():
    poor, true = tracking_study([M0, M4], M4)
    poor, true = (
        np.abs([result.steady_state_error for result in flight.results]) for flight in (poor, true)
    )
    assert poor[:, :2].max() > 0.02
    assert poor[:, :2].max() > 2 * true[:, :2].max()


@pytest.mark.slow
def test_disturbance_rejection_brings_a_poor_model_to_its_set_points(plant_m4):
    reference = SetPoints([0.0, 0.5, 6.5], SET_POINTS[:3])
    recording = track(M0, reference, 12.5, truth=M4, plant=plant_m4).recording
    results = Track.of(recording, M0.vehicle, "").results()[-2:]
    found = np.abs([result.steady_state_error for result in results])
    assert found[:, :2].max() < 5e-3
    assert found[:, 2].max() < 0.02


@pytest.mark.slow
def test_set_points_are_reached_over_a_bad_radio(plant_m4):
    radio = Radio(
        delay_s=0.03, jitter_s=0.03, loss=0.3, outages_s=((1.0, 1.1), (2.5, 2.6), (7.0, 7.1))
    )
    settings = SETTINGS.model_copy(update={"radio": radio})
    reference = SetPoints([0.0, 0.5, 5.5], SET_POINTS[:3])
    log = track(M4, reference, 10.5, settings=settings, plant=plant_m4)
    recording = log.recording
    found = np.abs(
        [r.steady_state_error for r in Track.of(recording, M4.vehicle, "").results()[-2:]]
    )
    assert found[:, :2].max() < 0.02
    assert found[:, 2].max() < 0.1
    reach = np.array(settings.table.reach(M4.vehicle.radius_m))
    assert (np.abs(recording["pose"].values[:, :2]) < reach - 1e-3).all()
    assert np.isfinite(log.command).all()


@pytest.mark.slow
def test_a_flight_starts_at_the_given_pose(plant_m4):
    log = track(M4, SetPoint(0.3, -0.1, 2.0), 0.5, pose=(0.3, -0.1, 2.0), plant=plant_m4)
    recording = log.recording
    np.testing.assert_allclose(recording["pose"].values[0], [0.3, -0.1, 2.0], atol=3e-3)
    np.testing.assert_allclose(recording["pose"].values[-1], [0.3, -0.1, 2.0], atol=6e-3)
    np.testing.assert_array_equal(log.reference, np.tile([0.3, -0.1, 2.0], (50, 1)))
    np.testing.assert_array_equal(recording["command"].values, log.command)


@pytest.mark.parametrize("duration", [0.0, -1.0, np.nan, 0.009, np.inf])
def test_a_duration_without_a_command_or_an_end_is_rejected(duration):
    for attempt in (
        lambda: excite(TRUTH, duration),
        lambda: track(M4, SetPoint(0, 0, 0), duration),
    ):
        with rejected(field="duration"):
            attempt()


def test_a_flight_with_one_command_can_be_read_back(tmp_path, plant):
    flown = excite(TRUTH, 0.01, plant=plant)
    write_bag(flown, tmp_path / "bag")
    assert len(read_recording(tmp_path / "bag")["command"]) == len(flown["command"]) == 1


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("seed", -1),
        ("pose", (0.0, np.nan, 0.0)),
        ("pose", (0.0, 0.0, np.inf)),
        ("pose", (5.0, 0.0, 0.0)),
        ("pose", (0.0, -5.0, 0.0)),
        ("gain", np.full((3, 6), np.nan)),
    ],
)
def test_an_invalid_start_pose_is_named(field, value, plant_m4):
    with rejected(field=field):
        track(M4, SetPoint(0, 0, 0), 0.1, plant=plant_m4, **{field: value})
    if field == "seed":
        with pytest.raises(InputError, match="seed"):
            excite(TRUTH, 0.1, value)


def test_wrong_types_are_rejected_without_a_type_checker():
    code = """
import numpy as np
from airpuck import InputError, read_model, track
from airpuck.control.reference import SetPoint

model = read_model("paper:M3")
for field, value in (("gain", np.ones((2, 6))), ("seed", 0.5), ("pose", (0.0, 0.0))):
    try:
        track(model, SetPoint(0, 0, 0), 0.1, **{field: value})
    except InputError as error:
        assert error.field == field, error
    else:
        raise AssertionError(field)
"""
    subprocess.run([sys.executable, "-c", code], check=True)


def test_a_different_number_of_propellers_is_rejected():
    content = default_vehicle().model_dump()
    content |= {"propellers": content["propellers"][:4], "pairs": content["pairs"][:2]}
    four = nominal_model(Vehicle.model_validate(content))
    with pytest.raises(InputError, match="4 motors, the twin 6"):
        track(four, SetPoint(0, 0, 0), 1.0, truth=M4)


def faulty_flight(estimator, motors, plant):
    """Fly to three set points; root mean square error of x and y [m] and yaw [rad] after 2 s."""
    settings = default_twin_settings().model_copy(update={"motors": motors})
    points = SetPoints([0.0, 1.5, 4.0], [(0, 0, 0), (0.2, 0.1, 0.8), (0.0, -0.1, -0.4)])
    tuning = default_tuning().with_estimator(estimator)
    log = track(M4, points, 6.5, settings=settings, tuning=tuning, plant=plant)
    recording = log.recording
    flight = Track.of(recording, M4.vehicle, "")
    wanted = np.array([points.at(float(t), 0.0).state[:3] for t in flight.time])
    error = (flight.pose - wanted)[flight.time > 2.0]
    assert set(log.status[10:]) <= {"exact", "scaled", "nearest"}
    return np.sqrt(np.mean(error**2, axis=0))


@pytest.mark.slow
def test_a_craft_with_an_estimated_dead_motor_keeps_its_set_points(plant_m4):
    dead = Motors(stalls=(Stall(motor="motor_b_2", start_s=1.0, stop_s=99.0),))
    unaware, aware = (
        faulty_flight(estimator, dead, plant_m4) for estimator in ("kalman", "actuation")
    )
    assert np.linalg.norm(aware[:2]) < 0.8 * np.linalg.norm(unaware[:2])
    assert aware[2] < 0.8 * unaware[2]


@pytest.mark.study
def test_estimating_the_motors_does_not_degrade_a_healthy_craft(plant_m4):
    kalman, actuation = (faulty_flight(e, Motors(), plant_m4) for e in ("kalman", "actuation"))
    np.testing.assert_allclose(actuation, kalman, rtol=0.1)
