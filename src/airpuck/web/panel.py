"""What stands beside the table in the browser: set point, gauges of loop and craft, events."""

from __future__ import annotations

import math
from collections.abc import Mapping
from html import escape
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from jaxtyping import Float

from airpuck.flight.clock import DEADLINE, JITTER_P99, LATENCY_P99
from airpuck.flight.health import HORIZON, Health
from airpuck.live.events import EVENT_LEVELS
from airpuck.live.fly import NAME as FLY
from airpuck.live.plan import NAME as PLAN
from airpuck.live.watch import Observer
from airpuck.web.scene import Wish

if TYPE_CHECKING:
    import viser

_WARNING, _ERROR = "#b35900", "#c00000"
_BAR, _BAR_TOO_LONG, _BAR_GROUND = "#0072b2", "#d55e00", "#e3e7ea"
#: Newest events that are shown.
_SHOWN = 12
#: A controller whose last heartbeat is older counts as gone [s].
_GONE = 2.5
#: Figures of the controller's heartbeat, their names here, and their limits [ms].
_TIMES = {
    "pose_to_command_ms": ("pose to command", 1e3 * LATENCY_P99),
    "pose_age_ms": ("age of the pose", 1e3 * DEADLINE),
    "period_jitter_ms": ("period jitter", 1e3 * JITTER_P99),
}
#: Prediction error of a full bar: that of the simplest model, M0, on the real table [m, m, rad].
_FULL_ERROR = (0.016, 0.016, 0.5)


class Panel:
    """Set point, gauges and events; `wish` takes the x, y [m], yaw [rad] that the user enters."""

    def __init__(self, server: viser.ViserServer, reach: tuple[float, float], wish: Wish) -> None:
        gui = server.gui
        gui.configure_theme(
            control_layout="fixed", control_width="medium", show_logo=False, show_share_button=False
        )
        gui.set_panel_label("airpuck")
        with gui.add_folder("Set point"):
            self._hint = gui.add_html("")
            limits = {
                "x [m]": (reach[0], 0.05),
                "y [m]": (reach[1], 0.05),
                "yaw [rad]": (math.pi, 0.1),
            }
            self._numbers = [
                gui.add_number(label, 0.0, min=-limit, max=limit, step=step)
                for label, (limit, step) in limits.items()
            ]
        self._flight, self._health, self._events = (
            _folder(gui, label) for label in ("Flight", "Model and craft", "Events")
        )
        self._shown = [0.0, 0.0, 0.0]

        async def entered(event: Any) -> None:
            if event.client is not None:  # entered by a user, not set by `show_set_point`
                wish(*(float(number.value) for number in self._numbers))

        for number in self._numbers:
            number.on_update(entered)

    def show_set_point(self, pose: Float[np.ndarray, " k"]) -> None:
        """Write x, y, yaw of the set point."""
        x, y, yaw = map(float, pose[:3])
        # A number that the user is entering stays until the set point changes.
        for k, value in enumerate((x, y, math.remainder(yaw, 2 * math.pi))):
            rounded = round(value, 3)
            if rounded != self._shown[k]:
                self._numbers[k].value = self._shown[k] = rounded

    def show(self, observer: Observer, hint: str) -> None:
        """Write gauges and events."""
        now = observer.clock.now
        self._hint.content = paragraph(hint)
        rates = [f"{observer.rates.get(stream, 0.0):.0f} Hz" for stream in ("pose", "command")]
        gauges = [Gauge("poses, commands", ", ".join(rates))]
        came, status, figures = observer.beats.get(FLY, (-math.inf, "", {}))
        if now - came < _GONE:
            gauges += [Gauge("controller", status), *timing_gauges(figures)]
            gauges += plan_gauges(*observer.beats.get(PLAN, (-math.inf, "", {})), now)
        else:
            gauges.append(Gauge("controller", "none"))
        self._flight.content = gauges_html(gauges)
        self._health.content = health_html(observer.health)
        newest = list(observer.events)[: -_SHOWN - 1 : -1]
        lines = [_event_html(event, now - came) for came, event in newest]
        self._events.content = "".join(lines) or paragraph("none yet")


def _folder(gui: viser.GuiApi, label: str) -> viser.GuiHtmlHandle:
    """Add a folder of text."""
    with gui.add_folder(label):
        return gui.add_html("")


class Gauge(NamedTuple):
    """A line with a name, a value in words, and a bar."""

    name: str
    value: str
    #: Length of the bar: 1 is a full one, more is drawn as too much, None is no bar.
    share: float | None = None


def gauges_html(gauges: list[Gauge]) -> str:
    """Lay gauges out, one a line."""
    style = (
        "width:100%;font-size:0.8em;line-height:1.35;padding:0 0.4em;border-spacing:0;"
        "font-variant-numeric:tabular-nums"
    )
    lines = "".join(
        f'<tr><td>{escape(name)}</td><td style="width:32%">{_bar(share)}</td>'
        f'<td style="text-align:right;white-space:nowrap">{escape(value)}</td></tr>'
        for name, value, share in gauges
    )
    return f'<table style="{style}">{lines}</table>'


def timing_gauges(figures: Mapping[str, str]) -> list[Gauge]:
    """Return gauges of a controller's heartbeat: how it keeps its time."""
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


def plan_gauges(came: float, status: str, figures: Mapping[str, str], now: float) -> list[Gauge]:
    """Return what a predictive law said last of its plan: how it ended, and its active limits."""
    if now - came >= _GONE:
        return []
    return [Gauge("plan", status), Gauge("limits ahead", figures.get("limits") or "none")]


def health_html(health: Health) -> str:
    """Lay out errors by channel, and what propellers and delay contribute to them."""
    found = health.found
    if not health.flying or not found.predictions:
        return paragraph(str(health))
    x, y, yaw = found.error.tolist()
    words = f"{1e3 * x:.1f} mm", f"{1e3 * y:.1f} mm", f"{yaw:.3f} rad"
    lengths = (x, y, yaw) / np.array(_FULL_ERROR)
    errors = map(Gauge, ("x", "y", "yaw"), words, lengths.tolist())
    *thrusts, (late, sd) = np.column_stack([found.value, found.deviation]).tolist()
    words = [f"{100 * share:.0f} ± {100 * deviation:.0f} %" for share, deviation in thrusts]
    words.append(f"{1e3 * late:+.1f} ± {1e3 * sd:.1f} ms")
    causes = [
        Gauge(name, text, share) if known else Gauge(name, "not known: little excitation")
        for name, text, share, known in zip(
            (*health.motors, "delay"), words, found.share.tolist(), health.known, strict=True
        )
    ]
    findings = "".join(paragraph(finding, _WARNING) for finding in health.findings)
    return (
        paragraph(f"Errors after {HORIZON:g} s (bar: of 16 mm, 0.5 rad)")
        + gauges_html(list(errors))
        + paragraph("Thrust and delay against the model's (bar: of the squared error)")
        + gauges_html(causes)
        + (findings or paragraph("nothing that deviates from the model"))
    )


def _event_html(event: Any, age: float) -> str:
    """Lay out an event that came some time ago [s]."""
    severe, notable = (event.level >= EVENT_LEVELS[level] for level in ("error", "warning"))
    color = _ERROR if severe else _WARNING if notable else "inherit"
    return paragraph(f"{age:.0f} s ago, {event.name}: {event.msg}", color)


def paragraph(text: str, color: str = "inherit") -> str:
    """Lay out a line of text."""
    style = f"margin:0.15em 0.5em;font-size:0.8em;color:{color}"
    return f'<p style="{style}">{escape(text)}</p>'


def _bar(share: float | None) -> str:
    """Lay out a bar, if there is one."""
    if share is None or not math.isfinite(share):
        return ""
    color, percent = _BAR if share <= 1 else _BAR_TOO_LONG, 100 * min(max(share, 0.0), 1.0)
    return (
        f'<div style="background:{_BAR_GROUND};height:0.6em">'
        f'<div style="background:{color};height:100%;width:{percent:.0f}%"></div></div>'
    )
