"""The plan ahead on the graph: a standard path that others decode, and what limits it."""

import math
import time

import numpy as np

from airpuck.control.law import Prediction, Step
from airpuck.estimate.estimator import Estimate
from airpuck.live.process import (
    HEARTBEATS,
    PLAN_NAME,
    PLANS,
    PlanOutbox,
    Process,
    positions,
    well_formed,
)
from airpuck.live.settings import LiveSettings
from airpuck.recording.message import MessageCodec

STATES = np.array([[0.1, 0.2, 0.0, 1, 0, 0], [0.2, 0.2, math.pi / 2, 1, 0, 0]])
PREDICTION = Prediction(np.array([0.02, 0.04]), STATES, ("motor", "rail"))
ESTIMATE = Estimate(1.5, np.zeros(6), np.zeros(6), np.zeros(3))


def test_subscribers_receive_a_standard_path_and_its_active_limits(pair, domain):
    listener, _ = pair
    paths, states = (well_formed(listener, topic) for topic in (PLANS, HEARTBEATS))
    with Process("fly", LiveSettings(domain=domain, quiet=True)) as process:
        plans, clock = PlanOutbox(process), process.clock
        plans.send(Step(np.zeros(6), "fallback", estimate=ESTIMATE))  # no plan: nothing is sent
        sent, said, until = [], [], time.monotonic() + 10
        while not (sent and said) and time.monotonic() < until:
            plans.send(Step(np.zeros(6), "softened", estimate=ESTIMATE, prediction=PREDICTION))
            time.sleep(0.05)
            sent += paths()
            said += [message.status[0] for message in states()]
        stamps = [at.header.stamp.sec * 10**9 + at.header.stamp.nanosec for at in sent[0].poses]
        np.testing.assert_allclose([clock.of(stamp) for stamp in stamps], [1.52, 1.54], atol=1e-6)
    assert sent[0].header.frame_id == sent[0].poses[0].header.frame_id == "world"
    np.testing.assert_array_equal(positions(sent[0]), STATES[:, :2])
    turned = sent[0].poses[1].pose.orientation
    np.testing.assert_allclose([turned.z, turned.w], [math.sqrt(0.5)] * 2)
    assert (said[0].name, said[0].message, said[0].level) == (PLAN_NAME, "softened", 1)
    figures = {pair.key: pair.value for pair in said[0].values}
    assert figures == {"limits": "motor, rail", "bound by": "motion"}


def test_a_path_that_cannot_be_drawn_is_not_sent():
    codec = MessageCodec(PLANS.msgtype)
    kind = "geometry_msgs/msg/PoseStamped"
    poses = [codec.message(kind) for _ in range(3)]
    assert positions(codec.message(poses=poses)).shape == (3, 2)
    assert positions(codec.message(poses=poses[:1])) is None
    poses[1].pose.position.x = math.nan
    assert positions(codec.message(poses=poses)) is None
