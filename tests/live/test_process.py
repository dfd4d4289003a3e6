from __future__ import annotations

import os
import signal
import time
from threading import Event, Thread

import numpy as np
import pytest

from airpuck.boundary.errors import InputError
from airpuck.live import process
from airpuck.live.graph import SENSOR, Graph
from airpuck.live.process import LiveSettings, Process, unhurried

from .processes import CODECS, COMMANDS

COMMAND = CODECS[COMMANDS]


@pytest.fixture
def first(domain):
    """Who is on the graph already."""
    made = Graph("first", domain=domain)
    yield made
    made.close()


@pytest.fixture
def second(domain, first):
    """A process that comes later."""
    with Process("second", LiveSettings(domain=domain, quiet=True)) as made:
        yield made


def test_who_sends_is_refused_for_within_a_second(first, second):
    commands = first.publisher(COMMANDS, COMMAND.msgtype, COMMAND.types, SENSOR)
    end = Event()

    def send() -> None:
        while not end.wait(0.01):
            commands.send(COMMAND.encode(time.time_ns(), np.full(6, 0.03)))

    sender = Thread(target=send)
    sender.start()
    try:
        began = time.monotonic()
        with pytest.raises(InputError, match=r"another controller already: first \(process"):
            second.refuse_second("command", COMMAND.columns, "controller")
        assert time.monotonic() - began < 1.0
    finally:
        end.set()
        sender.join()


def test_who_is_silent_is_waited_for_as_long_as_one_who_was_killed(first, second, monkeypatch):
    monkeypatch.setattr(process, "LEASE", -0.2)
    first.publisher(COMMANDS, COMMAND.msgtype, COMMAND.types, SENSOR)
    began = time.monotonic()
    with pytest.raises(InputError, match="another controller already: first"):
        second.refuse_second("command", COMMAND.columns, "controller")
    assert 0.8 < time.monotonic() - began < 2.0


def test_nobody_is_there(second):
    second.refuse_second("command", COMMAND.columns, "controller")
    assert second.graph.age >= 0.6
    began = time.monotonic()
    second.refuse_second(
        "command", COMMAND.columns, "controller"
    )  # who has looked around need not again
    assert time.monotonic() - began < 0.3


def test_priority_is_given_back():
    before = os.sched_getscheduler(0)
    with unhurried():
        assert os.sched_getscheduler(0) == os.SCHED_OTHER
    assert os.sched_getscheduler(0) == before


def test_a_signal_ends_the_loop_and_not_the_process(second):
    before = signal.getsignal(signal.SIGINT)
    with Process("third", LiveSettings(domain=second.settings.domain, quiet=True)) as third:
        third.start("")
        assert third.goes_on
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(0.01)
        assert not third.goes_on
    assert signal.getsignal(signal.SIGINT) is before


@pytest.mark.parametrize(
    ("wrong", "field"),
    [
        ({"domain": 233}, "domain"),
        ({"interface": "wifi7"}, "interface"),
        ({"duration": 0}, "duration"),
    ],
)
def test_settings_that_cannot_be_are_refused(wrong, field):
    with pytest.raises(InputError, match=f"--{field}"):
        LiveSettings(**wrong)
