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
from airpuck.live.graph import SENSOR, Graph
from airpuck.recording.message import StreamCodec

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
def test_four_processes_fly_and_nobody_touches_though_one_is_killed(scenario, domain):
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


def test_a_craft_that_is_not_in_the_scenario_is_named_in_one_line(scenario):
    from airpuck.live.fleet import fly_in_fleet

    with pytest.raises(airpuck.InputError, match="h9") as caught:
        fly_in_fleet(airpuck.read_fleet(scenario), "h9")
    assert "\n" not in str(caught.value)


def test_each_craft_has_its_topics_in_its_own_namespace():
    from airpuck.recording.mapping import Topics

    names = [set(Topics().within(name).by_stream.values()) for name in PLACES]
    for one, other in itertools.combinations(names, 2):
        assert not one & other
    assert Topics().within("h0").pose == f"/h0{POSES}"
