"""What comes in, over a graph made up for it."""

from __future__ import annotations

import time

import numpy as np
import pytest

from airpuck.live.clock import Clock
from airpuck.live.events import EventLog
from airpuck.live.graph import SENSOR, Graph, Sample
from airpuck.live.streams import Inbox
from airpuck.recording.message import StreamCodec

POSE = StreamCodec("pose")


class FakeGraph(Graph):
    """Hands out what lies in `waiting`."""

    def __init__(self):
        self.waiting = []

    def subscription(self, *_, **__):
        return self

    def take(self):
        taken, self.waiting = self.waiting, []
        return taken


class FakeEvents(EventLog):
    """Keeps what it is told."""

    def __init__(self):
        self.logged = []

    def log(self, level, text, *, kind=None):
        self.logged.append((level, text))


@pytest.fixture
def box():
    made = Inbox(FakeGraph(), "/pose", POSE, SENSOR, Clock(), FakeEvents())
    made.graph, made.logged = made._graph, made._events.logged
    return made


def pose(stamp_ns, x=0.5, sent_ns=None):
    return Sample(stamp_ns if sent_ns is None else sent_ns, POSE.encode(stamp_ns, (x, 0.0, 0.0)))


def test_poses_come_with_their_stamps_on_the_receivers_clock(box):
    stamp = box._clock.stamp_ns(box._clock.now)
    box.graph.waiting = [pose(stamp), pose(stamp, x=np.nan)]
    (first, values), (_, broken) = box.take()
    assert first == pytest.approx(box._clock.of(stamp))
    np.testing.assert_allclose(values, (0.5, 0.0, 0.0))
    assert np.isnan(broken[0])  # the guard's business
    assert (box.good, box.bad) == (2, 0)


def test_garbage_and_wrong_stamps_are_left_out_and_told(box):
    now = box._clock.stamp_ns(box._clock.now)
    box.graph.waiting = [Sample(now, b"\0\1\0\0nonsense"), pose(0), pose(now + 10**10), pose(now)]
    assert len(box.take()) == 1
    assert (box.good, box.bad) == (1, 3)
    assert [text.partition(":")[0] for _, text in box.logged] == [
        "garbage on /pose",
        "wrong or late stamp on /pose",
        "wrong or late stamp on /pose",
    ]


@pytest.mark.parametrize("ahead", [-3600.0, -0.3, 0.0, 0.3, 3600.0])
def test_commands_act_on_arrival_whatever_the_clock_of_their_sender_says(box, ahead):
    now = box._clock.stamp_ns(box._clock.now) + round(1e9 * ahead)
    box.graph.waiting = [pose(0, sent_ns=now), pose(now, x=np.inf)]
    (values,) = box.take_commands()
    np.testing.assert_allclose(values, (0.5, 0.0, 0.0))
    assert [text for _, text in box.logged] == ["numbers on /pose that are not finite"]


def test_commands_that_waited_for_a_process_that_stood_still_are_late(box):
    time.sleep(0.12)
    for _ in range(2):  # what lay in the system's buffers comes a little later
        box.graph.waiting = [pose(0)]
        assert box.take_commands() == []
    assert {text for _, text in box.logged} == {"late messages on /pose"}
    time.sleep(0.06)
    box.graph.waiting = [pose(0)]
    assert len(box.take_commands()) == 1
    assert (box.good, box.bad) == (1, 2)


def test_another_clock_is_told_once(box):
    for _ in range(40):
        box.graph.waiting = [pose(time.time_ns() - 3600 * 10**9)]
        box.take()
        time.sleep(0.02)
    assert [text for level, text in box.logged if "clock" in text] == [
        "the clock behind /pose differs by -3600.000 s; allowed for"
    ]
