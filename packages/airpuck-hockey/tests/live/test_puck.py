"""A puck on the graph, of a twin in another process."""

import json
import signal
import struct
import time

import numpy as np
import pytest

from airpuck.craft.table import AirHockey
from airpuck.recording.message import StreamCodec
from airpuck_hockey.puck.puck_filter import PuckFilter
from tests.apparatus.arena import free_port
from tests.apparatus.processes import POSES, Process, Watch

pytestmark = [pytest.mark.slow, pytest.mark.realtime]

TOPIC, MALLET = "/optitrack/puck/pose", "/optitrack/mallet/pose"


def test_its_poses_are_published_and_a_filter_follows_them(domain):
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


def hear(page, condition, seconds=60.0):
    """Receive a page's messages until one meets a condition; return it."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        message = page.recv(timeout=seconds)
        if condition(message if isinstance(message, bytes) else json.loads(message)):
            return message
    raise AssertionError(f"no such message in {seconds:g} s")


def test_the_craft_plays_against_a_person_at_the_page(domain):
    pytest.importorskip("websockets")
    from websockets.sync.client import connect

    start = ["--pose", -0.85, 0, 0, "--puck", -0.3, 0.1, 0, 0, "--human", "page"]
    watch, port = Watch(domain), free_port()
    twin = Process("twin", "--quiet", *start, domain=domain)
    served = ["--no-browser", "--port", port]
    player = Process("play-live", *served, "--quiet", "--json", "-", domain=domain)
    try:
        said = "flying", "the puck is seen"
        watch.until(lambda: all(one in watch.events("play") for one in said), 120.0)
        with connect(f"ws://127.0.0.1:{port}/", compression=None) as page:
            hear(page, lambda one: not isinstance(one, bytes) and one.get("phase") == "play")
            before = len(watch.heard[MALLET])
            # Both move, each on its half.
            for k in range(150):
                place = (0.3, 0.3, 0.0) if k % 20 < 10 else (0.8, -0.3, 0.0)
                page.send(struct.pack("<Ifff", k, *place))
                watch.run(0.1)
                if len(watch.heard[MALLET]) > before + 800:
                    break
            state = hear(page, lambda one: isinstance(one, bytes))
            assert np.isfinite(np.frombuffer(state, "<f4", offset=16)).all()  # after the header
        player.signal(signal.SIGINT)
        code, out, _ = player.end()
    finally:
        twin.kill()
        player.kill()
        watch.close()
    assert code == 0
    figures = json.loads(out)
    assert sum(figures["score"]) == sum(figures["goals"]) <= figures["duration_s"]
    codec = StreamCodec("puck")
    crafts, mallets = (
        np.array([codec.decode(message.data)[1] for message in watch.heard[topic]])
        for topic in (POSES, MALLET)
    )
    assert np.ptp(crafts[:, :2], axis=0).max() > 0.02
    # If the machine is too busy to control the craft, it drifts.
    assert np.median(crafts[:, 0]) < -0.05
    assert np.ptp(mallets[:, :2], axis=0).min() > 0.2
    assert mallets[:, 0].min() > 0.0
