import time

import pytest

from airpuck.boundary.errors import InputError
from airpuck.live.graph import SENSOR, STATE
from airpuck.recording.message import StreamCodec

from ..apparatus.processes import until

POSE = StreamCodec("pose")


def test_bytes_arrive_unchanged_and_wake_a_waiting_process(pair):
    first, second = pair
    heard = second.subscription("/pose", POSE.msgtype, POSE.types, SENSOR, wakes=True)
    says = first.publisher("/pose", POSE.msgtype, POSE.types, SENSOR)
    message = POSE.encode(1_700_000_000_123_456_789, (0.5, -0.25, 3.0))
    before, taken = time.time_ns(), []
    until(lambda: says.send(message) or taken.extend(heard.take()) or taken)
    assert taken[0].data == message
    assert before <= taken[0].sent_ns <= time.time_ns()
    says.send(message)
    started = time.monotonic()
    second.wait(5.0)
    assert time.monotonic() - started < 1.0


def test_a_message_wakes_only_its_subscribers(pair):
    first, second = pair
    heard = second.subscription("/pose", POSE.msgtype, POSE.types, SENSOR)
    says = first.publisher("/pose", POSE.msgtype, POSE.types, SENSOR)
    message = POSE.encode(0, (0.0, 0.0, 0.0))
    until(lambda: says.send(message) or heard.take())
    says.send(message)
    started = time.monotonic()
    second.wait(0.2)
    assert time.monotonic() - started > 0.15
    assert heard.take()


def test_other_publishers_are_listed_by_name_until_they_leave(pair, domain):
    first, second = pair
    first.publisher("/drone/control", POSE.msgtype, POSE.types, SENSOR)
    until(lambda: second.publishers("/drone/control"))
    (endpoint,) = second.publishers("/drone/control")
    assert endpoint.msgtype == "geometry_msgs/msg/PoseStamped"
    assert not endpoint.reliable
    assert second.describe(endpoint).startswith("first (process ")
    assert first.publishers("/drone/control") == []  # its own
    assert second.publishers("/other") == []
    first.close()
    until(lambda: not second.publishers("/drone/control"))


def test_a_publisher_with_a_weaker_service_than_requested_is_not_received(pair):
    first, second = pair
    asks_more = second.subscription("/pose", POSE.msgtype, POSE.types, STATE)
    asks_less = second.subscription("/pose", POSE.msgtype, POSE.types, SENSOR)
    says = first.publisher("/pose", POSE.msgtype, POSE.types, SENSOR)
    until(lambda: says.send(POSE.encode(0, (0, 0, 0))) or asks_less.take())
    assert asks_more.take() == []


def test_a_topic_accepts_only_one_type(pair):
    first, _ = pair
    other = StreamCodec("estimate")
    first.publisher("/pose", POSE.msgtype, POSE.types, SENSOR)
    with pytest.raises(
        InputError, match=r"/pose: already has the type geometry_msgs/msg/PoseStamped"
    ):
        first.publisher("/pose", other.msgtype, other.types, SENSOR)


def test_other_subscribers_are_listed_but_not_oneself(pair):
    first, second = pair
    hears = second.subscription("/mallet/target", POSE.msgtype, POSE.types, SENSOR)
    second.publisher("/mallet", POSE.msgtype, POSE.types, SENSOR)
    until(lambda: first.subscribers("/mallet/target") and first.publishers("/mallet"))
    (sender,) = first.publishers("/mallet")
    assert first.subscribers("/mallet/target") == {sender.participant}
    assert second.subscribers("/mallet/target") == set()
    assert first.subscribers("/other") == set()
    assert hears.take() == []
    second.close()
    until(lambda: not first.subscribers("/mallet/target"))
