"""The flight loop on the graph, in this process; `test_processes` has it as a process."""

import os
import signal
from contextlib import nullcontext

import numpy as np
import pytest

from airpuck import Pilot as AnyPilot
from airpuck import SafetyLimits, SetPoint, Step, TrackingController
from airpuck.control.law import Prediction
from airpuck.control.tuning import default_tuning
from airpuck.craft.vehicle import default_vehicle
from airpuck.estimate.estimator import ActuationEstimate, Estimate
from airpuck.flight.clock import Clock
from airpuck.flight.pulses import PulseTest
from airpuck.live import fly
from airpuck.live.graph import SENSOR, Graph
from airpuck.live.process import PLANS
from airpuck.live.settings import LiveSettings
from airpuck.model.model_file import published_model

from ..apparatus.graph_in_memory import joined
from ..apparatus.processes import CODECS, COMMANDS, IDLE, POSES, REFERENCES

VEHICLE = default_vehicle()
LIMITS = SafetyLimits(geofence=(1.0, 1.0))
#: Where the craft is below.
PLACE = np.array([0.3, -0.2, 1.0])


class Pilot(PulseTest):
    """Records when a command was requested."""

    def __init__(self):
        super().__init__(VEHICLE)
        self.asked: list[float] = []

    def step(self, time):
        self.asked.append(time)
        return super().step(time)


def test_rehearsed_steps_leave_the_motor_estimate_unchanged():
    model, far = published_model("M3"), SetPoint(0.4, 0.2, 1.0)
    tuning = default_tuning().with_estimator("learning")
    controller = TrackingController(model, far, tuning)
    fly.rehearse_steps(controller, VEHICLE.idle, 0.01)
    for k in range(5):
        controller.pose(k / 240, np.zeros(3))
    step = controller.step(0.02)
    assert step.flies
    np.testing.assert_allclose(step.estimate.actuation.effectiveness, 1.0, atol=0.02)
    assert step.estimate.actuation.delay == pytest.approx(0.0, abs=1e-4)


@pytest.mark.slow
def test_motors_idle_once_a_second_controller_appears(domain, monkeypatch):
    monkeypatch.setattr(fly, "prioritize", lambda **_: None)
    pilot, rng = Pilot(), np.random.default_rng(0)
    table, rival = Graph("table", domain=domain), Graph("joystick", domain=domain)
    pose, command = CODECS[POSES], CODECS[COMMANDS]
    poses = table.publisher(POSES, pose.msgtype, pose.types, SENSOR)
    clock, came = Clock(), []

    def over(time: float) -> bool:
        poses.send(pose.encode(clock.stamp_ns(clock.now), rng.normal(0, 5e-5, 3)))
        # Long before the next heartbeat, which is at a second.
        if pilot.asked and not came and time - pilot.asked[0] > 0.1:
            came.append(time)
            rival.publisher(COMMANDS, command.msgtype, command.types, SENSOR)
        return bool(came) and time - came[0] > 0.4

    try:
        fly.fly_live(
            lambda: pilot,
            VEHICLE,
            LIMITS,
            LiveSettings(domain=domain, duration=10.0, quiet=True),
            over=over,
            warm_up=False,
        )
    finally:
        table.close()
        rival.close()
    assert came
    assert pilot.asked[-1] < came[0] + 0.15


# On a graph in memory -----------------------------------------------------------------------------


class Steady(AnyPilot):
    """Always steers alike, and records when it was asked, and with which priority."""

    def __init__(self, reference=None, step=None):
        self.reference = reference or SetPoint(0.0, 0.0, 0.0)
        self.asked: list[float] = []
        self.first: list[bool] = []
        self._step = step or Step(np.full(6, 0.2))

    def step(self, time):
        self.asked.append(time)
        self.first.append(PRIORITIES[-1])
        return self._step


#: What the process asked of the scheduler: whether to come first.
PRIORITIES: list[bool] = []


@pytest.fixture
def graph(monkeypatch):
    """A graph with a craft at rest."""
    PRIORITIES.clear()
    monkeypatch.setattr(fly, "prioritize", lambda *, first: PRIORITIES.append(first))
    found, rng = joined(monkeypatch), np.random.default_rng(0)
    for time in np.arange(0.005, 6.0, 0.01):
        found.publish(time, POSES, PLACE + rng.normal(0, 5e-5, 3))
    return found


def flown(pilot, seconds: float, **options):
    live = LiveSettings(duration=seconds, quiet=True)
    return fly.fly_live(lambda: pilot, VEHICLE, LIMITS, live, **options)


def test_a_pilot_compiles_before_the_flight_and_at_normal_priority(graph):
    pilot = Steady()
    flown(pilot, 0.5)
    rehearsed = np.array(pilot.asked) < 0
    assert 10 < rehearsed.sum() < len(rehearsed)
    assert (np.diff(pilot.asked) > 0).all()
    np.testing.assert_array_equal(pilot.first, ~rehearsed)
    assert PRIORITIES == [True, False, True]


@pytest.mark.parametrize("end", ["time", "over", "signal", "key"])
def test_a_flight_ends_on_request_and_idles_the_motors_five_times(graph, monkeypatch, end):
    if end == "signal":
        graph.clock.at(0.6, lambda: os.kill(os.getpid(), signal.SIGTERM))
    elif end == "key":
        keys = nullcontext(lambda: "q" if graph.clock.now >= 0.6 else "")
        monkeypatch.setattr(fly, "keyboard", lambda: keys)
    over = {"over": lambda time: time >= 0.6} if end == "over" else {}
    found = flown(Steady(), 0.61 if end == "time" else 2.0, **over)
    commands = np.array(graph.values(COMMANDS))
    assert found["duration_s"] == pytest.approx(0.65, abs=0.021)
    np.testing.assert_array_equal(commands[-5:], np.full((5, 6), IDLE))
    assert (commands[-15:-5] == 0.2).all()
    assert graph.events[-1] == "landed: motors idle"


def test_a_heartbeat_contains_what_a_pilot_learned_about_its_motors(graph):
    found = ActuationEstimate(np.full(6, 0.9), np.full(6, 0.05), delay=0.004, delay_deviation=0.001)
    estimate = Estimate(0.0, np.zeros(6), np.zeros(6), np.zeros(3), found)
    flown(Steady(step=Step(np.full(6, 0.2), "exact", estimate=estimate)), 1.2)
    *_, figures = graph.states[-1]
    assert figures["found: motor_a_1"] == "90 ± 5 %"
    assert figures["found: delay"] == "+4.0 ± 1.0 ms"


def test_every_tenth_plan_is_published(graph):
    plan = Prediction(np.array([0.02, 0.04]), np.zeros((2, 6)), ())
    estimate = Estimate(0.0, np.zeros(6), np.zeros(6), np.zeros(3))
    found = flown(Steady(step=Step(np.full(6, 0.2), "optimal", np.zeros(3), estimate, plan)), 1.0)
    assert found["outcomes"]["optimal"] > 60
    assert len(graph.sent[PLANS.name]) == found["outcomes"]["optimal"] // 10


@pytest.mark.parametrize("wished", [None, (0.1, 0.2, -1.0)])
def test_a_followed_set_point_starts_at_the_craft_and_moves_on_request(graph, wished):
    point = fly.FollowedSetPoint((1.0, 1.0))
    if wished:
        graph.publish(0.3, REFERENCES, (*wished, 0.0, 0.0, 0.0))
    flown(Steady(point), 0.6)
    expected = wished or PLACE
    np.testing.assert_allclose(point.at(0.0, 0.0).state[:3], expected, atol=1e-3)


def test_the_preflight_check_pulses_every_motor_and_fails_without_poses(graph):
    model, usual = published_model("M3"), PulseTest(VEHICLE)
    live = LiveSettings(quiet=True)
    fly.preflight_live(model, settings=live)
    commands = np.array(graph.values(COMMANDS))
    np.testing.assert_array_equal(commands.max(axis=0), np.full(6, usual.plan.level))
    assert usual.duration < graph.clock.now < usual.duration + 1.0
    graph.sent.clear()
    found = fly.preflight_live(model, settings=live)  # all poses have come
    assert "none arrived" in str(found.checks[0])
    assert 3.0 < graph.clock.now < 3.2
