"""The score on a graph: the flying process detects goals and reports them."""

import numpy as np
import pytest

from airpuck import AirHockey, PuckState
from airpuck.craft.vehicle import default_vehicle
from airpuck.flight.clock import Clock
from airpuck.flight.pulses import PulseTest
from airpuck.live import fly
from airpuck.live.graph import SENSOR, Graph
from airpuck.live.safety import half_of
from airpuck.live.settings import LiveSettings
from airpuck.physics.puck_on_table import PuckOnTable
from airpuck.recording.message import StreamCodec
from airpuck_hockey.game.scorekeeper import Score

pytestmark = [pytest.mark.slow, pytest.mark.realtime]

VEHICLE = default_vehicle()
PLAY = AirHockey()
FRAME = 1 / 240


class Pilot(PulseTest):
    """A pilot that also receives poses of the puck."""

    sight = "seen"
    watches = ("puck",)


class Table:
    """Cameras on the graph, which deliver the frames of a game up to the present."""

    def __init__(self, domain: int) -> None:
        self.graph, self._clock = Graph("table", domain=domain), Clock()
        self._send = {}
        for kind in ("pose", "puck"):
            codec, topic = StreamCodec(kind), f"/optitrack/{kind.replace('pose', 'drone')}/pose"
            publisher = self.graph.publisher(topic, codec.msgtype, codec.types, SENSOR)
            self._send[kind] = codec, publisher
        self.shots = {-1: 0, 1: 0}
        self._puck = PuckOnTable(PLAY, PuckState(0.0, 0.0), logs=False)
        self._random, self._frame, self._next = np.random.default_rng(0), 0, 1.0

    def look(self, time: float) -> bool:
        """Send the frames until now; one shot each second, at either goal in alternation."""
        while self._frame * FRAME < self._clock.now:
            now = self._frame * FRAME
            self._puck.run(now)
            if now > self._next:
                self._next += 1.0
                side = 1 if self._next % 2 else -1
                self.shots[side] += 1
                self._puck.place(PuckState(0.4 * side, 0.1, vx=2.0 * side))
            if not self._puck.goal:
                self._see("puck", now, self._puck.state[:3])
            self._see("pose", now, (-0.8, 0.0, 0.0))
            self._frame += 1
        return time > 5.7

    def _see(self, kind, now, pose) -> None:
        codec, publisher = self._send[kind]
        noisy = np.array(pose) + self._random.normal(0, 5e-5, 3)
        publisher.send(codec.encode(self._clock.stamp_ns(now), noisy))


def test_goals_are_detected_announced_and_counted(domain, monkeypatch, capsys):
    monkeypatch.setattr(fly, "prioritize", lambda **_: None)
    table = Table(domain)
    try:
        figures = fly.fly_live(
            lambda: Pilot(VEHICLE),
            VEHICLE,
            half_of(PLAY.table, VEHICLE.radius_m, -1),
            LiveSettings(domain=domain, duration=20.0),
            over=table.look,
            warm_up=False,
            spectators=[Score(PLAY)],
        )
    finally:
        table.graph.close()
    said = [line for line in capsys.readouterr().err.splitlines() if "goal for" in line]
    left, right = figures["score"]
    # A machine that stalls for a moment misses some of them.
    assert left + right >= 2
    assert left <= table.shots[1]
    assert right <= table.shots[-1]
    assert len(said) == left + right
    assert said[-1].endswith(f", {left} : {right}")
    assert (figures["goals"], figures["fouls"], figures["games"]) == ([left, right], [0, 0], 1)
