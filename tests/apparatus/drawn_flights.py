"""Flights made up for animations: a spiral with set points, as a recording."""

import numpy as np

from airpuck.craft.vehicle import Vehicle, default_vehicle
from airpuck.recording.stream import COLUMNS, Recording, Stream

CRAFT = default_vehicle()
EPOCH = 1_700_000_000_000_000_000


def stream(time, values, columns) -> Stream:
    stamp = EPOCH + np.rint(1e9 * np.asarray(time)).astype(np.int64)
    return Stream(stamp, stamp, np.asarray(values, dtype=float), tuple(columns))


def flight(
    vehicle: Vehicle = CRAFT,
    *,
    duration: float = 2.0,
    left_out: tuple[float, float] = (0.0, 0.0),
    reference: bool = True,
) -> Recording:
    """A spiral at 240 Hz with a wrapped yaw, a command that changes at 100 Hz, two set points."""
    t = np.arange(0, duration, 1 / 240)
    t = t[(t <= left_out[0]) | (t >= left_out[1])]
    radius = 0.3 * t / duration
    yaw = (2.5 * t + 3 + np.pi) % (2 * np.pi) - np.pi
    pose = np.stack([radius * np.cos(3 * t), radius * np.sin(3 * t), yaw], axis=1)
    k = np.arange(0.1, duration, 0.01)
    n = vehicle.n_propellers
    command = 0.5 + 0.5 * np.sin(k[:, None] + np.arange(n))
    streams = {
        "pose": stream(t, pose, COLUMNS["pose"]),
        "command": stream(k, command, vehicle.propeller_names),
    }
    if reference:
        asked = [[0.0, 0.1, 0, 0, 0, 0], [0.2, -0.1, -3.0, 0, 0, 0]]
        streams["reference"] = stream([0.5, 1.2], asked, COLUMNS["reference"])
    return Recording(streams, "folder/flight_07")


def with_pose(recording: Recording, values) -> Recording:
    pose = recording["pose"]
    changed = Stream(pose.stamp_ns, pose.received_ns, np.array(values, float), pose.columns)
    return Recording({**recording.streams, "pose": changed}, recording.source)
