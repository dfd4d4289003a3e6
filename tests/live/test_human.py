"""The human at the twin's table, in this process, on a clock of the test's."""

from __future__ import annotations

import pytest

import airpuck
from airpuck.live.human import BEGINS, Human
from airpuck.live.process import LiveSettings, Process
from airpuck.physics.puck import PuckState


class Table:
    """A twin with a human, and what that says."""

    def __init__(self, process: Process, puck: PuckState, human: str = "easy") -> None:
        self.said: list[str] = []
        process.events.log = lambda level, text, **_: self.said.append(text)
        model = airpuck.read_model("paper:M3")
        start = {"pose": (-0.9, 0.4, 0.0), "puck": puck, "mallet": (BEGINS, 0.0)}
        self.twin = airpuck.Twin(model, **start, logs=False)
        self.human = Human(self.twin, process, human, 0)

    def run(self, until: float) -> None:
        """Let time pass."""
        while self.twin.now < until:
            self.twin.wait_until(self.twin.now + 0.005)
            self.human.act(self.twin.now)

    @property
    def puck(self):
        return self.twin.world.puck


@pytest.fixture(scope="module")
def process(domain):
    with Process("airpuck twin", LiveSettings(domain=domain, quiet=True)) as process:
        yield process


@pytest.fixture(scope="module")
def table(process) -> Table:
    return Table(process, PuckState(-0.7, 0.0, vx=-3.0))


def test_who_concedes_serves_a_second_later(table):
    table.run(0.2)
    assert table.puck.goal == -1
    table.run(1.0)
    assert table.puck.goal == -1
    table.run(1.3)
    assert table.said == ["the puck is served on the left"]
    assert table.puck.state.x == pytest.approx(-0.3, abs=0.01)
    assert abs(table.puck.state.y) <= 0.16


def test_a_puck_that_the_craft_leaves_alone_is_the_humans_after_fifteen_seconds(table):
    begin = table.twin.now
    table.run(begin + 14.9)
    assert table.puck.state.x < 0
    table.run(begin + 15.4)
    assert table.said == ["the puck is served on the left", "the puck is served on the right"]
