"""Tracking performance of a flight through set points, the same for simulated and real flights."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from airpuck.boundary.errors import InputError
from airpuck.boundary.results import Result
from airpuck.control.reference import SetPoints
from airpuck.craft.vehicle import Vehicle
from airpuck.data.sampling import hold
from airpuck.physics.rigid_body import pose_difference, wrapped
from airpuck.preprocessing.clock import seconds
from airpuck.preprocessing.derivative import unwrap_yaw
from airpuck.preprocessing.pipeline import clean_streams
from airpuck.recording.stream import Recording

#: A set point counts as reached within these distances [m, m, rad].
TOLERANCE = (0.02, 0.02, 0.05)
#: The steady state is the mean over the last second of a dwell, or over its last quarter if the
#: dwell is short. It begins no earlier than the craft has settled.
_STEADY_S, _STEADY_SHARE = 1.0, 0.25
#: Figures and comparisons begin this long before the first set point that moves the craft.
_LEAD_S = 0.5


@dataclass(frozen=True)
class SetPointResult(Result):
    """Tracking performance at one set point."""

    JSON = (
        "start_s=start stop_s=stop set_point=pose:x_m,y_m,yaw_rad settling_time_s=settling_time "
        "overshoot:x_m,y_m,yaw_rad steady_state_error:x_m,y_m,yaw_rad effort"
    )

    #: Time in which it was in force [s].
    start: float
    stop: float
    #: x, y [m], yaw [rad].
    pose: tuple[float, ...]
    #: Time until the pose stays within `TOLERANCE`; None if it never does [s].
    settling_time: float | None
    #: Overshoot of x, y, yaw beyond the set point, in the initial direction [m, m, rad].
    overshoot: tuple[float, ...]
    #: Mean pose minus set point at the end of the dwell, after the craft has settled if it does;
    #: None if poses are missing there [m, m, rad].
    steady_state_error: tuple[float, ...] | None
    #: Mean over the dwell of the sum of squared commands above the lowest command.
    effort: float


@dataclass(frozen=True, eq=False)
class Track:
    """A flight through set points."""

    #: Label of the flight.
    label: str
    #: Times of the poses, from the first command on [s].
    time: Float[np.ndarray, " N"]
    #: x, y [m], yaw, continuous [rad].
    pose: Float[np.ndarray, "N 3"]
    #: The set points, on the same time axis.
    set_points: SetPoints
    #: [s].
    command_time: Float[np.ndarray, " K"]
    #: Motor commands.
    command: Float[np.ndarray, "K n"]
    #: Names of the motors.
    motors: tuple[str, ...]
    #: The command at which motors idle.
    idle: Float[np.ndarray, " c"]

    @classmethod
    def of(cls, recording: Recording, vehicle: Vehicle, label: str) -> Track:
        """Extract a flight from a recording."""
        poses, commands, aligned = clean_streams(recording, vehicle)
        start = float(commands.time[0])
        return cls(
            label=label,
            time=poses.time - start,
            pose=np.column_stack([poses.values[:, :2], unwrap_yaw(poses.values[:, 2])]),
            set_points=recorded_set_points(recording, aligned.recorder_epoch + start),
            command_time=commands.time - start,
            command=commands.values,
            motors=vehicle.columns,
            idle=vehicle.idle,
        )

    @property
    def first_move(self) -> int:
        """Index of the first set point that differs from the start.

        The first set point of a flight counts unless the craft is already there, within
        `TOLERANCE`, when it comes into force. Later ones count if they differ from the first. Zero
        if none does.
        """
        times, poses = self.set_points.times, self.set_points.poses
        begin = min(int(self.time.searchsorted(times[0])), len(self.time) - 1)
        away = pose_difference(np, self.pose[begin], poses[0])
        if (np.abs(away) > TOLERANCE).any():
            return 0
        return int((poses != poses[0]).any(axis=1).argmax())

    @property
    def origin(self) -> float:
        """Start time of figures and comparisons [s].

        Half a second before the first set point that differs from the start, if there are poses.
        """
        return max(float(self.set_points.times[self.first_move]) - _LEAD_S, float(self.time[0]))

    @property
    def errors(self) -> Float[np.ndarray, "N 3"]:
        """Pose minus the set point in force, yaw the shorter way; zero before the first one."""
        asked = hold(self.set_points.times, self.set_points.poses, self.time)
        errors = pose_difference(np, self.pose.T, asked.T).T
        return np.where((self.time >= self.set_points.times[0])[:, None], errors, 0.0)

    def moves(self) -> list[SetPointResult]:
        """Measure how set points were reached, from the first that differs from the start."""
        begin = self.set_points.times[self.first_move]
        return [result for result in self.results() if result.start >= begin]

    def results(self) -> list[SetPointResult]:
        """Measure how each set point was reached."""
        times = self.set_points.times
        stops = np.append(times[1:], self.time[-1])
        found = []
        for start, stop, pose in zip(times, stops, self.set_points.poses, strict=True):
            inside = (self.time >= start) & (self.time < stop)
            if inside.sum() >= 10:
                found.append(self._result(float(start), float(stop), pose, inside))
        return found

    def _result(
        self, start: float, stop: float, pose: Float[np.ndarray, " 3"], inside: Any
    ) -> SetPointResult:
        """Measure one set point."""
        time, error = self.time[inside], self.pose[inside] - pose
        # Choose the equivalent yaw nearest to where the dwell ends.
        error[:, 2] += wrapped(np, error[-1, 2]) - error[-1, 2]
        outside = np.flatnonzero((np.abs(error) > TOLERANCE).any(axis=1))
        if len(outside) == 0:
            settled = 0.0
        elif outside[-1] == len(error) - 1:
            settled = None
        else:
            settled = float(time[outside[-1] + 1] - start)
        beyond = np.max(-np.sign(error[0]) * error, axis=0, initial=0.0)
        begin = stop - min(_STEADY_S, _STEADY_SHARE * (stop - start))
        steady = time >= max(begin, start + (settled or 0.0))
        given = (self.command_time >= start) & (self.command_time < stop)
        above = self.command[given] - self.idle
        return SetPointResult(
            start=start,
            stop=stop,
            pose=tuple(pose.tolist()),
            settling_time=settled,
            overshoot=tuple(beyond.tolist()),
            # Unknown without poses there.
            steady_state_error=tuple(error[steady].mean(axis=0).tolist()) if steady.any() else None,
            effort=float((above**2).sum(axis=1).mean()) if given.any() else 0.0,
        )

    def difference(
        self, other: Track, span: tuple[float, float] = (0.5, 6.5)
    ) -> Float[np.ndarray, "M 3"]:
        """Compare with another flight at this flight's pose times."""
        begin = max(self.origin + span[0], other.time[0])
        stop = min(self.origin + span[1], other.time[-1])
        inside = (self.time >= begin) & (self.time <= stop)
        if not inside.any():
            raise InputError(f"{self.label} and {other.label} do not overlap in time")
        theirs = [np.interp(self.time[inside], other.time, values) for values in other.pose.T]
        return pose_difference(np, np.array(theirs), self.pose[inside].T).T


def recorded_set_points(recording: Recording, epoch: float) -> SetPoints:
    """Return the set points that a recording logged."""
    logged = recording["reference"]
    # Use the same arithmetic as for the commands: a set point at the same time must not seem
    # earlier.
    times = seconds(logged.received_ns) - epoch
    last = np.append(np.diff(times) > 0, True)
    times, poses = times[last], logged.values[last, :3]
    new = np.append(True, (np.diff(poses, axis=0) != 0).any(axis=1))
    return SetPoints(times[new].tolist(), [tuple(pose) for pose in poses[new].tolist()])
