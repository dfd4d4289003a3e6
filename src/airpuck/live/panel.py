"""Gauges, set point and events beside the table in the browser."""

from __future__ import annotations

import math
from collections.abc import Callable
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from airpuck.flight.health import Health
from airpuck.live.fly import NAME as FLY
from airpuck.live.observer import Event, Observer

if TYPE_CHECKING:
    import viser

_COLORS = {"info": "inherit", "warning": "#b35900", "error": "#c00000"}
_SHOWN = 12
#: What is older counts as gone [s].
_GONE = 2.5
#: Figures of the controller's heartbeat, and what they are called here.
_FIGURES = {
    "pose_to_command_ms": "pose to command, ms",
    "pose_age_ms": "age of the pose, ms",
    "period_jitter_ms": "jitter, ms",
    "missed_deadlines": "missed deadlines",
}


class Panel:
    """What is written beside the table.

    Parameters
    ----------
    server : viser.ViserServer
        The page.
    reach : (float, float)
        Greatest | x | and | y | of a set point [m].
    wish : callable
        Is given x, y [m] and yaw [rad] whenever the user enters a set point.
    """

    def __init__(
        self,
        server: viser.ViserServer,
        reach: tuple[float, float],
        wish: Callable[[float, float, float], Any],
    ) -> None:
        gui = server.gui
        gui.configure_theme(
            control_layout="fixed", control_width="medium", show_logo=False, show_share_button=False
        )
        gui.set_panel_label("airpuck")
        with gui.add_folder("Set point"):
            self._hint = gui.add_html("")
            limits = (
                ("x [m]", reach[0], 0.05),
                ("y [m]", reach[1], 0.05),
                ("yaw [rad]", math.pi, 0.1),
            )
            self._numbers = [
                gui.add_number(label, 0.0, min=-limit, max=limit, step=step)
                for label, limit, step in limits
            ]
        with gui.add_folder("Flight"):
            self._flight = gui.add_html("")
        with gui.add_folder("Model and craft"):
            self._health = gui.add_html("")
        with gui.add_folder("Events"):
            self._events = gui.add_html("")

        def entered(event: Any) -> None:
            if event.client is not None:  # not by us
                x, y, yaw = (float(number.value) for number in self._numbers)
                wish(x, y, yaw)

        for number in self._numbers:
            number.on_update(entered)

    def show_set_point(self, pose: Float[np.ndarray, " k"]) -> None:
        """Write the set point.

        Parameters
        ----------
        pose : array, shape (k,)
            x, y [m], yaw [rad]; more is left aside.
        """
        yaw = math.remainder(float(pose[2]), 2 * math.pi)
        for number, value in zip(self._numbers, (float(pose[0]), float(pose[1]), yaw), strict=True):
            rounded = round(value, 3)
            if number.value != rounded:
                number.value = rounded

    def show(self, observer: Observer, health: Health, hint: str) -> None:
        """Write gauges and events.

        Parameters
        ----------
        observer : Observer
            What was seen.
        health : Health
            How the craft fares.
        hint : str
            On the set point.
        """
        sight, now = observer.sight, observer.clock.now
        self._hint.content = f'<p style="margin:0 0.6em">{escape(hint)}</p>'
        rows = [
            (f"{kind}s, Hz", f"{sight.rates.get(kind, 0.0):.0f}") for kind in ("pose", "command")
        ]
        beat = sight.beats.get(FLY)
        if beat is not None and now - beat[0] < _GONE:
            rows.append(("controller", beat[1]))
            rows += [(told, beat[2][key]) for key, told in _FIGURES.items() if key in beat[2]]
        else:
            rows.append(("controller", "none"))
        self._flight.content = _table(rows)
        self._health.content = _health(health)
        self._events.content = _list(list(sight.events)[: -_SHOWN - 1 : -1], now)


def _health(health: Health) -> str:
    """Errors of prediction, each propeller, delay."""
    found = health.found
    if not health.flying or not found.predictions:
        return f'<p style="margin:0 0.6em">{escape(str(health))}</p>'
    x, y, yaw = found.error.tolist()
    rows = [
        (
            f"error after {health.horizon:g} s",
            f"{1e3 * x:.1f} mm, {1e3 * y:.1f} mm, {yaw:.3f} rad",
        )
    ]
    rows += [
        (name, f"{100 * e:.0f} % ± {100 * sd:.0f} %")
        for name, e, sd in zip(health.motors, found.effectiveness, found.deviation, strict=True)
    ]
    rows.append(
        (
            "delay, beyond the model's",
            f"{1e3 * found.delay:.1f} ± {1e3 * found.delay_deviation:.1f} ms",
        )
    )
    told = "".join(
        f'<p style="margin:0.2em 0.6em;color:{_COLORS["warning"]}"><b>{escape(finding)}</b></p>'
        for finding in health.findings
    )
    return _table(rows) + (told or '<p style="margin:0.2em 0.6em">as the model says</p>')


def _table(rows: list[tuple[str, str]]) -> str:
    """Lay names and figures out."""
    cells = "".join(
        f'<tr><td>{escape(name)}</td><td style="text-align:right">{escape(value)}</td></tr>'
        for name, value in rows
    )
    style = "width:100%;font-size:0.85em;padding:0 0.4em;font-variant-numeric:tabular-nums"
    return f'<table style="{style}">{cells}</table>'


def _list(events: list[Event], now: float) -> str:
    """Lay events out, the newest first."""
    items = "".join(
        f'<p style="margin:0.2em 0.6em;font-size:0.8em;color:{_COLORS[event.level]}">'
        f"{now - event.time:.0f} s ago, {escape(event.name)}: {escape(event.text)}</p>"
        for event in events
    )
    return items or '<p style="margin:0 0.6em">none yet</p>'
