"""Repeated events are reported once, and the last report is the current state."""

from __future__ import annotations

import pytest

from airpuck.live import events as module
from airpuck.live.events import EVENTS, EventLog
from airpuck.live.graph import Graph

from ..apparatus.processes import EVENT


class Paper(Graph):
    """A graph that records all messages."""

    def __init__(self) -> None:
        self.said: list[str] = []

    def publisher(self, topic, msgtype, types, quality):
        graph = self

        class Pen:
            def send(self, data: bytes) -> None:
                if topic == EVENTS:
                    graph.said.append(EVENT.decode(data).msg)

        return Pen()


@pytest.fixture
def clock(monkeypatch):
    """Time that stands still unless it is set."""

    class Clock:
        now = 100.0

    monkeypatch.setattr(module.time, "monotonic", lambda: Clock.now)
    return Clock


def test_what_toggles_is_counted_and_the_last_is_told_last(clock):
    graph = Paper()
    log = EventLog(graph, "fly", quiet=True)
    for k in range(50):
        clock.now += 0.01
        log.log("info", "flying") if k % 2 else log.log("error", "motors idle: no pose")
    assert graph.said == ["motors idle: no pose", "flying"]
    log.heartbeat("info", "exact", {})
    assert graph.said[2:] == ["motors idle: no pose (24 times)", "flying (24 times)"]
    assert log.counts == {"info": 25, "warning": 0, "error": 25}
    log.heartbeat("info", "exact", {})
    assert len(graph.said) == 4


@pytest.mark.parametrize("quiet", [True, False])
def test_events_are_printed_unless_the_log_is_quiet(quiet, clock, capsys):
    EventLog(Paper(), "fly", quiet=quiet).log("error", "motors idle: no pose")
    printed = capsys.readouterr()
    assert printed.err == ("" if quiet else "fly: motors idle: no pose\n")
    assert printed.out == ""


def test_one_repetition_is_told_in_its_own_words_and_after_a_second_at_once(clock):
    graph = Paper()
    log = EventLog(graph, "fly", quiet=True)
    log.log("info", "flying")
    log.log("info", "flying")
    log.flush()
    assert graph.said == ["flying", "flying"]
    clock.now += 1.01
    log.log("info", "flying")
    assert graph.said == ["flying"] * 3


def test_numbers_make_no_other_event_but_other_kinds_do(clock):
    graph = Paper()
    log = EventLog(graph, "fly", quiet=True)
    log.log("error", "pose jumped by 0.21 m and 0.00 rad")
    log.log("error", "pose jumped by 1.5 m and 12 rad")
    log.log("warning", "no message 1", kind="1")
    log.log("warning", "no message 2", kind="2")
    assert graph.said == [
        "pose jumped by 0.21 m and 0.00 rad",
        "pose jumped by 1.5 m and 12 rad",  # it happened before those that follow
        "no message 1",
        "no message 2",
    ]


def test_no_cause_is_told_more_than_twice_a_second_however_long_it_goes_on(clock):
    graph = Paper()
    log = EventLog(graph, "fly", quiet=True)
    for k in range(1000):
        clock.now += 0.01
        log.log("error", "motors idle: no pose")
        log.log("info", "flying")
        if k % 100 == 99:
            log.heartbeat("info", "exact", {})
    assert len(graph.said) <= 2 * 2 * 10
    assert log.counts["error"] == 1000
