"""A puck on the graph, of a twin in another process."""

import numpy as np

from airpuck.craft.table import AirHockey
from airpuck.hockey.puck_filter import PuckFilter
from airpuck.recording.message import StreamCodec

from .processes import Process, Watch

TOPIC = "/optitrack/puck/pose"


def test_its_poses_are_on_the_graph_and_a_filter_follows_them(domain):
    twin = Process("twin", "--quiet", "--puck", 0.6, 0.3, 0.0, 1.0, domain=domain)
    watch = Watch(domain)
    try:
        watch.until(lambda: len(watch.heard[TOPIC]) > 240, 60.0)
    finally:
        twin.kill()
        watch.close()
    codec, found, stamps = StreamCodec("puck"), PuckFilter(AirHockey()), []
    for message in watch.heard[TOPIC]:
        stamp, pose = codec.decode(message.data)
        stamps.append(stamp / 1e9)
        found.pose(stamps[-1] - stamps[0], pose)
    assert abs(np.median(np.diff(stamps)) - 1 / 240) < 1e-4
    # Along y at 1 m/s, between rails 1.1 m apart: no hit, and a bounce where there was one.
    assert not [event for event in found.events if event.kind == "hit"]
    assert 0.3 < abs(found.belief.mean[4]) < 1.01
    assert abs(found.belief.mean[0] - 0.6) < 1e-3
