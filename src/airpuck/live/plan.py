"""The plan of a predictive law, on the graph: a path, and the active limits."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from jaxtyping import Float

from airpuck.control.law import Step
from airpuck.live.graph import SENSOR
from airpuck.live.process import Level, Process, set_stamp
from airpuck.recording.message import MessageCodec, definitions

#: A standard message, which rviz and Foxglove draw; and the name on ``/diagnostics`` of its active
#: limits.
PLAN, PLAN_TYPE = "/control/plan", "nav_msgs/msg/Path"
NAME = "airpuck plan"
#: Number of poses of a path that are drawn; foreign paths may have any number.
_MOST = 200
_POSE = "geometry_msgs/msg/PoseStamped"


class PlanOutbox:
    """Sends plans."""

    def __init__(self, process: Process) -> None:
        types = definitions("")
        self._codec, self._clock = MessageCodec(PLAN_TYPE), process.clock
        self._events = process.events
        self._publisher = process.graph.publisher(PLAN, PLAN_TYPE, types, SENSOR)

    def send(self, step: Step) -> None:
        """Publish the prediction of a step, if its law predicts."""
        plan, estimate = step.prediction, step.estimate
        if plan is None or estimate is None:
            return
        path = self._codec.message()
        path.header.frame_id = "world"
        set_stamp(path.header.stamp, self._clock.stamp_ns(estimate.time))
        path.poses = [
            self._pose(estimate.time + time, state)
            for time, state in zip(plan.times.tolist(), plan.states[:, :3].tolist(), strict=True)
        ]
        self._publisher.send(self._codec.encode(path))
        level: Level = "info" if step.status == "optimal" else "warning"
        figures = {"limits": ", ".join(plan.active), "bound by": plan.bound_by}
        self._events.state(level, step.status, figures, name=NAME)

    def _pose(self, moment: float, pose: list[float]) -> Any:
        """Return one pose of a path."""
        x, y, yaw = pose
        stamped = self._codec.message(_POSE)
        stamped.header.frame_id = "world"
        set_stamp(stamped.header.stamp, self._clock.stamp_ns(moment))
        stamped.pose.position.x, stamped.pose.position.y = x, y
        turned = stamped.pose.orientation
        turned.z, turned.w = math.sin(yaw / 2), math.cos(yaw / 2)
        return stamped


def positions(path: Any) -> Float[np.ndarray, "N 2"] | None:
    """Return the positions of a path; None if there are fewer than two, or one is not finite."""
    points = [(at.pose.position.x, at.pose.position.y) for at in path.poses[:_MOST]]
    found = np.array(points, dtype=float).reshape(-1, 2)
    return found if len(found) > 1 and np.isfinite(found).all() else None
