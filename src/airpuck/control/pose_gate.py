"""Which measured poses the estimator may believe."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
from jaxtyping import Float

from airpuck.control.allocation import all_finite
from airpuck.estimate.kalman import KalmanFilter
from airpuck.physics.angle import pose_difference

#: No control without a pose from the last 50 ms: twelve frames of the motion capture.
STALE = 0.05
#: A pose this far from its prediction cannot be the craft: [m, m, rad].
_JUMP = (0.1, 0.1, 1.0)
#: Poses that agree with each other for this long, but not with the prediction, are believed [s];
#: rounding of stamps must not cost a frame.
_BELIEVED_AFTER = STALE - 1e-6


class PoseGate:
    """Hands poses on to an estimator, unless they cannot be the craft."""

    def __init__(self) -> None:
        #: Stamps of the last pose that was received, and of the last that was used.
        self.received: float | None = None
        self._used = -math.inf
        #: The last of the poses that agree with each other only, and the stamp of their first.
        self._doubtful: Float[np.ndarray, " 3"] | None = None
        self._doubtful_since = 0.0
        self._bad = False

    def offer(self, estimator: KalmanFilter, time: float, pose: Float[np.ndarray, " 3"]) -> bool:
        """Use a pose if it is plausible; return whether it is finite and new.

        See `TrackingController.pose` for the rules.
        """
        self._bad = not (math.isfinite(time) and all_finite(pose))
        last = self.received
        if self._bad or (last is not None and last - STALE <= time <= last):
            return False
        self.received = time
        if last is None or abs(time - last) > STALE:
            # Too long ago to predict over, or the last stamp lay in the future: begin anew.
            self._restart(estimator, time, pose)
        # A prediction from before 50 ms of doubtful poses is worth no more than they are.
        elif time - self._used <= STALE and estimator.pose(time, pose, gate=_JUMP):
            self._used = time
            self._doubtful = None
        else:
            if self._doubtful is None or _far(pose, self._doubtful):
                self._doubtful_since = time
            self._doubtful = pose
            if time - self._doubtful_since >= _BELIEVED_AFTER:
                self._restart(estimator, time, pose)
        return True

    def refusal(
        self, time: float
    ) -> Literal["bad input", "no pose", "stale pose", "jumping pose"] | None:
        """Return why the poses do not allow to steer now; None if they do."""
        if self._bad:
            return "bad input"
        if self.received is None:
            return "no pose"
        if not self.is_recent(time):
            return "stale pose"
        return None if self._doubtful is None else "jumping pose"

    def is_recent(self, time: float) -> bool:
        """Return whether a time is within 50 ms of the last pose."""
        return self.received is not None and abs(time - self.received) <= STALE

    def _restart(self, estimator: KalmanFilter, time: float, pose: Float[np.ndarray, " 3"]) -> None:
        """Start the estimator anew at a pose, keeping what is known of commands."""
        self._doubtful = None
        self._used = time
        estimator.restart(time, pose)


def _far(pose: Float[np.ndarray, " 3"], other: Float[np.ndarray, " 3"]) -> bool:
    """Return whether two poses cannot be neighbours."""
    return bool((np.abs(pose_difference(np, pose, other)) > _JUMP).any())
