"""The live view: the graph on one side, a page in the browser on the other."""

from __future__ import annotations

import contextlib
import io
import os
import socket
from collections.abc import Iterator
from importlib.util import find_spec
from typing import Any

import numpy as np
from jaxtyping import Float

from airpuck.boundary import numbers
from airpuck.boundary.errors import InputError
from airpuck.craft.table import Table
from airpuck.flight.clock import Every
from airpuck.live.plan import NAME as PLAN
from airpuck.live.process import Outbox, Process
from airpuck.live.settings import LiveSettings
from airpuck.live.watch import Observer
from airpuck.model.model_file import Model
from airpuck.web.panel import Panel
from airpuck.web.same_origin import same_origin_only
from airpuck.web.scene import Scene

NAME = "airpuck view"
#: Time between pictures, and between gauges [s].
_PICTURE, _GAUGES = 0.04, 0.5
#: Thrusts are drawn while commands are no older than this [s].
_COMMANDED = 0.5
#: A plan is drawn for so long [s].
_PLANNED_LAST = 0.5
#: The controller's process comes first.
_NICE = 5
#: How to move the set point, or why that has no effect.
_FREE = "Drag the yellow ring, turn it by its knob, or enter numbers."
_PLANNED = "The controller follows a plan of its own; airpuck fly-topic follows this one."


def view_live(
    model: Model,
    settings: LiveSettings | None = None,
    *,
    host: str = "127.0.0.1",
    port: int = 8080,
    table: Table | None = None,
) -> dict[str, Any]:
    """Serve a page that shows the craft as it flies, until its time is over, SIGINT or SIGTERM.

    Parameters
    ----------
    model : Model
        What the craft is believed to be.
    settings : LiveSettings, optional
        How to join the graph, and for how long.
    host : str, default "127.0.0.1"
        Address to serve at.
    port : int, default 8080
        Port to serve at.
    table : Table, optional
        By default the authors'.

    Returns
    -------
    dict
        Figures for ``--json``.

    Raises
    ------
    InputError
        If viser is not installed, the address is not free, or the graph cannot be joined.
    """
    if find_spec("viser") is None:
        raise InputError("the live view needs viser: pip install viser")
    _check_free(host, port)
    with Process(NAME, settings or LiveSettings()) as process:
        os.nice(_NICE)
        with _served(host, port) as server:
            page = _Page(server, process, model, table or Table())
            process.start(f", at http://{host}:{port}")
            return page.run()


class Wishes:
    """The set point that the user wants; written by the page's threads, read by the loop."""

    def __init__(self, reach: tuple[float, float]) -> None:
        self._reach = np.array(reach)
        #: The last wish: x, y, yaw, at rest; None before the first. It is replaced, never changed.
        self.newest: Float[np.ndarray, " 6"] | None = None

    def put(self, x: float, y: float, yaw: float) -> None:
        """Take note of a wish, moved inside the rails."""
        if np.isfinite([x, y, yaw]).all():
            place = np.clip([x, y], -self._reach, self._reach)
            self.newest = np.array([*place, yaw, 0.0, 0.0, 0.0])


class _Page:
    """One page, and what moves on it."""

    def __init__(self, server: Any, process: Process, model: Model, table: Table) -> None:
        reach = table.reach(model.vehicle.radius_m)
        self._server, self._process = server, process
        self._wishes = Wishes(reach)
        self._references = Outbox(process, "reference")
        self._observer = Observer(process, model)
        self._scene = Scene(server, model, table, self._wishes.put)
        self._panel = Panel(server, reach, self._wishes.put)
        self._gauges = Every(_GAUGES)

    def run(self) -> dict[str, Any]:
        """Show what happens, until the end; return the figures for ``--json``."""
        clock, sent = self._process.clock, None
        while self._process.goes_on:
            clock.sleep_until(clock.now + _PICTURE)
            for pose in self._observer.look():
                self._scene.add_pose(pose)
            wish = self._wishes.newest
            if wish is not None and wish is not sent:
                self._references.send(wish)
                sent = wish
            self._references.remind()
            self._draw(clock.now)
        return self._observer.to_json()

    def _draw(self, now: float) -> None:
        """Bring the page up to date."""
        newest = self._observer.newest
        pose = newest.get("pose")
        planned = bool(self._process.graph.publishers(self._process.topics.reference))
        # The user's own wish is newer than what has come back of it.
        wanted = None if planned else self._wishes.newest
        if wanted is None:
            wanted = newest.get("reference", pose)
        with self._server.atomic():
            if pose is not None:
                commanded = self._observer.age("command") < _COMMANDED
                self._scene.show(pose, newest.get("command") if commanded else None)
            if wanted is not None:
                self._scene.show_set_point(wanted)
            fresh = self._observer.age("plan") < _PLANNED_LAST
            bound = self._observer.beats.get(PLAN, (0.0, "", {}))[2].get("bound by", "")
            self._scene.show_plan(self._observer.plan if fresh else None, bound)
            # Not more often: a slow browser would write over what is being entered.
            if self._gauges.begins(now):
                if wanted is not None:
                    self._panel.show_set_point(wanted)
                self._panel.show(self._observer, _PLANNED if planned else _FREE)


@contextlib.contextmanager
def _served(host: str, port: int) -> Iterator[Any]:
    """Serve a page; what viser prints must not mix with figures on standard output."""
    import viser

    with contextlib.redirect_stdout(io.StringIO()), same_origin_only(host):
        server = viser.ViserServer(host, port, label="airpuck", verbose=False)
    try:
        yield server
    finally:
        with contextlib.redirect_stdout(io.StringIO()):
            server.stop()


def _check_free(host: str, port: int) -> None:
    """Refuse an address that cannot be served at; viser would take another port."""
    numbers.PORT.check(port, "--port")
    try:
        socket.create_server((host, port)).close()
    except (OSError, UnicodeError) as error:
        why = getattr(error, "strerror", None) or "no address"
        raise InputError(
            f"cannot serve at {host}:{port} ({why}); give another --port or --host", field="--port"
        ) from error
