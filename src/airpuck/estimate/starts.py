"""Which starts of motors failed, from the poses of the moments after.

After a start, the poses are linear in the fraction f of its thrust that the motor lacks, beside
position, velocity and the usual deviations of all motors (`airpuck.estimate.actuation`). A start
failed if f = 1 is far more likely than f = 0.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Float

from airpuck.data.sampling import mean_hold
from airpuck.deviation.motor_regression import (
    accelerations_by_motor,
    following,
    solved,
    twice_integrated,
)
from airpuck.estimate.actuation import ActuationEncoder, residual_covariance
from airpuck.estimate.estimator import HeldCommands
from airpuck.model.model_file import Model
from airpuck.physics.rigid_body import wrapped

#: A motor commanded to less than this rests, and starts with the first command above [1].
RESTS_BELOW = 0.05
#: Poses from this long before a start count [s].
_BEFORE = 0.1
#: Time after the thrust was due at which a start is judged [s]: earlier, a late packet looks alike.
_JUDGED = 0.044
#: Logarithm of the likelihood ratio, and fraction lacking, from which on a start failed.
_LIKELIER, _LACKING = 3.0, 0.7
#: Prior standard deviation of the fraction that a motor lacks.
_WIDE = 3.0
#: The same for other motors that started in these moments.
_OTHER = 0.3
#: Starts are judged from this mean command on: poses do not show weaker ones in time [1].
_STRONG = 0.3
#: Fewest poses, and the largest difference between the times from one to the next [s].
_FEWEST, _GAP = 8, 0.01


@dataclass(frozen=True)
class _Start:
    """A start whose outcome is not known."""

    motor: int
    #: When it was sent, and when it begins to act [s].
    sent: float
    acts: float


@dataclass(frozen=True)
class FailedStart:
    """A motor that did not turn up when it was commanded to."""

    #: Index of the propeller.
    motor: int
    #: When the command was sent, and when the failure was noticed [s].
    sent: float
    noticed: float


class StartMonitor:
    """Notices motors that fail to start, within 50 ms after their thrust was due.

    The thrust is due a transport delay and a motor lag after the command. Starts of so little
    thrust that poses cannot tell are passed over.

    Parameters
    ----------
    model : Model
        The craft.
    """

    def __init__(self, model: Model) -> None:
        self._model, self._assumed = model, ActuationEncoder(velocity="causal")
        n = model.vehicle.n_propellers
        self._lag = float(np.max(model.dynamics.lag))
        self._commands = HeldCommands(np.full(n, model.vehicle.command_min))
        self._rests = np.ones(n, dtype=bool)
        self._poses: deque[tuple[float, ...]] = deque()
        #: Starts that may still be judged, and all of the last moments.
        self._open: list[_Start] = []
        self._recent: list[_Start] = []

    def command(self, time: float, command: Float[np.ndarray, " n"]) -> None:
        """Receive a command that was sent."""
        self._commands.send(time, command, self._model)
        if len(command) != len(self._rests):
            return  # wheels and reversible propellers have no such starts
        rests = np.asarray(command) < RESTS_BELOW
        for motor in np.flatnonzero(self._rests & ~rests):
            self._recent.append(_Start(int(motor), time, time + self._model.transport_delay))
            self._open.append(self._recent[-1])
        self._rests = rests

    def pose(self, time: float, pose: Float[np.ndarray, " 3"]) -> list[FailedStart]:
        """Receive a pose; return the starts that turn out to have failed."""
        if self._poses and time <= self._poses[-1][0]:
            return []
        x, y, yaw = np.asarray(pose, dtype=float).tolist()
        if self._poses:
            last = self._poses[-1][3]
            yaw = last + float(wrapped(np, yaw - last))
        self._poses.append((time, x, y, yaw))
        due = [start for start in self._open if time >= start.acts + self._lag + _JUDGED]
        self._open = [start for start in self._open if start not in due]
        failed = [FailedStart(one.motor, one.sent, time) for one in due if self._lacks(one)]
        oldest = min((start.acts for start in self._open), default=time) - _BEFORE
        self._recent = [start for start in self._recent if start.acts > oldest]
        while self._poses[0][0] < oldest:
            self._poses.popleft()
        self._commands.drop(oldest)
        return failed

    def _lacks(self, start: _Start) -> bool:
        """Return whether a motor probably lacks all thrust since a start."""
        poses = np.array(self._poses)
        time, pose = poses[:, 0], poses[:, 1:]
        durations = np.diff(time)[:, None]
        if len(time) < _FEWEST or time[0] > start.acts or np.ptp(durations) > _GAP:
            return False
        begun, commands = zip(*self._commands.until(time[-1]), strict=True)
        held, _ = mean_hold(np.maximum(begun, time[0] - 1.0), np.array(commands), time)
        if held[time >= start.acts, start.motor].mean() < _STRONG:
            return False
        rates = np.diff(pose, axis=0) / durations
        state = np.concatenate([pose, np.concatenate([rates, rates[-1:]])], axis=1)[..., None]
        speed = following(self._model.dynamics, held[0][:, None], held[:-1, :, None], durations)
        by_motor, rest = accelerations_by_motor(self._model.dynamics, state, speed)
        # Motors may also have failed in other starts of these moments; the last one is judged.
        others = [one for one in self._recent if one.acts < time[-1] and one.motor != start.motor]
        lacking = [
            -by_motor[:, :, one.motor] * (time >= one.acts)[:, None, None]
            for one in (*others, start)
        ]
        total = rest + by_motor.sum(axis=2)
        columns = np.concatenate([by_motor, np.stack(lacking, axis=2)], axis=2)
        basis = twice_integrated(columns, durations)[..., 0]
        residual = pose - pose[-1] - twice_integrated(total, durations)[..., 0]
        lacks, variance = self._estimated(time - time[-1], basis, residual, 1 + len(others))
        return lacks > _LACKING and (2 * lacks - 1) / (2 * variance) > _LIKELIER

    def _estimated(
        self,
        elapsed: Float[np.ndarray, " E"],
        basis: Float[np.ndarray, "E 3 m"],
        residual: Float[np.ndarray, "E 3"],
        starts: int,
    ) -> tuple[float, float]:
        """Estimate the fraction that the last motor lacks, by least squares; and its variance."""
        m, n = basis.shape[2], basis.shape[2] - starts
        information, score = np.zeros((6 + m, 6 + m)), np.zeros(6 + m)
        step = round(float(np.median(np.diff(elapsed))), 4)
        noises = zip(self._assumed.pose_noise, self._assumed.disturbance, strict=True)
        precise = [_precision(len(elapsed), step, noise, self._lag) for noise in noises]
        for c in range(3):
            rows = np.zeros((len(elapsed), 6 + m))
            rows[:, c], rows[:, 3 + c], rows[:, 6:] = 1.0, elapsed, basis[:, c]
            weighted = rows.T @ precise[c // 2]
            information += weighted @ rows
            score += weighted @ residual[:, c]
        prior = np.zeros((6 + m, 6 + m))
        prior[6 : 6 + n, 6 : 6 + n] = np.linalg.inv(self._assumed.priors[0].covariance(n))
        prior[range(6 + n, 6 + m), range(6 + n, 6 + m)] = _OTHER**-2.0
        prior[-1, -1] = _WIDE**-2.0
        solution, covariance = solved(information, score, prior)
        return float(solution[-1]), float(covariance[-1, -1])


@lru_cache(maxsize=256)
def _precision(
    length: int, step: float, noise: tuple[float, float], lag: float
) -> Float[np.ndarray, "E E"]:
    """Return the inverse covariance of the residuals of an axis."""
    return np.linalg.inv(residual_covariance(length, step, (*noise, 0.0), lag))
