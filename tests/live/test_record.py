import time
from uuid import uuid4

import pytest

from airpuck import read_recording
from airpuck.live.graph import LOG, SENSOR, STATE, Endpoint
from airpuck.live.record import Listener, record
from airpuck.live.settings import LiveSettings
from airpuck.recording.message import StreamCodec

from ..apparatus.graph_in_memory import joined
from ..apparatus.processes import CODECS, COMMANDS, POSES, until

POSE = StreamCodec("pose")
FIRST, SECOND = "/a/pose", "/b/pose"


def test_messages_are_never_received_before_they_were_sent(pair):
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
            heard[one.first.topic].append(one)
            # While this message is processed, the other topic sends.
            says[SECOND].send(message)
            time.sleep(0.01)
    assert min(map(len, heard.values())) >= 3
    assert all(one.received_ns >= one.sent_ns for each in heard.values() for one in each)


def test_own_messages_are_received_only_on_request(pair):
    speaker, _ = pair
    deaf, alert = Listener(speaker), Listener(speaker, own=True)
    says = speaker.publisher(FIRST, POSE.msgtype, POSE.types, SENSOR)
    message, heard = POSE.encode(0, (0.0, 0.0, 0.0)), []
    stop = time.monotonic() + 10
    while not heard and time.monotonic() < stop:
        says.send(message)
        assert not list(deaf.listen(0.02))
        heard += alert.listen(0.02)
    assert [one.first.topic for one in heard[:1]] == [FIRST]


@pytest.mark.parametrize(("more", "less"), [(STATE, SENSOR), (LOG, STATE), (LOG, SENSOR)])
def test_publishers_of_any_service_level_are_received_once(pair, more, less):
    speaker, other = pair
    listener = Listener(other)
    heard: list[tuple[float, float]] = []
    count = 0

    def say(publisher, who: float) -> None:
        nonlocal count
        count += 1
        publisher.send(POSE.encode(0, (who, count, 0.0)))

    def listen() -> None:
        heard.extend(tuple(POSE.decode(one.data)[1][:2]) for one in listener.listen(0.01))

    def known() -> set[float]:
        return {name for name, _ in heard}

    strong = speaker.publisher(FIRST, POSE.msgtype, POSE.types, more)
    until(lambda: say(strong, 1.0) or listen() or known())
    weak = speaker.publisher(FIRST, POSE.msgtype, POSE.types, less)
    began = count
    until(lambda: say(strong, 1.0) or say(weak, 2.0) or listen() or 2.0 in known())
    # The change of subscriptions lost no reliable message, and none was received twice.
    time.sleep(0.05)
    listen()
    said = [number for name, number in heard if name == 1.0 and number > began]
    assert said == list(range(began + 1, count, 2))
    assert len(set(heard)) == len(heard)
    # No publisher sends: the old subscription does not wake the waiting process.
    started = time.monotonic()
    assert not list(listener.listen(0.08))
    assert time.monotonic() - started > 0.05


def test_a_topic_of_unknown_type_is_reported_and_all_others_are_recorded(monkeypatch, tmp_path):
    graph = joined(monkeypatch)
    kinds = {topic: CODECS[topic].msgtype for topic in (POSES, COMMANDS)} | {"/scan": "a/msg/B"}
    graph.others = [Endpoint(uuid4(), uuid4(), *one, True, False) for one in kinds.items()]
    for at in (0.1, 0.2, 0.3):
        graph.publish(at, POSES, (at, 0.0, 0.0))
        graph.publish(at, COMMANDS, [at] * 6)
    folder = tmp_path / "monday" / "bag"
    found = record(folder, LiveSettings(duration=0.5, quiet=True))
    (note,) = found["notes"]
    assert note.startswith("/scan of somebody, a/msg/B, is not recorded")
    assert note in graph.events
    recording = read_recording(folder)
    assert recording["pose"].values[:, 0].tolist() == [0.1, 0.2, 0.3]
    assert recording["command"].values[:, 5].tolist() == [0.1, 0.2, 0.3]
