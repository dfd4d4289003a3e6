from __future__ import annotations

import numpy as np
import pytest

from airpuck.deviation.model_errors import ModelError
from airpuck.flight.health import Health
from airpuck.web.panel import Gauge, health_gauges, judged, plan_gauges, timing_gauges


def test_times_are_compared_with_their_limits():
    figures = {"pose_to_command_ms": "2.50 (p99)", "period_jitter_ms": "4.00 (p99)"}
    latency, jitter, missed = timing_gauges({**figures, "missed_deadlines": "3"})
    assert (latency.value, latency.share) == ("2.50 of 5 ms", pytest.approx(0.5))
    assert (jitter.value, jitter.share) == ("4.00 of 2 ms", pytest.approx(2.0))
    assert missed == Gauge("missed deadlines", "3")
    assert timing_gauges({"pose_age_ms": "what"}) == []


def test_the_plan_is_shown_while_it_is_news():
    figures = {"limits": "motor, rail", "bound by": "motion"}
    shown = plan_gauges(10.0, "softened", figures, 11.0)
    assert shown == [Gauge("plan", "softened"), Gauge("limits ahead", "motor, rail")]
    assert plan_gauges(10.0, "optimal", {"limits": ""}, 11.0)[1].value == "none"
    assert plan_gauges(10.0, "softened", figures, 13.0) == []


def test_each_channel_and_each_motor_has_a_gauge():
    errors = (
        ModelError("delay", 0.002, 0.001, 0.005, True, 1.0, -0.02),
        ModelError("left", -0.2, 0.01, 0.05, True, 1e-9, 0.6),
        ModelError("right", 0.0, 0.01, 0.05, True, 1.0, 0.1),
    )
    health = Health(True, 30, np.array([8e-3, 4e-3, 0.1]), errors)
    assert judged(health)
    (_, errors), (_, causes) = health_gauges(health)
    assert errors == [
        ("x", "8.0 mm", pytest.approx(0.5)),
        ("y", "4.0 mm", pytest.approx(0.25)),
        ("yaw", "0.100 rad", pytest.approx(0.2)),
    ]
    assert causes == [
        ("left", "80 ± 1 %", pytest.approx(0.6)),
        ("right", "100 ± 1 %", pytest.approx(0.1)),
        ("delay", "+2.0 ± 1.0 ms", pytest.approx(-0.02)),
    ]
    assert health.findings == ("left gives 20.0 % ± 1.0 % less than modelled",)
    assert "; shares of the error: left 60 %" in str(health)


def test_a_craft_that_is_not_judged_is_described_in_words():
    health = Health(False, 0, np.full(3, np.nan), ())
    assert not judged(health)
    assert health_gauges(health) == [(str(health), [])]
