"""How well a model fits the craft that flies: errors of prediction, motors, delay, as it goes."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float

from airpuck.control.tuning import Estimation, default_tuning
from airpuck.craft.table import Table
from airpuck.estimate.kalman import KalmanFilter
from airpuck.flight.deviations import Deviations, Judged, deviations
from airpuck.model.model_file import Model
from airpuck.physics.angle import pose_difference
from airpuck.physics.rigid_body import Dynamics, acceleration_map
from airpuck.physics.rollout import rollout
from airpuck.physics.thrust import thrust

#: Time between predictions, as a share of the horizon.
_APART = 0.5
#: The filter's view is used when it has watched for this long [s].
_SETTLED = 0.3
#: Without a pose or a command for this long, what the motors do is not known [s].
_SILENT = 0.1
#: A craft this near to a rail may be leaning on it [m].
_AT_RAIL = 0.01
#: Largest difference of a pose from its prediction that is no jump [m, m, rad].
_JUMP = (0.05, 0.05, 0.5)
#: Deviations are told from four standard deviations on, and from these sizes on [1, s]: jitter of
#: the radio that is not white makes a few milliseconds of delay come and go.
_CERTAIN, _LOSS, _LATE = 4.0, 0.05, 0.006
#: Shares of the squared error that are told.
_NOTABLE = 0.1
#: As many predictions are needed to tell.
_ENOUGH = 20
#: Predictions are forgotten after as many times the memory.
_OLD = 3.0
#: Steps of the differences that say what effectiveness and delay do [1, s].
_LOSS_STEP, _DELAY_STEP = 0.05, 0.004
#: Commands from before a prediction that may still matter to it [s].
_BEFORE = 0.06


@dataclass(frozen=True, eq=False)
class Health:
    """What a model got wrong in the last seconds, and what that says of the craft."""

    #: Names of the propellers.
    motors: tuple[str, ...]
    #: Whether the craft is watched: poses and commands come, and no rail is near.
    flying: bool
    #: How far ahead is predicted [s].
    horizon: float
    #: Errors of prediction, effectiveness of each motor, delay.
    found: Deviations

    @property
    def findings(self) -> tuple[str, ...]:
        """What differs from the model beyond doubt, in words: four standard deviations."""
        if self.found.predictions < _ENOUGH:
            return ()
        told = [
            f"propeller {name} at {100 * e:.0f} % ± {100 * sd:.0f} %"
            for name, e, sd in zip(
                self.motors, self.found.effectiveness, self.found.deviation, strict=True
            )
            if abs(e - 1) > max(_CERTAIN * sd, _LOSS)
        ]
        late, sd = self.found.delay, self.found.delay_deviation
        if abs(late) > max(_CERTAIN * sd, _LATE):
            word = "longer" if late > 0 else "shorter"
            told.append(
                f"delay {1e3 * abs(late):.0f} ms ± {1e3 * sd:.0f} ms {word} than the model's"
            )
        return tuple(told)

    def __str__(self) -> str:
        if not self.flying:
            return "nothing to judge: needs poses and commands of a craft in flight"
        if not self.found.predictions:
            return "no prediction judged yet"
        x, y, yaw = self.found.error.tolist()
        told = (
            f"after {self.horizon:g} s: x {1e3 * x:.1f} mm, y {1e3 * y:.1f} mm, yaw {yaw:.3f} rad; "
            + (", ".join(self.findings) or "motors and delay as the model says")
        )
        causes = zip((*self.motors, "delay"), self.found.share, strict=True)
        largest = [f"{name} {100 * share:.0f} %" for name, share in causes if share > _NOTABLE]
        return told + (f"; shares of the error: {', '.join(largest)}" if largest else "")

    def to_json(self) -> Mapping[str, Any]:
        """Return the figures for ``--json``."""

        def number(value: float) -> float | None:
            return float(value) if math.isfinite(value) else None

        found = self.found
        return {
            "flying": self.flying,
            "horizon_s": self.horizon,
            "predictions": found.predictions,
            "rmse_m_m_rad": [number(e) for e in found.error],
            "propellers": {
                name: {
                    "effectiveness": number(found.effectiveness[i]),
                    "deviation": number(found.deviation[i]),
                    "error_share": number(found.share[i]),
                }
                for i, name in enumerate(self.motors)
            },
            "delay": {
                "difference_s": number(found.delay),
                "deviation_s": number(found.delay_deviation),
                "error_share": number(found.share[-1]),
            },
            "findings": list(self.findings),
        }


@dataclass(frozen=True, eq=False)
class _Begun:
    """A prediction whose end has not been seen."""

    time: float
    state: Float[np.ndarray, " z"]


class HealthMonitor:
    """Watches a craft in flight beside its model; computes nothing that flies."""

    def __init__(
        self,
        model: Model,
        *,
        estimation: Estimation | None = None,
        horizon: float = 0.2,
        memory: float = 5.0,
        jitter: float = 0.007,
        table: Table | None = None,
        compiled: bool = True,
    ) -> None:
        self.model = model
        self._horizon, self._memory, self._jitter = horizon, memory, jitter
        noise = (estimation or default_tuning().estimation).noise
        self._filter = KalmanFilter(model, noise, compiled=compiled)
        reach = (table or Table()).reach(model.vehicle.radius_m)
        self._free = np.array(reach) - _AT_RAIL
        n = model.vehicle.n_propellers
        stronger = 1 + _LOSS_STEP * np.eye(n, 1 + n, 1)
        self._dynamics = _batch(model.dynamics, stronger)
        self._nominal = _batch(model.dynamics, stronger[:, :1])
        #: Commands by when they begin to act, back to the first prediction's beginning.
        self._commands: deque[tuple[float, Float[np.ndarray, " n"]]] = deque()
        self._commanded = -math.inf
        self._since: float | None = None
        self._begun: deque[_Begun] = deque()
        self._judged: deque[Judged] = deque()

    def command(self, time: float, command: Float[np.ndarray, " n"]) -> None:
        """Take note of a command."""
        if not np.isfinite(command).all():
            return
        self._filter.command(time, command)
        self._commanded = time
        begins = time + self.model.transport_delay
        while self._commands and self._commands[-1][0] >= begins:
            self._commands.pop()
        self._commands.append((begins, np.array(command, dtype=float)))

    def pose(self, time: float, pose: Float[np.ndarray, " 3"]) -> None:
        """Take note of a pose."""
        last = self._filter.time
        if not np.isfinite(pose).all() or (last is not None and time <= last):
            return
        blind = last is None or time - last > _SILENT or time - self._commanded > _SILENT
        if blind or (np.abs(pose[:2]) > self._free).any():
            self._lose_sight(time, pose)
            return
        if self._since is None:
            self._since = time
        if not self._filter.pose(time, pose, _JUMP):
            return
        newest = self._begun[-1].time if self._begun else -math.inf
        ends = bool(self._begun) and time - self._begun[0].time >= self._horizon
        begins = time - self._since >= _SETTLED and time - newest >= _APART * self._horizon
        if ends or begins:
            estimate = self._filter.predict(time)
            if ends:
                self._judge(self._begun.popleft(), time, estimate.state)
            if begins:
                state = np.concatenate([estimate.state, estimate.motor_speed])
                self._begun.append(_Begun(time, state))
        self._forget(time)

    def health(self) -> Health:
        """Say how the craft is."""
        found = deviations(
            tuple(self._judged),
            self.model.vehicle.n_propellers,
            memory=self._memory,
            overlap=1 / _APART,
            jitter=self._jitter,
            radius=self.model.radius_of_gyration,
        )
        return Health(
            self.model.vehicle.propeller_names,
            self._since is not None,
            self._horizon,
            found,
        )

    def _lose_sight(self, time: float, pose: Float[np.ndarray, " 3"]) -> None:
        """Begin anew; what was found out is kept until it is too old."""
        self._filter.restart(time, pose)
        self._since = None
        self._begun.clear()
        self._forget(time)

    def _judge(self, begun: _Begun, end: float, state: Float[np.ndarray, " 6"]) -> None:
        """Compare a prediction with the state at its end."""
        predicted = self._predicted(self._dynamics, begun, end)
        late = self._predicted(self._nominal, begun, end, _DELAY_STEP)
        error = pose_difference(np, state, predicted[:, 0])
        by_motor = (predicted[:, 1:] - predicted[:, :1]) / _LOSS_STEP
        by_delay = (late - predicted[:, :1]) / _DELAY_STEP
        slopes = np.hstack([by_motor, by_delay])
        self._judged.append(Judged(end, error, slopes, self._impulses(begun, end)))

    def _predicted(
        self, dynamics: Dynamics, begun: _Begun, end: float, late: float = 0.0
    ) -> Float[np.ndarray, "6 b"]:
        """Predict the state with a batch of dynamics, commands acting later than they should."""
        before = [c for t, c in self._commands if t + late <= begun.time]
        within = [(t + late, c) for t, c in self._commands if begun.time < t + late < end]
        acting = before[-1] if before else begun.state[6:]
        durations = np.diff([begun.time, *(t for t, _ in within), end])
        commands = np.array([acting, *(c for _, c in within)])[..., None]
        batch = dynamics.thrust.shape[-1]
        start = np.repeat(begun.state[:, None], batch, axis=1)
        held = np.broadcast_to(commands, (*commands.shape[:2], batch))
        return rollout(np, dynamics, start, held, durations)[-1, :6]

    def _impulses(self, begun: _Begun, end: float) -> Float[np.ndarray, "6 6"]:
        """Say what the lateness of single packets does: the thrust that each changes, missing."""
        dynamics, tau = self.model.dynamics, float(self.model.dynamics.motor_time_constant)
        since = [(t, c) for t, c in self._commands if t < end]
        if len(since) < 2:
            return np.zeros((6, 6))
        times = np.array([t for t, _ in since[1:]])
        thrusts = thrust(dynamics.thrust, np.array([c for _, c in since]).T)
        matrix, _ = acceleration_map(np, dynamics, begun.state[2], begun.state[5])
        left = end - np.maximum(times, begun.time)
        # What motors with lag have not done before the beginning, and what they do before the end.
        lag = max(tau, 1e-6)
        acts = np.exp(-np.maximum(begun.time - times, 0) / lag) - np.exp(-(end - times) / lag)
        velocity = matrix @ np.diff(thrusts, axis=1) * acts
        lost = np.vstack([velocity * left, velocity])
        return lost @ lost.T

    def _forget(self, time: float) -> None:
        """Let go of what is too old."""
        while self._judged and self._judged[0].time < time - _OLD * self._memory:
            self._judged.popleft()
        needed = (self._begun[0].time if self._begun else time) - _BEFORE
        while len(self._commands) > 1 and self._commands[1][0] <= needed:
            self._commands.popleft()


def _batch(dynamics: Dynamics, factors: Float[np.ndarray, "n b"]) -> Dynamics:
    """Return a batch of craft whose thrusts are scaled, motor by motor."""
    return replace(
        dynamics,
        thrust=np.asarray(dynamics.thrust)[..., None] * factors[:, None],
        configuration=np.asarray(dynamics.configuration)[..., None],
        center_of_mass=np.asarray(dynamics.center_of_mass)[..., None],
    )
