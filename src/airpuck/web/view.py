"""The live view: the graph on one side, a page in the browser on the other, and its panels."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from airpuck.boundary import numbers
from airpuck.craft.table import Table
from airpuck.deviation.significance import ModelError
from airpuck.flight.clock import DEADLINE, JITTER_P99, LATENCY_P99, Every
from airpuck.flight.health import HORIZON, Health
from airpuck.live.fly import NAME as FLY
from airpuck.live.process import EVENT_LEVELS, PLAN_NAME, Outbox, Process
from airpuck.live.settings import LiveSettings
from airpuck.live.watch import GONE, Observer
from airpuck.model.model_file import Model
from airpuck.web.page import Pages, served, table_of
from airpuck.web.requests import LOOPBACK, Wish, packed_state
from airpuck.web.server import PageKind

#: Number of events shown, the newest first.
_SHOWN = 12
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
    if now - came < GONE:
        gauges += [Gauge("controller", status), *timing_gauges(figures)]
        gauges += plan_gauges(*observer.beats.get(PLAN_NAME, (-math.inf, "", {})), now)
        gauges += [Gauge(f"found: {name}", text) for name, text in observer.found.items()]
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
    if now - came >= GONE:
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


NAME = "airpuck view"
#: The live view, which anyone may use.
VIEW_PAGE = PageKind("airpuck", "view", shared=True)
#: Time between states, and between gauges [s].
_STATE, _GAUGES = 1 / 60, 0.5
#: Maximum age of a pose that counts as current, of drawn thrusts, and of a drawn plan [s].
_SEEN, _COMMANDED, _PLANNED = 0.5, 0.5, 0.5
#: The controller's process comes first.
_NICE = 5
#: Instructions for moving the set point, or the reason why this has no effect.
_FREE = "Drag the yellow ring, turn it by its knob, or enter numbers."
_FIXED = "The controller follows a plan of its own; airpuck fly --follow follows this one."
#: No puck, no mallet.
_NOTHING, _NOWHERE = (0.0, 0.0, 0.0), (math.nan, math.nan, 0.0, 0.0)


def view_live(
    model: Model,
    settings: LiveSettings | None = None,
    *,
    host: str = LOOPBACK,
    port: int = 8080,
) -> dict[str, Any]:
    """Serve a page that shows the craft in flight, until the time is over, SIGINT or SIGTERM.

    Parameters
    ----------
    model : Model
        Model of the craft.
    settings : LiveSettings, optional
        How to join the graph, and for how long.
    host : str, default "127.0.0.1"
        Address to serve at.
    port : int, default 8080
        Port to serve at.

    Returns
    -------
    dict
        Results for ``--json``.

    Raises
    ------
    InputError
        If websockets is not installed, the address is not free, or the graph cannot be joined.
    """
    numbers.PORT.check(port, "--port")
    table = Table()
    hello = view_hello(model, table)
    with (
        served(host, port, hello, page=VIEW_PAGE, waits=False) as pages,
        Process(NAME, settings or LiveSettings()) as process,
    ):
        os.nice(_NICE)
        view = _GraphView(pages, process, model, table.reach(model.vehicle.radius_m))
        process.start(f", at {pages.url}")
        return view.run()


def view_hello(model: Model, table: Table) -> dict[str, Any]:
    """Return the first message to a page of the live view, with the model's thrusts."""
    hello = table_of(model, table)
    hello["craft"]["thrust"] = model.dynamics.thrust.tolist()
    return hello | {"reach": table.reach(model.vehicle.radius_m)}


class _GraphView:
    """The data that the pages show, and their set point for the craft."""

    def __init__(
        self, pages: Pages, process: Process, model: Model, reach: tuple[float, float]
    ) -> None:
        self._pages, self._process, self._reach = pages, process, reach
        #: Set point from the pages: x, y [m], yaw [rad], at rest.
        self._wanted: Float[np.ndarray, " 6"] | None = None
        self._references = Outbox(process, "reference")
        self._observer = Observer(process, model)
        self._gauges = Every(_GAUGES)

    def run(self) -> dict[str, Any]:
        """Show events until the end; return the results for ``--json``."""
        clock, pages = self._process.clock, self._pages
        while self._process.goes_on and not pages.lost:
            clock.sleep_until(clock.now + _STATE)
            self._observer.look()
            _, wish = pages.hear()
            if wish is not None:
                self._wanted = inside(wish, self._reach)
                self._references.send(self._wanted)
            self._references.remind()
            self._show(clock.now)
        if pages.lost:
            self._process.events.log("error", "the page server has ended")
        return {**self._observer.to_json(), "page_server_ended": pages.lost}

    def _show(self, now: float) -> None:
        """Bring the pages up to date."""
        observer, pages = self._observer, self._pages
        newest, topics = observer.newest, self._process.topics
        pose, commanded = newest.get("pose"), observer.age("command") < _COMMANDED
        if pose is not None:
            commands = newest["command"].tolist() if commanded else []
            pages.show(packed_state(now, 0, True, _NOTHING, _NOWHERE, pose.tolist(), commands))
        fixed = bool(self._process.graph.publishers(topics.reference))
        # A page's set point is newer than the set point that the controller reports.
        wanted = None if fixed else self._wanted
        if wanted is None:
            wanted = newest.get("reference", pose)
        scene = {
            "seen": observer.age("pose") < _SEEN,
            "set_point": None if wanted is None else wanted[:3].round(4).tolist(),
            "plan": self._plan(),
            "hint": _FIXED if fixed else _FREE,
        }
        pages.update("scene", scene)
        if self._gauges.begins(now):
            pages.update("panel", panel(observer))

    def _plan(self) -> dict[str, Any] | None:
        """Return the path ahead and its active limits, while the plan is new."""
        path = self._observer.plan
        if path is None or self._observer.age("plan") > _PLANNED:
            return None
        bound = self._observer.beats.get(PLAN_NAME, (0.0, "", {}))[2].get("bound by", "")
        x, y = path.T.round(4).tolist()
        return {"x": x, "y": y, "bound": bound}


def inside(wish: Wish, reach: tuple[float, float]) -> Float[np.ndarray, " 6"]:
    """Return the set point from a page, moved inside the rails."""
    place = np.clip([wish.x, wish.y], np.negative(reach), reach)
    return np.array([*place, wish.yaw, 0.0, 0.0, 0.0])
