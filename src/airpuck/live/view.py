"""The live view: the graph on one side, a page in the browser on the other."""

from __future__ import annotations

import contextlib
import io
import os
from collections.abc import Iterator
from importlib.util import find_spec
from threading import Lock
from typing import Any

import numpy as np
from jaxtyping import Float

from airpuck.boundary.errors import InputError
from airpuck.craft.table import Table
from airpuck.live.events import EventLog
from airpuck.live.graph import STATE, Graph
from airpuck.live.observer import Observer
from airpuck.live.panel import Panel
from airpuck.live.process import Ending, orderly, settle_memory
from airpuck.live.scene import Scene
from airpuck.model.model_file import Model
from airpuck.recording.message import StreamCodec
from airpuck.recording.topics import Topics

NAME = "airpuck view"
#: Time between pictures, gauges, and reminders of the set point for those that come late [s].
_PICTURE, _GAUGES, _REMIND = 0.04, 0.5, 1.0
#: The controller's process comes first.
_NICE = 5


class Wishes:
    """The set point that the user wants; written by the page's threads, read by the loop."""

    def __init__(self, reach: tuple[float, float]) -> None:
        self._reach, self._lock = reach, Lock()
        self._wish: Float[np.ndarray, " 6"] | None = None
        self._new = False

    def put(self, x: float, y: float, yaw: float) -> None:
        """Take note of a wish."""
        if not np.isfinite([x, y, yaw]).all():
            return
        place = np.clip([x, y], -np.array(self._reach), self._reach)
        with self._lock:
            self._wish, self._new = np.array([*place, yaw, 0.0, 0.0, 0.0]), True

    @property
    def newest(self) -> Float[np.ndarray, " 6"] | None:
        """The last wish: x, y, yaw, at rest; None before the first."""
        return self._wish

    def take(self) -> Float[np.ndarray, " 6"] | None:
        """Return the wish if it came since the last call."""
        with self._lock:
            new, self._new = self._new, False
            return self._wish if new else None


def view_live(
    model: Model,
    *,
    host: str = "127.0.0.1",
    port: int = 8080,
    table: Table | None = None,
    topics: Topics | None = None,
    domain: int | None = None,
    interface: str | None = None,
    duration: float = float("inf"),
    quiet: bool = False,
) -> dict[str, Any]:
    """Serve a page that shows the craft as it flies, until SIGINT or SIGTERM."""
    if find_spec("viser") is None:
        raise InputError("the live view needs viser: pip install 'airpuck[view]'")
    _check_free(host, port)
    graph = Graph(NAME, domain=domain, interface=interface)
    try:
        with orderly() as ending:
            os.nice(_NICE)
            events = EventLog(graph, NAME, quiet=quiet)
            with _served(host, port) as server:
                page = _Page(server, graph, model, table or Table(), topics or Topics())
                settle_memory()
                events.tell("info", f"on domain {graph.domain}, at http://{host}:{port}")
                return page.run(duration, ending)
    finally:
        graph.close()


class _Page:
    """One page, and what moves on it."""

    def __init__(
        self,
        server: Any,
        graph: Graph,
        model: Model,
        table: Table,
        topics: Topics,
    ) -> None:
        reach = table.reach(model.vehicle.radius_m)
        self._server, self._graph, self._topics = server, graph, topics
        self._wishes = Wishes(reach)
        self._codec = StreamCodec("reference")
        self._references = graph.publisher(
            topics.reference, self._codec.msgtype, self._codec.types, STATE
        )
        self._observer = Observer(graph, model, topics)
        self._scene = Scene(server, model, table, self._wishes.put)
        self._panel = Panel(server, reach, self._wishes.put)
        self._said = self._told = 0.0

    def run(self, duration: float, ending: Ending) -> dict[str, Any]:
        """Show what is, until the end; return the last figures."""
        clock = self._observer.clock
        while not ending.asked and clock.now < duration:
            clock.sleep_until(clock.now + _PICTURE)
            for pose in self._observer.look():
                self._scene.add_pose(pose)
            self._speak(clock.now)
            self._draw(clock.now)
        return self._observer.to_json()

    def _speak(self, now: float) -> None:
        """Publish what the user wants."""
        wish = self._wishes.take()
        if wish is None and now - self._said > _REMIND:
            wish = self._wishes.newest
        if wish is None:
            return
        self._said = now
        self._references.send(self._codec.encode(self._observer.clock.now_ns, wish))

    def _draw(self, now: float) -> None:
        """Bring the page up to date."""
        sight = self._observer.sight
        # The user's own wish is newer than what has come back of it.
        wanted = self._wishes.newest
        planned = bool(self._graph.publishers(self._topics.reference))
        if planned or wanted is None:
            wanted = sight.reference
        if wanted is None:
            wanted = sight.pose
        with self._server.atomic():
            if sight.pose is not None:
                commanded = self._observer.age("command") < 0.5
                self._scene.show(sight.pose, sight.command if commanded else None)
            if wanted is not None:
                self._scene.show_set_point(wanted)
            if now - self._told >= _GAUGES:
                self._told = now
                # No more often: a slow browser would write over what is being entered.
                if wanted is not None:
                    self._panel.show_set_point(wanted)
                self._panel.show(self._observer, self._observer.health, _hint(planned))


@contextlib.contextmanager
def _served(host: str, port: int) -> Iterator[Any]:
    """Serve a page; what viser would say on standard output has no place among figures."""
    import viser

    with contextlib.redirect_stdout(io.StringIO()):
        server = viser.ViserServer(host, port, label="airpuck", verbose=False)
    try:
        yield server
    finally:
        with contextlib.redirect_stdout(io.StringIO()):
            server.stop()


def _hint(planned: bool) -> str:
    """Say whether dragging helps."""
    if planned:
        return "The controller follows a plan of its own; airpuck fly --topic follows this one."
    return "Drag the yellow ring, turn it by its knob, or enter numbers."


def _check_free(host: str, port: int) -> None:
    """Refuse an address that cannot be served at; viser would take another port."""
    import socket

    try:
        with socket.socket() as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind((host, port))
    except OSError as error:
        raise InputError(
            f"cannot serve at {host}:{port} ({error.strerror}); give another --port", field="--port"
        ) from error
