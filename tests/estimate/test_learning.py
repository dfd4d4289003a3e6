"""What the learning estimator knows after a while: against known motors, mass and delays."""

from copy import copy
from dataclasses import replace

import numpy as np
import pytest

from airpuck import SetPoint, SetPoints, TrackingController, Twin
from airpuck.control.tuning import default_tuning
from airpuck.estimate.axis_filter import Noise
from airpuck.estimate.estimator import BEYOND, ActuationEstimate
from airpuck.estimate.kalman import ActuationFilter
from airpuck.flight.loop import fly
from airpuck.model.model_file import nominal_model, published_model
from airpuck.model.uncertainty import DelayJitter

from ..apparatus.random_flights import HOLD, POSE_RATE, random_flight
from ..apparatus.two_way_craft import triangle

M3 = replace(published_model("M3"), indexing="start").with_delay(0.0)
QUIET = Noise(
    pose=(5e-5, 5e-5, 6e-4), acceleration=(0.02, 0.02, 0.6), disturbance=(0.02, 0.02, 0.6)
)


def changed(share, drag=0.0, offset=(0.0, 0.0), slope=(0.0, 0.0)):
    known = M3.parameters
    thrust, center = known.thrust * np.reshape(share, (-1, 1)), known.center_of_mass + offset
    parameters = replace(known, thrust=thrust, center_of_mass=center)
    if drag or any(slope):
        parameters = replace(parameters, drag=np.array([drag, 0, 0, 0]), tilt=np.array(slope))
    # A real centre of mass turns with the craft.
    return replace(M3, parameters=parameters, frame="body" if any(offset) else M3.frame)


@pytest.fixture(scope="module")
def compiled():
    return ActuationFilter(M3, QUIET, learned=30.0)


@pytest.fixture
def learning(compiled):
    """A new filter, with programs compiled once for all tests."""
    fresh = copy(compiled)
    fresh.reset()
    return fresh


def taught(learning, share, *, later=0.0, seed=0, lasting=5.0, **body):
    """Feed the first part of a flight of a changed craft, whose commands act later."""
    flight = random_flight(changed(share, **body), lasting if body else 5.0, seed)
    noise = np.random.default_rng(seed).normal(size=(len(flight.time), 3)) * QUIET.pose
    poses = [
        (time, 1, pose) for time, pose in zip(flight.time, flight.state[:, :3] + noise, strict=True)
    ]
    sent = [
        (time, 0, command)
        for time, command in zip(flight.time - later, flight.command, strict=True)
    ]
    for time, is_pose, values in sorted(poses + sent, key=lambda one: one[:2]):
        if time <= lasting:
            (learning.pose if is_pose else learning.command)(float(time), values)
    return flight


@pytest.mark.parametrize("seed", range(3))
def test_motors_and_delay_are_learned_together(learning, seed):
    share = 0.8 * np.ones(6)
    share[seed] = 0.5
    taught(learning, share, later=0.012, seed=seed)
    found = learning.predict(5.0).actuation
    off = np.append(found.effectiveness - share, found.delay - 0.012)
    assert np.abs(off[:-1]).max() < 0.15
    assert abs(off[-1]) < 0.003
    known = np.append(found.deviation, found.delay_deviation)
    assert np.abs(off / known).max() < 3.5


@pytest.mark.parametrize(("stated", "own"), [(None, 6.3e-3), (3e-3, 3e-3)])
def test_the_delay_of_jittering_packets_is_known_to_sigma_over_root_n(compiled, stated, own):
    """Of N packets the mean delay is known to σ/√N, however hard each of them pushes."""
    if stated:
        known = DelayJitter(standard_deviation_s=stated, standard_error_s=1e-4, packets=100)
        compiled = ActuationFilter(replace(M3, delay_jitter=known), QUIET, learned=30.0)
    packets, scores = 20, []
    for seed in range(6):
        learning, random = copy(compiled), np.random.default_rng([seed, 2])
        learning.reset()
        flight = random_flight(M3, packets * HOLD, seed)
        poses = flight.state[:, :3] + random.normal(size=(len(flight.time), 3)) * QUIET.pose
        switched = np.arange(0, len(flight.time), round(HOLD * POSE_RATE))
        sent = flight.time[switched] - random.normal(0, own, packets)
        events = [(*one, learning.pose) for one in zip(flight.time, poses, strict=True)]
        events += [
            (*one, learning.command) for one in zip(sent, flight.command[switched], strict=True)
        ]
        for time, values, use in sorted(events, key=lambda one: one[0]):
            use(float(time), values)
        found = learning.predict(flight.time[-1]).actuation
        scores.append(found.delay / found.delay_deviation)
        assert own / np.sqrt(packets) < found.delay_deviation < 2 * own / np.sqrt(packets)
    assert np.sqrt(np.mean(np.square(scores))) < 1.5


def test_learned_values_persist_at_rest_but_become_uncertain(learning):
    random = np.random.default_rng(0)
    taught(learning, [0.8, 0.8, 0.5, 0.8, 0.8, 0.8])
    before = learning.predict(5.0).actuation
    learning.command(5.0, np.zeros(6))
    learning.restart(6.0, np.zeros(3))
    for k in range(1, 20 * 100):
        learning.pose(6.0 + k / 100, random.normal(size=3) * QUIET.pose)
    after = learning.predict(26.0).actuation
    # The actuation filter would think the motors healthy again, see test_actuation_filter.
    np.testing.assert_allclose(after.effectiveness, before.effectiveness, atol=0.03)
    assert (after.deviation > 1.5 * before.deviation).all()


def test_a_dead_motor_is_detected_immediately_and_remembered(learning):
    time = 0.0
    for share in (np.ones(6), np.array([1, 1, 0.0, 1, 1, 1])):
        flight = random_flight(changed(share), 3.0, 5)
        for k, z in enumerate(flight.state):
            learning.command(time + k / 240, flight.command[k])
            learning.pose(time + k / 240, z[:3])
        time += len(flight.time) / 240 + 0.06
    found = learning.predict(time - 0.06).actuation
    np.testing.assert_allclose(found.effectiveness, share, atol=0.2)


def test_forgetting_the_motors_keeps_motion_and_delay(learning):
    new = copy(learning)
    new.pose(0.0, np.zeros(3))
    unknown = new.predict(0.0).actuation
    flight = taught(learning, [0.8, 0.8, 0.0, 0.8, 0.8, 0.8], later=0.012)
    later = learning.later
    assert later > 0.005
    learning.forget()
    forgotten = learning.predict(learning.time - later)
    np.testing.assert_allclose(forgotten.actuation.effectiveness, 1.0, atol=1e-9)
    np.testing.assert_allclose(forgotten.actuation.deviation, unknown.deviation)
    assert forgotten.actuation.delay == learning.later == later
    last = flight.state[flight.time <= 5.0][-1]
    near = [2e-3, 2e-3, 1e-2, 0.02, 0.02, 0.5]
    assert (np.abs(forgotten.state - last) < near).all()
    assert np.abs(last[3:]).max() > 0.05


@pytest.mark.parametrize("later", [0.005, 0.015])
def test_predictions_end_when_a_late_command_takes_effect(learning, later):
    now = 4.0
    flight = taught(learning, np.ones(6), later=later, lasting=now)
    # The commands sent by now act until now + later.
    true = [np.interp(now + later, flight.time, column) for column in flight.state.T[:6]]
    predicted = learning.predict(now)
    np.testing.assert_allclose(predicted.state[:2], true[:2], atol=3e-4)
    np.testing.assert_allclose(predicted.state[2], true[2], atol=6e-3)


def test_only_significant_changes_are_used(learning):
    taught(learning, np.ones(6))
    found = learning.predict(5.0)
    assert np.abs(found.actuation.effectiveness - 1).max() > 1e-3
    np.testing.assert_allclose(found.effectiveness, 1.0, atol=1e-9)
    assert learning.later == 0
    learning.reset()
    taught(learning, 0.7 * np.ones(6), later=0.015)
    found = learning.predict(5.0)
    np.testing.assert_allclose(found.effectiveness, 0.7, atol=0.1)
    assert abs(learning.later - 0.015) < 0.003


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2))
def test_drag_slope_and_mass_offset_are_learned_with_the_motors(learning, seed):
    true = np.array([0.25, 2e-3, -1.5e-3, 4e-3, -3e-3])
    true[1:] *= (-1.0, 1.0)[seed]
    body = {"drag": true[0], "offset": true[1:3], "slope": true[3:]}
    taught(learning, [1, 1, 0.8, 1, 1, 1], seed=seed, lasting=20.0, **body)
    found = learning.predict(20.0).actuation
    assert list(found.beyond) == list(BEYOND)
    value, deviation = np.array(list(found.beyond.values())).T
    assert (np.abs(value - true) < 3 * deviation).all()
    assert (deviation < 0.6 * np.array(list(BEYOND.values()))).all()


@pytest.mark.slow
def test_at_rest_body_intervals_return_to_the_prior_without_drift(learning):
    random = np.random.default_rng(0)
    taught(learning, np.ones(6), lasting=20.0, drag=0.25, offset=(2e-3, 0.0), slope=(4e-3, 0.0))
    before = np.array(list(learning.predict(20.0).actuation.beyond.values()))
    learning.command(20.0, np.zeros(6))
    learning.restart(21.0, np.zeros(3))
    for k in range(1, 60 * 25):
        learning.pose(21.0 + k / 25, random.normal(size=3) * QUIET.pose)
    after = np.array(list(learning.predict(81.0).actuation.beyond.values()))
    # A craft at rest shows that the table is level; of the rest it tells nothing.
    np.testing.assert_allclose(after[:3, 0], before[:3, 0], rtol=0.02, atol=1e-4)
    priors = np.array(list(BEYOND.values()))
    assert (after[:3, 1] > 0.85 * priors[:3]).all()
    assert (np.abs(after[3:, 0]) < after[3:, 1]).all()
    assert (after[:, 1] < priors).all()


def test_without_a_disturbance_no_slope_is_estimated():
    still = Noise(QUIET.pose, QUIET.acceleration, (0.0, 0.0, 0.0))
    learning = ActuationFilter(M3, still, learned=30.0, compiled=False)
    learning.pose(0.0, np.zeros(3))
    for k in range(1, 20):
        learning.pose(k / 100, np.full(3, 1e-5 * k * k))
    found = learning.predict(0.2)
    assert not found.disturbance.any()
    assert found.actuation.beyond["tilt x"] == (0.0, 0.0)


def test_the_tuning_selects_the_estimator():
    tuning = default_tuning().with_estimator("learning")
    controller = TrackingController(M3, SetPoints([0.0], [(0, 0, 0)]), tuning, compiled=False)
    assert isinstance(controller.filter, ActuationFilter)


def test_a_craft_with_two_way_propellers_and_a_wheel_learns(tmp_path):
    model = nominal_model(triangle(tmp_path)).with_delay(0.02)
    tuning = default_tuning().with_law("lqr").with_estimator("learning")
    controller = TrackingController(model, SetPoint(0.2, 0.1, 0.5), tuning)
    fly(controller, Twin(model), 1.0)
    found = controller.predict(1.0).actuation
    names = [f"found: {name}" for name in model.vehicle.propeller_names]
    names += ["found: delay", "found: drag linear", "found: center of mass x"]
    names += ["found: center of mass y", "found: tilt x", "found: tilt y"]
    assert list(found.figures(model.vehicle.propeller_names)) == names


def test_figures_have_the_units_of_the_quantities():
    beyond = {"drag linear": (0.123, 0.0456), "center_of_mass y": (-1.5e-3, 4e-4)}
    found = ActuationEstimate(np.ones(2), np.ones(2), beyond=beyond).figures(["left", "right"])
    assert found["found: drag linear"] == "+0.12 ± 0.046 1/s"
    assert found["found: center of mass y"] == "-1.5 ± 0.4 mm"
