import os
import signal
import time
from threading import Event, Thread

import numpy as np
import pytest

from airpuck.boundary.errors import InputError
from airpuck.compute.process import prioritize
from airpuck.live import process
from airpuck.live import process as module
from airpuck.live.graph import SENSOR, Sample
from airpuck.live.process import EventLog, Inbox, Process
from airpuck.live.settings import LiveSettings
from airpuck.recording.mapping import Topics
from airpuck.recording.message import StreamCodec

from ..apparatus.graph_in_memory import GraphInMemory, joined
from ..apparatus.processes import CODECS, COMMANDS


@pytest.fixture
def clock(monkeypatch):
    """Time that stands still unless it is set."""

    class Clock:
        now = 100.0

    monkeypatch.setattr(module.time, "monotonic", lambda: Clock.now)
    return Clock


@pytest.fixture
def told():
    """A graph, and a log of events on it."""
    graph = GraphInMemory()
    return graph, EventLog(graph, "fly", quiet=True)


def test_alternating_events_are_counted_and_the_last_is_reported_last(clock, told):
    graph, log = told
    for k in range(50):
        clock.now += 0.01
        log.log("info", "flying") if k % 2 else log.log("error", "motors idle: no pose")
    assert graph.events == ["motors idle: no pose", "flying"]
    log.heartbeat("info", "exact", {})
    assert graph.events[2:] == ["motors idle: no pose (24 times)", "flying (24 times)"]
    assert log.counts == {"info": 25, "warning": 0, "error": 25}
    log.heartbeat("info", "exact", {})
    assert len(graph.events) == 4


def test_a_repeated_event_is_reported_and_after_a_second_immediately(clock, told):
    graph, log = told
    log.log("info", "flying")
    log.log("info", "flying")
    log.flush()
    assert graph.events == ["flying", "flying"]
    clock.now += 1.01
    log.log("info", "flying")
    assert graph.events == ["flying"] * 3


def test_events_that_differ_only_in_numbers_are_merged(clock, told):
    graph, log = told
    log.log("error", "pose jumped by 0.21 m and 0.00 rad")
    log.log("error", "pose jumped by 1.5 m and 12 rad")
    log.log("warning", "no message 1", kind="1")
    log.log("warning", "no message 2", kind="2")
    assert graph.events == [
        "pose jumped by 0.21 m and 0.00 rad",
        "pose jumped by 1.5 m and 12 rad",  # it happened before those that follow
        "no message 1",
        "no message 2",
    ]


def test_no_event_is_reported_more_than_twice_a_second(clock, told):
    graph, log = told
    for k in range(1000):
        clock.now += 0.01
        log.log("error", "motors idle: no pose")
        log.log("info", "flying")
        if k % 100 == 99:
            log.heartbeat("info", "exact", {})
    assert len(graph.events) <= 2 * 2 * 10
    assert log.counts["error"] == 1000


def test_a_heartbeat_has_a_name_a_state_and_figures(told):
    graph, log = told
    log.heartbeat("info", "exact", {"poses": 12})
    assert graph.states == [("fly", "exact", {"poses": "12"})]


@pytest.mark.parametrize(
    ("options", "printed"), [({}, "fly: on domain 0\n"), ({"quiet": True}, "")]
)
def test_a_process_prints_its_events_unless_quiet(monkeypatch, capsys, options, printed):
    joined(monkeypatch)
    with Process("fly", LiveSettings(**options)) as made:
        made.start("")
    assert capsys.readouterr().err == printed


COMMAND = CODECS[COMMANDS]


@pytest.fixture
def second(domain):
    """A process that comes after the first of a pair."""
    with Process("second", LiveSettings(domain=domain, quiet=True)) as made:
        yield made


def test_a_second_controller_is_rejected_within_a_second_if_one_is_sending(pair, second):
    first, _ = pair
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


def test_a_silent_process_times_out_like_a_killed_one(pair, second, monkeypatch):
    first, _ = pair
    monkeypatch.setattr(process, "LEASE", -0.2)
    first.publisher(COMMANDS, COMMAND.msgtype, COMMAND.types, SENSOR)
    began = time.monotonic()
    with pytest.raises(InputError, match="another controller already: first"):
        second.refuse_second("command", COMMAND.columns, "controller")
    assert 0.8 < time.monotonic() - began < 2.0


def test_a_first_controller_is_accepted(second):
    second.refuse_second("command", COMMAND.columns, "controller")
    assert second.graph.age >= 0.6
    began = time.monotonic()
    second.refuse_second("command", COMMAND.columns, "controller")  # discovery has already waited
    assert time.monotonic() - began < 0.3


def test_after_compilation_a_process_has_normal_priority():
    before = os.sched_getscheduler(0), os.sched_getparam(0)
    try:
        prioritize(first=True)
        prioritize(first=False)
        assert os.sched_getscheduler(0) == os.SCHED_OTHER
    finally:
        os.sched_setscheduler(0, *before)


def test_a_signal_ends_the_loop_but_not_the_process(second):
    before = signal.getsignal(signal.SIGINT)
    with Process("third", LiveSettings(domain=second.settings.domain, quiet=True)) as third:
        third.start("")
        assert third.goes_on
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(0.01)
        assert not third.goes_on
    assert signal.getsignal(signal.SIGINT) is before


# Streams as numbers, over a made-up graph ---------------------------------------------------------

POSE = StreamCodec("pose")


@pytest.fixture
def box(monkeypatch):
    made_up = joined(monkeypatch)
    process = Process("fly", LiveSettings(quiet=True, topics=Topics(pose="/pose")))
    made = Inbox(process, "pose")
    made.graph, made.clock, made.events = made_up, made_up.clock, process.events
    return made


def pose(stamp_ns, x=0.5, sent_ns=None):
    return Sample(stamp_ns if sent_ns is None else sent_ns, POSE.encode(stamp_ns, (x, 0.0, 0.0)))


def test_stamps_of_poses_are_converted_to_the_receivers_clock(box):
    stamp = box.clock.stamp_ns(box.clock.now)
    box.graph.waiting["/pose"] = [pose(stamp), pose(stamp, x=np.nan)]
    (first, values), (_, broken) = box.take()
    assert first == pytest.approx(box.clock.of(stamp))
    np.testing.assert_allclose(values, (0.5, 0.0, 0.0))
    assert np.isnan(broken[0])  # the guard's business
    assert (box.good, box.bad) == (2, 0)


def test_invalid_messages_and_wrong_stamps_are_dropped_and_reported(box):
    now = box.clock.stamp_ns(box.clock.now)
    box.graph.waiting["/pose"] = [
        Sample(now, b"\0\1\0\0nonsense"),
        pose(0),
        pose(now + 10**10),
        pose(now),
    ]
    assert len(box.take()) == 1
    assert (box.good, box.bad) == (1, 3)
    box.events.flush()
    told = [text.partition(":")[0] for text in box.graph.events]
    assert told == ["garbage on /pose", *["wrong or late stamp on /pose"] * 2]


@pytest.mark.parametrize("ahead", [-3600.0, -0.3, 0.0, 0.3, 3600.0])
def test_commands_act_on_arrival_whatever_the_senders_clock(box, ahead):
    now = box.clock.stamp_ns(box.clock.now) + round(1e9 * ahead)
    box.graph.waiting["/pose"] = [pose(0, sent_ns=now), pose(now, x=np.inf)]
    (values,) = box.take_commands()
    np.testing.assert_allclose(values, (0.5, 0.0, 0.0))
    assert box.graph.events == ["numbers on /pose that are not finite"]


def test_a_command_that_the_craft_rejects_counts_as_unusable(box):
    box.graph.waiting["/pose"] = [pose(0), pose(0)]
    assert len(box.take_commands()) == 2
    box.reject("a command that no motor has")
    assert (box.good, box.bad) == (1, 1)
    assert box.graph.events == ["refused on /pose: a command that no motor has"]
    assert box.events.counts["warning"] == 1


def test_finite_numbers_that_overflow_are_rejected(box):
    now = box.clock.stamp_ns(box.clock.now)
    box.graph.waiting["/pose"] = [pose(now, x=1e300), pose(now)]
    assert len(box.take()) == 1
    box.graph.waiting["/pose"] = [pose(now, x=-1e9), pose(now)]
    assert len(box.take_commands()) == 1
    assert (box.good, box.bad) == (2, 2)
    assert set(box.graph.events) == {"numbers on /pose beyond 1e+06"}


def test_commands_that_waited_for_a_suspended_process_are_late(box):
    box.clock.sleep_until(box.clock.now + 0.12)
    for _ in range(2):  # messages in the system's buffers arrive a little later
        box.graph.waiting["/pose"] = [pose(0)]
        assert box.take_commands() == []
    assert set(box.graph.events) == {"late messages on /pose"}
    box.clock.sleep_until(box.clock.now + 0.06)
    box.graph.waiting["/pose"] = [pose(0)]
    assert len(box.take_commands()) == 1
    assert (box.good, box.bad) == (1, 2)


def test_a_clock_difference_is_reported_once(box):
    for _ in range(40):
        box.graph.waiting["/pose"] = [pose(box.clock.stamp_ns(box.clock.now) - 3600 * 10**9)]
        box.take()
        box.clock.sleep_until(box.clock.now + 0.02)
    box.events.flush()
    assert [text for text in box.graph.events if "clock" in text] == [
        "the clock behind /pose differs by -3600.000 s; compensated"
    ]
