"""Gauges and events beside the table of the live view, as JSON values."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from airpuck.deviation.model_errors import ModelError
from airpuck.flight.clock import DEADLINE, JITTER_P99, LATENCY_P99
from airpuck.flight.health import HORIZON, Health
from airpuck.live.events import EVENT_LEVELS
from airpuck.live.fly import NAME as FLY
from airpuck.live.plan import NAME as PLAN
from airpuck.live.watch import Observer

#: Number of events shown, the newest first.
_SHOWN = 12
#: Age of the last heartbeat above which a controller counts as gone [s].
_GONE = 2.5
#: Figures of the controller's heartbeat, their names here, and their limits [ms].
_TIMES = {
    "pose_to_command_ms": ("pose to command", 1e3 * LATENCY_P99),
    "pose_age_ms": ("age of the pose", 1e3 * DEADLINE),
    "period_jitter_ms": ("period jitter", 1e3 * JITTER_P99),
}
#: Prediction error of a full bar: the simplest model, M0, on the real table [m, m, rad].
_FULL_ERROR = (0.016, 0.016, 0.5)


class Gauge(NamedTuple):
    """A line with a name, a value as text, and a bar."""

    name: str
    value: str
    #: Length of the bar: 1 is full, more is shown as excess, None means no bar.
    share: float | None = None


def panel(observer: Observer) -> dict[str, Any]:
    """Return gauges of flight and craft, and the newest events."""
    now, health = observer.clock.now, observer.health
    rates = [f"{observer.rates.get(stream, 0.0):.0f} Hz" for stream in ("pose", "command")]
    gauges = [Gauge("poses, commands", ", ".join(rates))]
    came, status, figures = observer.beats.get(FLY, (-math.inf, "", {}))
    if now - came < _GONE:
        gauges += [Gauge("controller", status), *timing_gauges(figures)]
        gauges += plan_gauges(*observer.beats.get(PLAN, (-math.inf, "", {})), now)
    else:
        gauges.append(Gauge("controller", "none"))
    newest = list(observer.events)[: -_SHOWN - 1 : -1]
    return {
        "flight": gauges,
        "health": health_gauges(health),
        "findings": [[finding, "warning"] for finding in health.findings]
        or [["nothing deviates from the model", "info"]] * judged(health),
        "events": [
            [f"{now - came:.0f} s ago, {event.name}: {event.msg}", _severity(event.level)]
            for came, event in newest
        ],
    }


def timing_gauges(figures: Mapping[str, str]) -> list[Gauge]:
    """Return gauges of a controller's heartbeat: its timing."""
    gauges = []
    for key, (name, limit) in _TIMES.items():
        try:
            value = float(figures[key].split()[0])
        except (KeyError, ValueError, IndexError):
            continue
        if math.isfinite(value):
            gauges.append(Gauge(name, f"{value:.2f} of {limit:g} ms", value / limit))
    if "missed_deadlines" in figures:
        gauges.append(Gauge("missed deadlines", figures["missed_deadlines"]))
    return gauges


def plan_gauges(came: float, status: str, figures: Mapping[str, str], now: float) -> list[Gauge]:
    """Return a predictive law's last report on its plan: outcome and active limits."""
    if now - came >= _GONE:
        return []
    return [Gauge("plan", status), Gauge("limits ahead", figures.get("limits") or "none")]


def judged(health: Health) -> bool:
    """Return whether the craft flies, and has been compared with its model."""
    return health.flying and health.predictions > 0


def health_gauges(health: Health) -> list[tuple[str, list[Gauge]]]:
    """Return errors by channel, and the contributions of propellers and delay, under headings."""
    if not judged(health):
        return [(str(health), [])]
    x, y, yaw = health.error.tolist()
    words = f"{1e3 * x:.1f} mm", f"{1e3 * y:.1f} mm", f"{yaw:.3f} rad"
    lengths = (x, y, yaw) / np.array(_FULL_ERROR)
    errors = list(map(Gauge, ("x", "y", "yaw"), words, lengths.tolist()))
    causes = [
        Gauge(one.name, _against_model(one), one.share)
        if one.tested
        else Gauge(one.name, "unknown: too little excitation")
        for one in (*health.errors[1:], *health.errors[:1])
    ]
    return [
        (f"Errors after {HORIZON:g} s (bar: of 16 mm, 0.5 rad)", errors),
        ("Thrust and delay against the model's (bar: of the squared error)", causes),
    ]


def _against_model(one: ModelError) -> str:
    """Write a motor's thrust relative to the model, or how much later commands act."""
    value, error = one.value, one.standard_error
    if one.name == "delay":
        return f"{1e3 * value:+.1f} ± {1e3 * error:.1f} ms"
    return f"{100 * (1 + value):.0f} ± {100 * error:.0f} %"


def _severity(level: int) -> str:
    """Return the class of an event on the page: error, warning or info."""
    return next((name for name in ("error", "warning") if level >= EVENT_LEVELS[name]), "info")
