from __future__ import annotations

import time

from airpuck.live.graph import SENSOR
from airpuck.live.listener import Listener
from airpuck.recording.message import StreamCodec

POSE = StreamCodec("pose")
FIRST, SECOND = "/a/pose", "/b/pose"


def test_nothing_is_received_before_it_was_sent_however_slow_the_listener(pair):
    speaker, other = pair
    listener = Listener(other)
    says = {
        topic: speaker.publisher(topic, POSE.msgtype, POSE.types, SENSOR)
        for topic in (FIRST, SECOND)
    }
    message = POSE.encode(0, (0.0, 0.0, 0.0))
    heard: dict[str, list] = {FIRST: [], SECOND: []}
    stop = time.monotonic() + 10
    while min(map(len, heard.values())) < 3 and time.monotonic() < stop:
        says[FIRST].send(message)
        for one in listener.listen(0.05):
            heard[one.topic].append(one)
            # While this one is dealt with, the other topic speaks.
            says[SECOND].send(message)
            time.sleep(0.01)
    assert min(map(len, heard.values())) >= 3
    assert all(one.received_ns >= one.sent_ns for each in heard.values() for one in each)


def test_own_words_are_heard_only_by_who_asks(pair):
    speaker, _ = pair
    deaf, alert = Listener(speaker), Listener(speaker, own=True)
    says = speaker.publisher(FIRST, POSE.msgtype, POSE.types, SENSOR)
    message, heard = POSE.encode(0, (0.0, 0.0, 0.0)), []
    stop = time.monotonic() + 10
    while not heard and time.monotonic() < stop:
        says.send(message)
        assert not list(deaf.listen(0.02))
        heard += alert.listen(0.02)
    assert [one.topic for one in heard[:1]] == [FIRST]
