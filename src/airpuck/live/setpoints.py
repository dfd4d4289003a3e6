"""Set points of a live flight: from a file, or from the graph while it flies."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from airpuck.control.reference import SetPoint, SetPoints, Target


class PlannedSetPoints:
    """Set points whose times [s] count from when the craft first flies; a `Reference`."""

    def __init__(self, points: SetPoints) -> None:
        self._points = points
        self._start: float | None = None

    def begin(self, start: float) -> None:
        """Start the time of the set points; later calls do nothing."""
        if self._start is None:
            self._start = start

    def at(self, now: float, ahead: float) -> Target:
        """Return the set point in force now; see `Reference.at`."""
        return self._points.at(-np.inf if self._start is None else now - self._start, ahead)


class FollowedSetPoint:
    """A set point that others may move while the craft flies; a `Reference`."""

    def __init__(self, geofence: tuple[float, float]) -> None:
        self._geofence = geofence
        #: None before it has been moved to its first place.
        self.point: SetPoint | None = None

    def at(self, now: float, ahead: float) -> Target:
        """Return the set point in force now; see `Reference.at`."""
        return (self.point or SetPoint(0.0, 0.0, 0.0)).at(now, ahead)

    def move(self, pose: Float[np.ndarray, " k"]) -> str | None:
        """Move it to x, y, yaw, at rest; return why not, if it may not go there."""
        if not np.isfinite(pose[:3]).all():
            return "a set point that is not finite"
        x, y, yaw = pose[:3].tolist()
        if abs(x) > self._geofence[0] or abs(y) > self._geofence[1]:
            return f"a set point outside the geofence, ({x:.2f}, {y:.2f})"
        self.point = SetPoint(x, y, yaw)
        return None
