from __future__ import annotations

from html.parser import HTMLParser

import numpy as np
import pytest

from airpuck.flight.health import Deviations, Health
from airpuck.web.panel import Gauge, gauges_html, health_html, plan_gauges, timing_gauges


class Balanced(HTMLParser):
    """Reads HTML; every element that is opened must be closed."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.text: list[str] = []
        self.widths: list[str] = []
        self.feed(text)
        assert not self.open

    def handle_starttag(self, tag, attrs):
        self.open.append(tag)
        style = dict(attrs).get("style") or ""
        self.widths += [part.split(":")[1] for part in style.split(";") if part.startswith("width")]

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text.append(data)


def test_a_bar_is_as_long_as_its_share_and_never_too_long():
    read = Balanced(gauges_html([Gauge("a & b", "1"), Gauge("c", "2", 0.25), Gauge("d", "3", 7.0)]))
    assert read.text == ["a & b", "1", "c", "2", "d", "3"]
    assert [width for width in read.widths if width in ("25%", "100%")] == ["100%", "25%", "100%"]


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
    found = Deviations(
        30, np.array([8e-3, 4e-3, 0.1]), np.array([0.8, 1.0, 0.002]),
        np.array([0.01, 0.01, 0.001]), np.array([0.6, 0.1, -0.02]),
    )  # fmt: skip
    health = Health(("left", "right"), True, found)
    read = Balanced(health_html(health))
    text = " ".join(read.text)
    assert "x 8.0 mm" in text
    assert "yaw 0.100 rad" in text
    assert "left 80 ± 1 %" in text
    assert "propeller left at 80 % (78 to 82 %)" in text
    bars = [width for width in read.widths if width not in ("32%", "100%")]
    assert bars == ["50%", "25%", "20%", "60%", "10%", "0%"]
    assert "; shares of the error: left 60 %" in str(health)
