"""The page of a game on the ROS 2 graph: shows the graph's data, and can move the mallet."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from jaxtyping import Float

from airpuck import AirHockey, Measurement, Model, Pilot
from airpuck.extend import (
    Action,
    Every,
    MeasurementKind,
    Outbox,
    Pages,
    Process,
    Spectator,
    packed_state,
)
from airpuck_hockey.game.scorekeeper import NAMES, Score
from airpuck_hockey.player.player import Player
from airpuck_hockey.web.page import hello_of, thought_of

#: A body is shown for this long after its last pose [s].
_SEEN = 0.15
#: Period for checking whether the graph accepts a target for the mallet [s].
_LOOK = 0.5
#: Pose of a body without a known position.
_NOWHERE = np.full(3, math.nan)


def live_hello(model: Model, equipment: AirHockey) -> dict[str, Any]:
    """Return the first message to a page of a game on the graph, which cannot pause games."""
    return hello_of(model, equipment) | {"live": True, "levels": [], "names": NAMES}


class LivePage(Spectator):
    """Shows a player's flight on the pages, and sends their targets for the mallet; a `Spectator`.

    A page plays only if the process that publishes the poses of the mallet also subscribes to the
    mallet's target, as a twin with its human at the page does. Otherwise the human is at the table,
    and pages only show the game. A flight does not wait for its pages, and continues without them.
    """

    def __init__(self, pages: Pages, score: Score, level: str) -> None:
        self._pages = pages
        self._score, self._level = score, level
        self._look = Every(_LOOK)
        self._seated = self._plays = False
        #: Target of the mallet.
        self._wanted: tuple[float, float] | None = None
        #: The newest pose of each body, and the previous one: stamp [s], pose.
        self._poses: dict[MeasurementKind, list[tuple[float, Float[np.ndarray, " 3"]]]] = {}
        self._shown = -math.inf
        pages.say_status("starting", (0, 0), level)

    def begin(self, process: Process, pilot: Pilot) -> None:
        """Receive the participants; see `Spectator`."""
        assert isinstance(pilot, Player)
        self._process, self._player = process, pilot
        self._targets = Outbox(process, "mallet_target")

    def measured(self, measurement: Measurement) -> None:
        """Receive a pose; see `Spectator`."""
        if np.isfinite(measurement.values).all():
            one = measurement.stamp, measurement.values
            self._poses[measurement.kind] = [*self._poses.get(measurement.kind, [])[-1:], one]

    def after(self, action: Action) -> None:
        """Process the pages' requests, and send them the current state; see `Spectator`."""
        if self._pages.lost:
            return
        self._hear()
        self._tell(action)
        if self._pages.lost:
            self._wanted = None
            self._process.events.log("warning", "the page server has ended; the flight continues")
        if self._wanted is not None and self._plays:
            self._targets.send((*self._wanted, 0.0))

    def _hear(self) -> None:
        """Process the pages' requests."""
        orders, wish = self._pages.hear()
        for order in orders:
            if order["do"] in ("sit", "leave"):
                self._seated = order["do"] == "sit"
                self._wanted = None
        if self._look.begins(self._process.clock.now):
            self._plays = self._mallet_is_guided()
        if wish is not None and self._seated and self._plays:
            self._wanted = wish.x, wish.y

    def _mallet_is_guided(self) -> bool:
        """Return whether the process that publishes the mallet takes its target from pages."""
        graph, topics = self._process.graph, self._process.topics
        senders = {endpoint.participant for endpoint in graph.publishers(topics.mallet)}
        return bool(senders & graph.subscribers(topics.mallet_target))

    def _tell(self, action: Action) -> None:
        """Show all positions and announce rulings."""
        pages = self._pages
        newest = max((poses[-1][0] for poses in self._poses.values()), default=-math.inf)
        if newest > self._shown:
            self._shown = newest
            pages.show(self._state(newest, action))
        for kind, side in self._score.rulings:
            pages.say({"is": "event", "kind": kind, "side": side, "strength": 0.0})
        phase = "watch" if not self._plays else "play" if self._seated else "waiting"
        pages.say_status(phase, self._score.keeper.score, self._level)
        pages.think(lambda: thought_of(self._player, action.time))

    def _state(self, time: float, action: Action) -> bytes:
        """Return the message with all positions at a time; unseen bodies have no position."""
        seen = {kind: poses for kind, poses in self._poses.items() if time - poses[-1][0] < _SEEN}
        place = {kind: poses[-1][1] for kind, poses in seen.items()}
        moving = np.zeros(2)
        if len(seen.get("mallet", ())) == 2:
            (before, last), (now, here) = seen["mallet"]
            moving = (here - last)[:2] / (now - before) if now > before else moving
        return packed_state(
            time,
            0,
            "puck" not in place,
            place.get("puck", np.zeros(3)).tolist(),
            [*place.get("mallet", _NOWHERE)[:2].tolist(), *moving.tolist()],
            place.get("pose", _NOWHERE).tolist(),
            action.step.command.tolist(),
        )
