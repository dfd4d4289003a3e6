"""The flight loop on the graph, in this process; `test_processes` has it as a process."""

from __future__ import annotations

import numpy as np
import pytest

from airpuck.control.reference import SetPoint
from airpuck.control.tracking import TrackingController
from airpuck.control.tuning import default_tuning
from airpuck.craft.vehicle import default_vehicle
from airpuck.flight.clock import Clock
from airpuck.flight.pulses import PulseTest
from airpuck.live import fly
from airpuck.live.graph import SENSOR, Graph
from airpuck.live.safety import SafetyLimits
from airpuck.live.settings import LiveSettings
from airpuck.model.model_file import published_model

from ..apparatus.processes import CODECS, COMMANDS, POSES

pytestmark = pytest.mark.slow

VEHICLE = default_vehicle()


class Pilot(PulseTest):
    """Records when a command was requested."""

    def __init__(self):
        super().__init__(VEHICLE)
        self.asked: list[float] = []

    def step(self, time):
        self.asked.append(time)
        return super().step(time)


def test_a_rehearsal_teaches_nothing_about_the_motors():
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


def test_motors_idle_as_soon_as_a_rival_is_on_the_graph(domain, monkeypatch):
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
            SafetyLimits(geofence=(1.0, 1.0)),
            LiveSettings(domain=domain, duration=10.0, quiet=True),
            over=over,
            warm_up=False,
        )
    finally:
        table.close()
        rival.close()
    assert came
    assert pilot.asked[-1] < came[0] + 0.15
