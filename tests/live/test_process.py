from __future__ import annotations

import os
import time
from threading import Event, Thread

import numpy as np
import pytest

from airpuck.boundary.errors import InputError
from airpuck.live import process
from airpuck.live.graph import SENSOR
from airpuck.live.process import refuse_second, unhurried

from .processes import CODECS, COMMANDS

COMMAND = CODECS[COMMANDS]


def test_who_sends_is_refused_for_within_a_second(pair):
    first, second = pair
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
            refuse_second(second, COMMANDS, COMMAND, "controller")
        assert time.monotonic() - began < 1.0
    finally:
        end.set()
        sender.join()


def test_who_is_silent_is_waited_for_as_long_as_one_who_was_killed(pair, monkeypatch):
    first, second = pair
    monkeypatch.setattr(process, "LEASE", -0.2)
    first.publisher(COMMANDS, COMMAND.msgtype, COMMAND.types, SENSOR)
    began = time.monotonic()
    with pytest.raises(InputError, match="another controller already: first"):
        refuse_second(second, COMMANDS, COMMAND, "controller")
    assert 0.8 < time.monotonic() - began < 2.0


def test_nobody_is_there(pair):
    _, second = pair
    refuse_second(second, COMMANDS, COMMAND, "controller")
    assert second.age >= 0.6
    began = time.monotonic()
    refuse_second(second, COMMANDS, COMMAND, "controller")  # who has looked around need not again
    assert time.monotonic() - began < 0.3


def test_priority_is_given_back():
    before = os.sched_getscheduler(0)
    with unhurried():
        assert os.sched_getscheduler(0) == os.SCHED_OTHER
    assert os.sched_getscheduler(0) == before
