"""The poses that a controller accepts, and the time for which it flies without a new one."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
from jaxtyping import Float

from airpuck.control.allocation import all_finite
from airpuck.control.authority import pushes
from airpuck.control.tuning import Tuning
from airpuck.estimate.kalman import KalmanFilter
from airpuck.model.model_file import Model

#: No controller needs poses more often than this [s]: twelve frames of the paper's motion capture.
SHORTEST_PAUSE = 0.05
#: Frames in a pause: a camera's latency takes one or two, and one or more may be lost.
_FEWEST_FRAMES, _MOST_FRAMES = 3, 6
#: Frames per second if neither tuning nor model state them: the paper's.
_USUAL_RATE = 240.0
#: Shortest time for which commands are kept after they begin to act [s].
_REMEMBERED = 0.5
#: A pose this far from its prediction cannot be the craft: [m, m, rad].
JUMP = (0.1, 0.1, 1.0)
#: Longest time for which a prediction steers a moving craft, which would coast into a rail [s], and
#: the speed from which it counts as moving [m/s].
BLIND, MOVES = 0.25, 0.1
#: Rounding of stamps must not cost a frame [s].
ROUNDING = 1e-6


def longest_pause(model: Model, tuning: Tuning) -> float:
    """Return how old the last pose may be while the motors run [s].

    Until then a disturbance as strong as the craft's own thrust moves it by less than the distance
    at which a pose counts as a jump. A slow craft may coast for longer, but never for more than six
    frames. Three frames are always allowed: a slower camera cannot fly the craft.
    """
    rate = tuning.estimation.camera_hz or (model.cameras and model.cameras.rate_hz)
    frame = 1 / rate if rate else float(model.fit.get("sample_period_s", 1 / _USUAL_RATE))
    coasting = math.sqrt(2 * JUMP[0] / pushes(np, model.dynamics).max())
    return max(SHORTEST_PAUSE, min(max(coasting, _FEWEST_FRAMES * frame), _MOST_FRAMES * frame))


def remembered(pause: float) -> float:
    """Return the age at which a command affects only motor speeds, given the longest pause [s]."""
    return max(_REMEMBERED, 2 * pause)


class PoseGate:
    """Passes poses to an estimator unless they cannot be the craft."""

    def __init__(self, pause: float = SHORTEST_PAUSE) -> None:
        #: The age at which a pose is too old [s].
        self.pause = pause
        #: Stamps of the last pose received and of the last pose used.
        self.received: float | None = None
        self._used = -math.inf
        #: The last pose, and since when poses agree with each other.
        self._pose: Float[np.ndarray, " 3"] | None = None
        self._agreeing_since = 0.0
        #: Whether the last pose was not finite, or too far from its prediction.
        self._bad = self._doubtful = False

    def offer(self, estimator: KalmanFilter, time: float, pose: Float[np.ndarray, " 3"]) -> bool:
        """Use a pose if it is plausible; return whether it is finite and new.

        See `TrackingController.pose` for the rules.
        """
        self._bad = not (math.isfinite(time) and all_finite(pose))
        last = self.received
        if self._bad or (last is not None and last - self.pause <= time <= last):
            return False
        self.received = time
        if self._pose is None or _far(pose, self._pose):
            self._agreeing_since = time
        self._pose = pose
        if last is None or abs(time - last) > self.pause:
            # The last pose is too old to predict from, or its stamp lies in the future: restart,
            # unless a short gap has not led the prediction astray.
            short = last is not None and 0 < time - last <= BLIND and not self._doubtful
            if short and estimator.pose(time, pose, gate=JUMP):
                self._used = time
            else:
                self._restart(estimator, time, pose)
        # If poses stay doubtful for the longest pause, the prediction is no more credible than they
        # are.
        elif time - self._used <= self.pause and estimator.pose(time, pose, gate=JUMP):
            self._used = time
            self._doubtful = False
        else:
            # If the estimate spins too fast, every few poses agree with it by chance: this one does
            # not.
            self._doubtful = True
            if time - self._agreeing_since >= self.pause - ROUNDING:
                self._restart(estimator, time, pose)
        return True

    def refusal(
        self, time: float, speed: float = 0.0
    ) -> Literal["bad input", "no pose", "stale pose", "jumping pose"] | None:
        """Return why the poses do not allow steering now, at a speed [m/s]; None if they do."""
        if self._bad:
            return "bad input"
        if self.received is None:
            return "no pose"
        blind = speed > MOVES and 0 <= time - self.received <= BLIND
        if not (self.is_recent(time) or blind):
            return "stale pose"
        return "jumping pose" if self._doubtful else None

    def is_recent(self, time: float) -> bool:
        """Return whether a time is close to the time of the last pose."""
        return self.received is not None and abs(time - self.received) <= self.pause

    def _restart(self, estimator: KalmanFilter, time: float, pose: Float[np.ndarray, " 3"]) -> None:
        """Restart the estimator at a pose, keeping the known commands."""
        self._doubtful = False
        self._used = self._agreeing_since = time
        estimator.restart(time, pose)


def _far(pose: Float[np.ndarray, " 3"], other: Float[np.ndarray, " 3"]) -> bool:
    """Return whether two poses are too far apart for consecutive frames."""
    x, y, yaw = (pose - other).tolist()
    yaw = math.remainder(yaw, math.tau)
    return abs(x) > JUMP[0] or abs(y) > JUMP[1] or abs(yaw) > JUMP[2]
