"""The live view: the graph on one side, a page in the browser on the other."""

from __future__ import annotations

import math
import os
from typing import Any

import numpy as np
from jaxtyping import Float

from airpuck.boundary import numbers
from airpuck.craft.table import Table
from airpuck.flight.clock import Every
from airpuck.live.plan import NAME as PLAN
from airpuck.live.process import Outbox, Process
from airpuck.live.settings import LiveSettings
from airpuck.live.watch import Observer
from airpuck.model.model_file import Model
from airpuck.web.address import LOOPBACK
from airpuck.web.messages import Wish, packed_state
from airpuck.web.page import Pages, served, table_of
from airpuck.web.panel import panel
from airpuck.web.server import PageKind

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
_FIXED = "The controller follows a plan of its own; airpuck fly-topic follows this one."
#: No puck, no mallet.
_NOTHING, _NOWHERE = (0.0, 0.0, 0.0), (math.nan, math.nan, 0.0, 0.0)


def view_live(
    model: Model,
    settings: LiveSettings | None = None,
    *,
    host: str = LOOPBACK,
    port: int = 8080,
    table: Table | None = None,
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
    table : Table, optional
        Names of the topics; by default the authors'.

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
    table = table or Table()
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
        pages.update(
            "scene",
            {
                "seen": observer.age("pose") < _SEEN,
                "set_point": None if wanted is None else wanted[:3].round(4).tolist(),
                "plan": self._plan(),
                "hint": _FIXED if fixed else _FREE,
            },
        )
        if self._gauges.begins(now):
            pages.update("panel", panel(observer))

    def _plan(self) -> dict[str, Any] | None:
        """Return the path ahead and its active limits, while the plan is new."""
        path = self._observer.plan
        if path is None or self._observer.age("plan") > _PLANNED:
            return None
        bound = self._observer.beats.get(PLAN, (0.0, "", {}))[2].get("bound by", "")
        x, y = path.T.round(4).tolist()
        return {"x": x, "y": y, "bound": bound}


def inside(wish: Wish, reach: tuple[float, float]) -> Float[np.ndarray, " 6"]:
    """Return the set point from a page, moved inside the rails."""
    place = np.clip([wish.x, wish.y], np.negative(reach), reach)
    return np.array([*place, wish.yaw, 0.0, 0.0, 0.0])
