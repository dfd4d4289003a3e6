"""Gauges as HTML: how the loop keeps its time, and how the craft fares beside its model."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from html import escape

from airpuck.flight.health import Health
from airpuck.live.monitor import DEADLINE, JITTER_P99, LATENCY_P99

_FILL, _TOO_MUCH, _GROUND, _WARN = "#0072b2", "#d55e00", "#e3e7ea", "#b35900"
#: Figures of the controller's heartbeat, what they are called here, and what they may be [ms].
_TIMES = {
    "pose_to_command_ms": ("pose to command", 1e3 * LATENCY_P99),
    "pose_age_ms": ("age of the pose", 1e3 * DEADLINE),
    "period_jitter_ms": ("period jitter", 1e3 * JITTER_P99),
}
#: A full bar: what the simplest model, M0, misses on the real table [m, m, rad].
_FULL_ERROR = (0.016, 0.016, 0.5)


@dataclass(frozen=True)
class Gauge:
    """A line with a bar."""

    #: What, and how much, in words.
    name: str
    value: str
    #: Length of the bar, 1 for a full one; one that is longer is drawn as too much. None: no bar.
    share: float | None = None


def gauges_html(gauges: list[Gauge]) -> str:
    """Lay gauges out, one a line."""
    style = (
        "width:100%;font-size:0.8em;line-height:1.35;padding:0 0.4em;border-spacing:0;"
        "font-variant-numeric:tabular-nums"
    )
    lines = "".join(
        f"<tr><td>{escape(gauge.name)}</td>{_bar(gauge.share)}"
        f'<td style="text-align:right;white-space:nowrap">{escape(gauge.value)}</td></tr>'
        for gauge in gauges
    )
    return f'<table style="{style}">{lines}</table>'


def timing_gauges(figures: Mapping[str, str]) -> list[Gauge]:
    """Return how a controller keeps its time."""
    gauges = []
    for key, (name, limit) in _TIMES.items():
        try:
            value = float(figures[key].split()[0])
        except (KeyError, ValueError, IndexError):
            continue
        gauges.append(Gauge(name, f"{value:.2f} of {limit:g} ms", value / limit))
    if "missed_deadlines" in figures:
        gauges.append(Gauge("missed deadlines", figures["missed_deadlines"]))
    return gauges


def health_html(health: Health) -> str:
    """Lay out errors by channel, and what propellers and delay have to do with them."""
    found = health.found
    if not health.flying or not found.predictions:
        return paragraph(str(health))
    channels = zip(("x", "y", "yaw"), found.error.tolist(), _FULL_ERROR, strict=True)
    errors = [
        Gauge(name, f"{error:.3f} rad" if name == "yaw" else f"{1e3 * error:.1f} mm", error / full)
        for name, error, full in channels
    ]
    shares = found.share.tolist()
    causes = [
        Gauge(name, f"{100 * e:.0f} ± {100 * sd:.0f} %", share)
        for name, e, sd, share in zip(
            health.motors, found.effectiveness, found.deviation, shares[:-1], strict=True
        )
    ]
    late = f"{1e3 * found.delay:+.1f} ± {1e3 * found.delay_deviation:.1f} ms"
    causes.append(Gauge("delay", late, shares[-1]))
    told = "".join(paragraph(finding, _WARN) for finding in health.findings)
    return (
        paragraph(f"Errors after {health.horizon:g} s (bar: of 16 mm, 0.5 rad)")
        + gauges_html(errors)
        + paragraph("Thrust and delay against the model's (bar: of the squared error)")
        + gauges_html(causes)
        + (told or paragraph("as the model says"))
    )


def paragraph(text: str, color: str = "inherit") -> str:
    """Lay out a line of text."""
    style = f"margin:0.15em 0.5em;font-size:0.8em;color:{color}"
    return f'<p style="{style}">{escape(text)}</p>'


def _bar(share: float | None) -> str:
    """Return the cell with a bar."""
    if share is None or not math.isfinite(share):
        return '<td style="width:32%"></td>'
    color = _FILL if share <= 1 else _TOO_MUCH
    width = 100 * min(max(share, 0.0), 1.0)
    return (
        f'<td style="width:32%"><div style="background:{_GROUND};height:0.6em">'
        f'<div style="background:{color};height:100%;width:{width:.0f}%"></div></div></td>'
    )
