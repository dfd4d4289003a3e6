"""A fleet as processes on the graph: one twin, and a process for each craft."""

import itertools
import json
import math
import signal
import time

import numpy as np
import pytest

import airpuck
from airpuck.compute.process import prioritize
from airpuck.fleet.scenario import Fleet, FleetCraft, Scenario
from airpuck.live import fly
from airpuck.live.fleet import TOPIC, fly_in_fleet
from airpuck.live.graph import SENSOR, Graph
from airpuck.live.settings import LiveSettings
from airpuck.recording.message import StreamCodec

from ..apparatus.graph_in_memory import joined
from ..apparatus.processes import POSES, Process, until

#: Three craft cross below; the fourth flies along a rail, where it may coast.
PLACES = {
    "h0": ((-0.7, -0.05, 0.0), (0.7, -0.35, 0.5)),
    "h1": ((0.7, 0.42, 0.0), (-0.7, 0.42, 0.0)),
    "h2": ((0.7, -0.05, 0.0), (-0.7, -0.35, 0.0)),
    "h3": ((-0.7, -0.35, 0.0), (0.7, -0.05, 0.0)),
}
POSE = StreamCodec("pose")


@pytest.fixture
def scenario(tmp_path):
    """Write a slow scenario: on a busy machine a controller may pause, and its craft coasts.

    Rails hold a dead craft, so that it does not come back.
    """
    lines = ['twin = "twin.toml"', "speed_m_s = 0.2"]
    for name, (start, goal) in PLACES.items():
        lines += ["[[craft]]", f'name = "{name}"', f"start = {[*start]}", f"goal = {[*goal]}"]
    file = tmp_path / "four.toml"
    file.write_text("\n".join(lines))
    (tmp_path / "twin.toml").write_text(
        "[table]\nrestitution = 0.0\n[motion_capture]\nrate_hz = 100.0\n"
    )
    return file


class Poses:
    """The newest pose of each craft."""

    def __init__(self, domain):
        self.graph = Graph("poses", domain=domain)
        self._subscriptions = {
            name: self.graph.subscription(f"/{name}{POSES}", POSE.msgtype, POSE.types, SENSOR)
            for name in PLACES
        }
        self._newest = {}

    def __getitem__(self, name):
        for sample in self._subscriptions[name].take():
            self._newest[name] = POSE.decode(sample.data)[1]
        return self._newest.get(name, np.array(PLACES[name][0]))

    def off(self, name, place):
        """Return the distance of a craft from a place [m]."""
        return math.dist(self[name][:2], place[:2])


@pytest.mark.slow
@pytest.mark.realtime
def test_four_processes_fly_without_contact_although_one_is_killed(scenario, domain):
    poses, live = Poses(domain), sorted(set(PLACES) - {"h1"})
    twin = Process("twin-fleet", scenario, "--json", "-", domain=domain)
    craft = {n: Process("fly-fleet", scenario, "--as", n, domain=domain) for n in PLACES}
    try:
        start, goal = PLACES["h1"]
        # The others have priority as well; otherwise they would arrive before this test notices.
        prioritize(first=True)
        until(lambda: poses.off("h1", start) > 0.2, 240.0)
        craft["h1"].kill()
        assert poses.off("h1", goal) > 0.2  # in mid-flight
        until(lambda: all(poses.off(n, PLACES[n][1]) < 0.03 for n in live), 60.0)
        time.sleep(1.0)
        for name in live:  # they rest there; a controller that pauses lets its craft coast a little
            assert poses.off(name, PLACES[name][1]) < 0.05
            assert abs(poses[name][2] - PLACES[name][1][2]) < 0.5
        twin.signal(signal.SIGTERM)
        status, out, err = twin.end()
        assert status == 0, err
        assert json.loads(out)["contacts"] == []
    finally:
        prioritize(first=False)
        for process in (*craft.values(), twin):
            process.kill()
        poses.graph.close()


def test_a_craft_missing_from_the_scenario_is_reported_in_one_line(scenario):
    with pytest.raises(airpuck.InputError, match="h9"):
        fly_in_fleet(airpuck.read_fleet(scenario), "h9")


def test_each_craft_has_topics_in_its_own_namespace():
    from airpuck.recording.mapping import Topics

    names = [set(Topics().within(name).by_stream.values()) for name in PLACES]
    for one, other in itertools.combinations(names, 2):
        assert not one & other
    assert Topics().within("h0").pose == f"/h0{POSES}"


# On a graph in memory -----------------------------------------------------------------------------

TWO = {"h0": (-0.5, 0.2, 0.0), "h1": (0.5, -0.2, 0.0)}


@pytest.fixture
def pair_of_craft():
    craft = tuple(FleetCraft(name=n, start=s, goal=(-s[0], s[1], 0.0)) for n, s in TWO.items())
    return Fleet(Scenario(craft=craft, speed_m_s=0.2))


def flown(monkeypatch, fleet, name, *, others=(), places=TWO, later=0.0, seconds=1.3):
    """Fly one craft whose poses say that it stays where it is; return its graph and results."""
    monkeypatch.setattr(fly, "prioritize", lambda **_: None)
    graph, rng = joined(monkeypatch, later), np.random.default_rng(0)
    for at in np.arange(0.005, seconds, 0.01):
        for one, place in places.items():
            graph.publish(at, POSES, place + rng.normal(0, 5e-5, 3), f"/{one}")
    for other, its_graph in others:
        graph.replay(its_graph, f"/{other}/{TOPIC}")
    return graph, fly_in_fleet(fleet, name, LiveSettings(duration=seconds, quiet=True))


def test_all_craft_start_together_despite_different_clocks(monkeypatch, pair_of_craft):
    ready, found = flown(monkeypatch, pair_of_craft, "h1")
    assert (found["start_s"], found["messages"]) == (None, 0)
    assert "waits for h0" in ready.events[-2]
    first, found = flown(monkeypatch, pair_of_craft, "h0", others=[("h1", ready)], later=-0.2)
    assert found["messages"] > 10
    begins = first.clock.stamp_ns(found["start_s"])
    # A second after the last was ready: half a second after it flew, at 0.31 s of its clock.
    assert ready.clock.of(begins) == pytest.approx(1.81, abs=0.05)
    second, found = flown(monkeypatch, pair_of_craft, "h1", others=[("h0", first)])
    assert second.clock.stamp_ns(found["start_s"]) == pytest.approx(begins, abs=1e3)
    late, found = flown(monkeypatch, pair_of_craft, "h1", others=[("h0", first)], later=3.0)
    assert "the others have begun without this craft" in late.events
    assert found["start_s"] is None


def test_the_others_wait_for_a_craft_away_from_its_start(monkeypatch, pair_of_craft):
    ready, _ = flown(monkeypatch, pair_of_craft, "h1")
    beside = TWO | {"h0": (-0.4, 0.2, 0.0)}
    away, found = flown(monkeypatch, pair_of_craft, "h0", others=[("h1", ready)], places=beside)
    assert found["start_s"] is None
    assert "waits for h0" in away.events[-2] and "h1" not in away.events[-2]
