"""Live monitoring of how well a model fits the craft: prediction errors, motors, delay."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from airpuck.control.tuning import tuning_for
from airpuck.craft.table import Table
from airpuck.deviation.motor_regression import normal_equations, solved, with_effectiveness
from airpuck.deviation.significance import IN_FLIGHT, ModelError, tested_errors
from airpuck.estimate.estimator import HeldCommands
from airpuck.estimate.kalman import KalmanFilter
from airpuck.estimate.starts import FailedStart, StartMonitor
from airpuck.model.model_file import Model
from airpuck.physics.rigid_body import acceleration_map, pose_difference, rollout
from airpuck.physics.thrust import thrust

#: Prediction horizon, and the largest lateness of packets [s].
HORIZON, _JITTER = 0.2, 0.007
#: Interval between starts of predictions, as a fraction of the horizon.
_OVERLAP = 2.0
#: The filter's estimate is used once it has run for this long [s].
_SETTLED = 0.3
#: Without a pose or a command for this long, the motor speeds are unknown [s].
_SILENT = 0.1
#: A craft this near to a rail may be leaning on it [m].
_AT_RAIL = 0.01
#: Largest deviation of a pose from its prediction that is not a jump [m, m, rad].
_JUMP = (0.05, 0.05, 0.5)
#: Fraction of the squared error from which the share of a deviation is reported.
_NOTABLE = 0.1
#: Predictions needed before anything is reported.
_ENOUGH = 20
#: Predictions are dropped after this multiple of the memory.
_OLD = 3.0
#: Half the 95 % interval of a normal distribution, in standard deviations.
_NORMAL = 1.96
#: Steps of the finite differences with respect to effectiveness and delay [1, s].
_LOSS_STEP, _DELAY_STEP = 0.05, 0.004
#: Time before a prediction within which commands affect it [s].
_BEFORE = 0.06

#: Prior standard deviations of motors and delay from the model [1, s].
PRIOR_LOSS, PRIOR_DELAY = 0.3, 0.02
#: Number of expectation-maximisation iterations, and the smallest variance.
_ROUNDS, _LEAST = 5, 1e-10


@dataclass(frozen=True, eq=False)
class Judged:
    """A prediction and its result."""

    #: Time at which it ended [s].
    time: float
    #: Measured minus predicted: x, y, yaw and their rates.
    error: Float[np.ndarray, " 6"]
    #: Derivatives of the prediction with respect to the effectiveness of each motor and the delay
    #: [1/s].
    slopes: Float[np.ndarray, "6 m"]
    #: Σ b bᵀ over the relevant packets, where b is the change of the prediction due to the lateness
    #: of one packet [1/s].
    impulses: Float[np.ndarray, "6 6"]


@dataclass(frozen=True, eq=False)
class Health:
    """Errors of a model in the last seconds, and their implications for the craft."""

    #: Whether the craft is being watched: poses and commands arrive, and no rail is near.
    flying: bool
    #: Number of predictions.
    predictions: int
    #: Root mean square error of x, y [m] and yaw [rad]; NaN without predictions.
    error: Float[np.ndarray, " 3"]
    #: Errors of the delay and of each motor; `tested` where the commands determine them.
    errors: tuple[ModelError, ...]
    #: Names of motors that failed to start, once for each start.
    failed_starts: tuple[str, ...] = ()

    @property
    def findings(self) -> tuple[str, ...]:
        """Significant differences from the model in words."""
        return tuple(one.verdict for one in self.errors if not one.passed)

    @property
    def names(self) -> tuple[str, ...]:
        """What differs significantly: names of motors, or ``delay``."""
        return tuple(one.name for one in self.errors if not one.passed)

    def __str__(self) -> str:
        if not self.flying:
            return "nothing to judge: the craft must be in flight with poses and commands"
        if not self.predictions:
            return "no prediction judged yet"
        x, y, yaw = self.error.tolist()
        text = f"after {HORIZON:g} s: x {1e3 * x:.1f} mm, y {1e3 * y:.1f} mm, yaw {yaw:.3f} rad"
        unknown = [one.name for one in self.errors if not one.tested]
        said = list(self.findings)
        if not said and len(unknown) < len(self.errors):
            said = [f"{'known values' if unknown else 'motors and delay'} agree with the model"]
        if unknown:
            said.append(f"not known: {', '.join(unknown)} (little excitation)")
        notable = [one for one in self.errors if not one.passed and one.share > _NOTABLE]
        largest = [f"{one.name} {100 * one.share:.0f} %" for one in notable]
        said += [f"shares of the error: {', '.join(largest)}"] if largest else []
        if self.failed_starts:
            said.append(f"did not start: {', '.join(self.failed_starts)}")
        return "; ".join([text, *said])

    def to_json(self) -> dict[str, Any]:
        """Return the fields for ``--json``."""

        def row(one: ModelError, modelled: float) -> tuple[Any, ...]:
            value, half = one.value + modelled, _NORMAL * one.standard_error
            return value, one.standard_error, one.share, [value - half, value + half], one.tested

        thrust_keys = "effectiveness", "deviation", "error_share", "interval_95", "known"
        delay_keys = "difference_s", "deviation_s", "error_share", "interval_95_s", "known"
        delay, motors = self.errors[:1], self.errors[1:]
        thrusts = {one.name: dict(zip(thrust_keys, row(one, 1.0), strict=True)) for one in motors}
        timing = {k: v for one in delay for k, v in zip(delay_keys, row(one, 0.0), strict=True)}
        return {
            "flying": self.flying,
            "horizon_s": HORIZON,
            "predictions": self.predictions,
            "rmse_m_m_rad": self.error.tolist(),
            "propellers": thrusts,
            "delay": timing,
            "findings": list(self.findings),
            "failed_starts": list(self.failed_starts),
        }


class HealthMonitor:
    """Compares a craft in flight with its model; does not affect the flight."""

    def __init__(self, model: Model, *, memory: float = 5.0, compiled: bool = True) -> None:
        self.model, self._memory = model, memory
        self._filter = KalmanFilter(model, tuning_for(model).estimation.noise, compiled=compiled)
        self._free = np.array(Table().reach(model.vehicle.radius_m)) - _AT_RAIL
        n = model.vehicle.n_propellers
        #: Commands back to the first prediction's beginning.
        self._commands = HeldCommands(np.full(n, model.vehicle.command_min))
        self._commanded = -math.inf
        self._since: float | None = None
        #: Predictions that have not ended yet: start time and initial state, with motor speeds.
        self._begun: deque[tuple[float, Float[np.ndarray, " z"]]] = deque()
        self._judged: deque[Judged] = deque()
        self._starts, self._failed = StartMonitor(model), deque[FailedStart]()

    def command(self, time: float, command: Float[np.ndarray, " n"]) -> None:
        """Receive a command."""
        if not np.isfinite(command).all():
            return
        self._filter.command(time, command)
        self._starts.command(time, command)
        self._commanded = time
        self._commands.send(time, command, self.model)

    def pose(self, time: float, pose: Float[np.ndarray, " 3"]) -> None:
        """Receive a pose."""
        last = self._filter.time
        if not np.isfinite(pose).all() or (last is not None and time <= last):
            return
        self._failed += self._starts.pose(time, pose)
        blind = last is None or time - last > _SILENT or time - self._commanded > _SILENT
        if blind or (np.abs(pose[:2]) > self._free).any():
            # Restart; earlier findings are kept until they are too old.
            self._filter.restart(time, pose)
            self._since = None
            self._begun.clear()
            self._forget(time)
            return
        if self._since is None:
            self._since = time
        if not self._filter.pose(time, pose, _JUMP):
            return
        newest = self._begun[-1][0] if self._begun else -math.inf
        ends = bool(self._begun) and time - self._begun[0][0] >= HORIZON
        begins = time - self._since >= _SETTLED and time - newest >= HORIZON / _OVERLAP
        if ends or begins:
            estimate = self._filter.predict(time)
            if ends:
                self._judge(time, estimate.state)
            if begins:
                self._begun.append((time, np.concatenate([estimate.state, estimate.motor_speed])))
        self._forget(time)

    def health(self) -> Health:
        """Return how well the model fits, from the stored predictions."""
        names, radius = self.model.vehicle.propeller_names, self.model.radius_of_gyration
        given = self._judged, len(names), self._memory
        rmse, *found = deviations(*given, overlap=_OVERLAP, jitter=_JITTER, radius=radius)
        value, error, share = (np.roll(one, 1) for one in found)
        errors = ("delay", *names), value, error, math.inf, IN_FLIGHT
        named = tested_errors(*errors, share=share) if self._judged else ()
        failed = tuple(names[one.motor] for one in self._failed)
        return Health(self._since is not None, len(self._judged), rmse, named, failed)

    def _judge(self, end: float, state: Float[np.ndarray, " 6"]) -> None:
        """Compare the oldest prediction with the state at its end."""
        begin, start = self._begun.popleft()
        stronger = 1 + _LOSS_STEP * np.eye(len(start) - 6, len(start) - 5, 1)
        predicted = self._predicted(stronger, start, begin, end)
        late = self._predicted(stronger[:, :1], start, begin - _DELAY_STEP, end - _DELAY_STEP)
        by_motor = (predicted[:, 1:] - predicted[:, :1]) / _LOSS_STEP
        by_delay = (late - predicted[:, :1]) / _DELAY_STEP
        error = pose_difference(np, state, predicted[:, 0])
        slopes = np.hstack([by_motor, by_delay])
        self._judged.append(Judged(end, error, slopes, self._impulses(begin, start, end)))

    def _predicted(
        self,
        effectiveness: Float[np.ndarray, "n b"],
        start: Float[np.ndarray, " z"],
        begin: float,
        end: float,
    ) -> Float[np.ndarray, "6 b"]:
        """Predict the state over a time with commands, for a batch of craft."""
        durations, commands = zip(*self._commands.cut(begin, end), strict=True)
        dynamics = with_effectiveness(self.model.dynamics, effectiveness)
        batch = np.ones(effectiveness.shape[1])
        held, start = np.array(commands)[..., None] * batch, start[:, None] * batch
        return rollout(np, dynamics, start, held, np.array(durations))[-1, :6]

    def _impulses(
        self, begin: float, start: Float[np.ndarray, " z"], end: float
    ) -> Float[np.ndarray, "6 6"]:
        """Return the effect of late packets: each withholds the thrust that it changes."""
        dynamics, tau = self.model.dynamics, float(self.model.dynamics.motor_time_constant)
        begun, commands = zip(*self._commands.until(end), strict=True)
        times = np.array(begun[1:])
        changes = np.diff(thrust(dynamics.thrust, np.array(commands).T), axis=1)
        matrix, _ = acceleration_map(np, dynamics, start[2], start[5])
        # The response of lagging motors that is missing before the start, and present before the
        # end.
        lag = max(tau, 1e-6)
        acts = np.exp(-np.maximum(begin - times, 0) / lag) - np.exp(-(end - times) / lag)
        velocity = matrix @ changes * acts
        lost = np.vstack([velocity * (end - np.maximum(times, begin)), velocity])
        return lost @ lost.T

    def _forget(self, time: float) -> None:
        """Drop findings that are too old."""
        while self._judged and self._judged[0].time < time - _OLD * self._memory:
            self._judged.popleft()
        while self._failed and self._failed[0].noticed < time - _OLD * self._memory:
            self._failed.popleft()
        self._commands.drop((self._begun[0][0] if self._begun else time) - _BEFORE)


def deviations(
    judged: Sequence[Judged],
    motors: int,
    memory: float,
    *,
    overlap: float,
    jitter: float,
    radius: float,
) -> tuple[Float[np.ndarray, " 3"], *tuple[Float[np.ndarray, " m"], ...]]:
    """Estimate the differences by weighted least squares; the residuals give the noise.

    The weight of predictions decays with their age over `memory` [s]. `overlap` predictions share
    the same data, packets come late by `jitter` [s], and the yaw is weighted with the `radius` of
    gyration [m].

    Returns the root mean square errors of x, y [m] and yaw [rad], the excess of each motor's
    strength [1] and last of the delay [s], their standard deviations, and the fraction of the
    squared pose errors that each explains alone.
    """
    prior = np.append(np.full(motors, PRIOR_LOSS), PRIOR_DELAY) ** -2.0
    if not judged:
        return np.full(3, np.nan), np.zeros(motors + 1), prior**-0.5, np.full(motors + 1, np.nan)
    errors = np.array([one.error for one in judged])
    slopes = np.array([one.slopes for one in judged])
    lateness = jitter**2 * np.array([one.impulses for one in judged])
    weights = np.exp([(one.time - judged[-1].time) / memory for one in judged]) / overlap
    p, covariance = np.zeros(motors + 1), np.diag(1 / prior)
    spread = np.diag(np.median(errors**2, axis=0) + _LEAST)
    for _ in range(_ROUNDS):
        whitening = np.linalg.inv(np.linalg.cholesky(spread + lateness))
        aim = (whitening @ errors[..., None])[..., 0]
        information, score, _ = normal_equations(whitening @ slopes, aim)
        p, inverse = solved(np.tensordot(weights, information, 1), weights @ score, np.diag(prior))
        seen = overlap * np.tensordot(weights**2, information, 1)
        covariance = inverse @ (np.diag(prior) + seen) @ inverse
        spread = _spread(errors - slopes @ p, lateness, weights, spread)
    metric = np.array([1.0, 1.0, radius])
    pose, changes = errors[:, :3] * metric, slopes[:, :3] * metric[:, None] * p
    left = np.sum((pose[..., None] - changes) ** 2, axis=(0, 1))
    rmse, sd = np.sqrt(np.mean(errors[:, :3] ** 2, axis=0)), np.sqrt(np.diag(covariance))
    return rmse, p, sd, 1 - left / np.sum(pose**2)


def _spread(
    residual: Float[np.ndarray, "K 6"],
    lateness: Float[np.ndarray, "K 6 6"],
    weights: Float[np.ndarray, " K"],
    spread: Float[np.ndarray, "6 6"],
) -> Float[np.ndarray, "6 6"]:
    """Return the covariance that jitter does not explain, given its last estimate."""
    gain = spread @ np.linalg.inv(spread + lateness)
    left = np.einsum("kij,kj->ki", gain, residual)
    found = (weights[:, None] * left).T @ left
    found += np.tensordot(weights, spread - gain @ spread, 1)
    # Residuals are smaller than errors by what the parameters absorb.
    found = found / weights.sum() * (1 + len(spread) / len(residual))
    return found + np.diag(np.full(6, _LEAST))
