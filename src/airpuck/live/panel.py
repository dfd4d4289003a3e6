"""Gauges, set point and events beside the table in the browser."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from airpuck.flight.health import Health
from airpuck.live.fly import NAME as FLY
from airpuck.live.gauges import Gauge, gauges_html, health_html, paragraph, timing_gauges
from airpuck.live.observer import Event, Observer

if TYPE_CHECKING:
    import viser

_COLORS = {"info": "inherit", "warning": "#b35900", "error": "#c00000"}
_SHOWN = 12
#: What is older counts as gone [s].
_GONE = 2.5


class Panel:
    """What is written beside the table."""

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

        self._shown = [0.0, 0.0, 0.0]

        async def entered(event: Any) -> None:
            if event.client is not None:  # not by us
                x, y, yaw = (float(number.value) for number in self._numbers)
                wish(x, y, yaw)

        for number in self._numbers:
            number.on_update(entered)

    def show_set_point(self, pose: Float[np.ndarray, " k"]) -> None:
        """Write the set point."""
        yaw = math.remainder(float(pose[2]), 2 * math.pi)
        rounded = [round(value, 3) for value in (float(pose[0]), float(pose[1]), yaw)]
        # What the user is entering is left alone until the set point follows.
        for k, number in enumerate(self._numbers):
            if rounded[k] != self._shown[k]:
                number.value = self._shown[k] = rounded[k]

    def show(self, observer: Observer, health: Health, hint: str) -> None:
        """Write gauges and events."""
        sight, now = observer.sight, observer.clock.now
        self._hint.content = paragraph(hint)
        rates = [f"{sight.rates.get(kind, 0.0):.0f}" for kind in ("pose", "command")]
        gauges = [Gauge("poses, commands", f"{rates[0]} Hz, {rates[1]} Hz")]
        beat = sight.beats.get(FLY)
        if beat is not None and now - beat[0] < _GONE:
            gauges += [Gauge("controller", beat[1]), *timing_gauges(beat[2])]
        else:
            gauges.append(Gauge("controller", "none"))
        self._flight.content = gauges_html(gauges)
        self._health.content = health_html(health)
        newest = list(sight.events)[: -_SHOWN - 1 : -1]
        told = [paragraph(_words(event, now), _COLORS[event.level]) for event in newest]
        self._events.content = "".join(told) or paragraph("none yet")


def _words(event: Event, now: float) -> str:
    """Say when who said what."""
    return f"{now - event.time:.0f} s ago, {event.name}: {event.text}"
