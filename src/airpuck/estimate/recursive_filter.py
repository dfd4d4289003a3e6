"""The books of an estimator that goes from measurement to measurement.

Commands act a transport delay after they were sent, measurements come at any time and may come
late ("out of sequence"). What is believed of the craft, and how a measurement changes that, is the
business of `airpuck.estimate.kalman` and `airpuck.estimate.actuation_filter`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from airpuck.compute.compiled import program
from airpuck.estimate.estimator import Estimate
from airpuck.model.model_file import Model
from airpuck.physics.motor import motor_step

#: Pieces of time with one command each that a call handles: few, so that programs stay small. A
#: command begins to act between two poses of 240 Hz nearly half of the time.
PIECES_TO_PREDICT, PIECES_TO_MEASURE = 3, 2
#: How late a measurement may come where sensors have different latencies [s].
_REMEMBERED = 0.1

#: What is believed: arrays that are never written to.
Belief = tuple[np.ndarray, ...]
#: Time, belief, motor speeds, the command that acts, how many have begun to.
_State = tuple[float, Belief, Float[np.ndarray, " n"], Float[np.ndarray, " n"], int]
#: Durations [s] and commands of pieces of time.
Pieces = tuple[Float[np.ndarray, " S"], Float[np.ndarray, "S n"]]


class RecursiveFilter(ABC):
    """Estimates state, motor speeds and disturbance; uses nothing from the future."""

    def __init__(self, model: Model, compiled: bool) -> None:
        self.model = model
        self._compiled = compiled
        #: The prediction with nothing that follows; made by each kind when it is ready to.
        self._predict: Callable[..., Any]
        self._idle = np.full(model.vehicle.n_propellers, model.vehicle.command_min)
        self.reset()

    @abstractmethod
    def _begun(
        self, pose: Float[np.ndarray, " 3"], before: Belief | None, elapsed: float
    ) -> Belief:
        """Return what is believed at a pose, at rest, a time after something else was believed."""

    @abstractmethod
    def _advanced(
        self, belief: Belief, speed: Float[np.ndarray, " n"], pieces: Pieces
    ) -> tuple[Belief, Float[np.ndarray, " n"]]:
        """Return belief and motor speeds after at most `PIECES_TO_PREDICT` pieces of time."""

    @abstractmethod
    def _with_pose(
        self,
        belief: Belief,
        speed: Float[np.ndarray, " n"],
        pieces: Pieces,
        pose: Float[np.ndarray, " 3"],
    ) -> tuple[Belief, Float[np.ndarray, " n"], Float[np.ndarray, " 3"]]:
        """Return both after at most `PIECES_TO_MEASURE` pieces and a pose, and the innovation."""

    @abstractmethod
    def _with_imu(
        self,
        belief: Belief,
        speed: Float[np.ndarray, " n"],
        acceleration_body: Float[np.ndarray, " 2"],
        gyro: float,
        noise: tuple[float, float],
    ) -> Belief:
        """Return what is believed after an inertial measurement."""

    @abstractmethod
    def _with_mouse(
        self, belief: Belief, velocity: Float[np.ndarray, " 2"], noise: float
    ) -> Belief:
        """Return what is believed after a measured velocity."""

    @abstractmethod
    def _prediction(self) -> Callable[..., tuple[Any, ...]]:
        """Return what is predicted as a pure function.

        Of an array namespace, belief, motor speeds, and durations and commands of
        `PIECES_TO_PREDICT` pieces; to state, motor speeds, disturbance, effectiveness of the
        motors, and what else an estimate says.
        """

    @abstractmethod
    def _estimate(self, time: float, results: Sequence[Any]) -> tuple[Estimate, Sequence[Any]]:
        """Return the estimate that says what is predicted, and the results that follow."""

    def reset(self) -> None:
        """Forget everything."""
        self._time: float | None = None
        self._belief: Belief = ()
        self._motor_speed = self._idle
        self._acting = self._idle
        #: Commands on their way: when they begin to act, and what they are.
        self._pending: deque[tuple[float, Float[np.ndarray, " n"]]] = deque()
        #: Time of the motor speeds where they have left the rest behind.
        self._motors_at: float | None = None
        #: Measurements and the filter before each: stamp, state, method, arguments.
        self._history: deque[tuple[float, _State, str, tuple[Any, ...]]] = deque()
        self._remembers = False
        #: How many commands have begun to act, and those that the history may need again.
        self._count = 0
        self._recent: deque[tuple[float, Float[np.ndarray, " n"]]] = deque()

    @property
    def time(self) -> float | None:
        """Time of the last measurement; None before the first pose [s]."""
        return self._time

    def command(self, time: float, command: Float[np.ndarray, " n"]) -> None:
        """Take note of a command that was sent."""
        begins = time + self.model.transport_delay
        # Commands that would begin later than this one, which was sent after them, had wrong times.
        while self._pending and self._pending[-1][0] >= begins:
            self._pending.pop()
        self._pending.append((begins, np.array(command, dtype=float)))

    def run_motors(self, time: float) -> None:
        """Go through all commands that began to act before a time, for the motors only.

        Where that is later than the last measurement, the rest of the state is lost: the next pose
        begins anew.
        """
        while self._pending and self._pending[0][0] <= time:
            begins, command = self._pending.popleft()
            self._turn_motors(begins)
            self._acting = command

    def _turn_motors(self, time: float) -> None:
        """Let the motors run under the command that acts until a time, if it is later."""
        last = self._time if self._motors_at is None else self._motors_at
        if last is not None and time <= last:
            return
        if last is not None:
            tau = self.model.dynamics.motor_time_constant
            self._motor_speed = motor_step(np, self._motor_speed, self._acting, time - last, tau)
        self._motors_at = time
        self._forget()

    def pose(
        self,
        time: float,
        pose: Float[np.ndarray, " 3"],
        gate: tuple[float, float, float] | None = None,
    ) -> bool:
        """Use a measured pose."""
        if self._time is None or self._motors_at is not None:
            self.restart(time, pose)
            return True
        if time < self._time:
            return self._late(time, "pose", (time, np.array(pose, dtype=float), gate))
        belief, speed, pieces, used = self._pieces(time, PIECES_TO_MEASURE)
        belief, speed, innovation = self._with_pose(belief, speed, pieces, pose)
        if gate is not None:
            x, y, yaw = innovation.tolist()
            if abs(x) > gate[0] or abs(y) > gate[1] or abs(yaw) > gate[2]:
                return False
        before = self._state() if self._remembers else None
        self._settle(used)
        self._belief, self._motor_speed, self._time = belief, speed, time
        if before is not None:
            # It was plausible once: a late measurement must not change that.
            self._remember(before, "pose", (time, np.array(pose, dtype=float)))
        return True

    def imu(
        self,
        time: float,
        acceleration_body: Float[np.ndarray, " 2"],
        gyro: float,
        noise: tuple[float, float],
    ) -> None:
        """Use an inertial measurement."""
        given = time, np.array(acceleration_body, dtype=float), gyro, noise
        before = self._prepare(time, "imu", given)
        if before is None:
            return
        self._advance(time)
        self._belief = self._with_imu(self._belief, self._motor_speed, *given[1:])
        self._remember(before, "imu", given)

    def mouse(self, time: float, velocity: Float[np.ndarray, " 2"], noise: float) -> None:
        """Use the velocity that the optical sensor under the craft measured."""
        given = time, np.array(velocity, dtype=float), noise
        before = self._prepare(time, "mouse", given)
        if before is None:
            return
        self._advance(time)
        self._belief = self._with_mouse(self._belief, *given[1:])
        self._remember(before, "mouse", given)

    def predict(self, time: float) -> Estimate:
        """Predict with the commands that are known, without changing anything."""
        return self.predict_with(self._predict, time)[0]

    def composed(self, then: Callable[..., Any], *examples: Any) -> Callable[..., Any]:
        """Join a prediction and what follows in one program: each call costs time."""
        predict = self._prediction()
        pieces = _arrays([(0.0, self._idle)], PIECES_TO_PREDICT)
        believed = *self._begun(np.zeros(3), None, 0.0), self._idle, *pieces
        count = len(believed)

        def both(xp: Any, *given: Any) -> tuple[Any, ...]:
            predicted = predict(xp, *given[:count])
            return *predicted, *then(xp, *predicted[:4], *given[count:])

        return program(both, *believed, *examples, compiled=self._compiled)

    def predict_with(
        self, composed: Callable[..., Any], time: float, *more: Any
    ) -> tuple[Estimate, Sequence[Any]]:
        """Predict, and compute what follows from it."""
        belief, speed, pieces, _ = self._pieces(time, PIECES_TO_PREDICT)
        return self._estimate(time, composed(*belief, speed, *pieces, *more))

    def restart(self, time: float, pose: Float[np.ndarray, " 3"]) -> None:
        """Begin anew at a pose, at rest; commands and motor speeds are kept."""
        if self._time is not None and time < self._time and self._motors_at is None:
            self._rewind(time)
        before, elapsed = None, 0.0
        if self._time is not None:
            before, elapsed = self._belief, max(time - self._time, 0.0)
        self.run_motors(time)
        self._turn_motors(time)
        self._motors_at = None
        self._forget()
        self._time = time
        self._belief = self._begun(pose, before, elapsed)

    def _advance(self, time: float) -> None:
        """Move everything to a later time without a measurement."""
        belief, speed, pieces, used = self._pieces(time, PIECES_TO_PREDICT)
        self._belief, self._motor_speed = self._advanced(belief, speed, pieces)
        self._settle(used)
        self._time = time

    def _settle(self, used: int) -> None:
        """Take commands off the list that have begun to act."""
        for _ in range(used):
            begun = self._pending.popleft()
            self._acting = begun[1]
            if self._remembers:
                self._count += 1
                self._recent.append(begun)

    def _state(self) -> _State:
        """Return what a measurement changes; the arrays are never written to."""
        assert self._time is not None
        return self._time, self._belief, self._motor_speed, self._acting, self._count

    def _prepare(self, time: float, kind: str, given: tuple[Any, ...]) -> _State | None:
        """Return the state to remember before a measurement; None if nothing is left to do."""
        if self._time is None or self._motors_at is not None:
            return None
        self._remembers = True
        if time < self._time:
            self._late(time, kind, given)
            return None
        return self._state()

    def _remember(self, before: _State, kind: str, given: tuple[Any, ...]) -> None:
        """Note a measurement that was used, and let go of old ones."""
        history, time = self._history, given[0]
        history.append((time, before, kind, given))
        while history[0][0] < time - _REMEMBERED:
            history.popleft()
        while self._count - len(self._recent) < history[0][1][-1]:
            self._recent.popleft()

    def _forget(self) -> None:
        """Let go of everything that was remembered."""
        self._history.clear()
        self._recent.clear()

    def _late(self, time: float, kind: str, given: tuple[Any, ...]) -> bool:
        """Use a measurement from before the last one; say whether it was used."""
        later = self._rewind(time)
        if later is None:
            return False
        used = getattr(self, kind)(*given)
        for again, arguments in later:
            getattr(self, again)(*arguments)
        return used is not False

    def _rewind(self, time: float) -> list[tuple[str, tuple[Any, ...]]] | None:
        """Go back to before all measurements later than a time, and return these.

        None, and nothing is changed, where that is not remembered.
        """
        history = self._history
        count = sum(entry[0] > time for entry in history)
        if count == 0 or history[-count][1][0] > time:
            return None
        state, later = history[-count][1], [entry[2:] for entry in list(history)[-count:]]
        for _ in range(count):
            history.pop()
        self._time, self._belief, self._motor_speed, self._acting, begun = state
        for _ in range(self._count - begun):
            self._pending.appendleft(self._recent.pop())
        self._count = begun
        return later

    def _pieces(
        self, time: float, most: int
    ) -> tuple[Belief, Float[np.ndarray, " n"], Pieces, int]:
        """Cut the time until `time` where commands change.

        Returns belief and motor speeds, the durations and commands of the last `most` pieces, and
        how many pending commands have begun to act. Earlier pieces are gone through already.
        """
        assert self._time is not None
        pieces, now, acting, used = [], self._time, self._acting, 0
        for begins, command in self._pending:
            if begins > time:
                break
            if begins > now:
                pieces.append((begins - now, acting))
                now = begins
            acting = command
            used += 1
        pieces.append((time - now, acting))
        belief, speed = self._belief, self._motor_speed
        early = max(len(pieces) - most, 0)
        for first in range(0, early, PIECES_TO_PREDICT):
            some = pieces[first : min(first + PIECES_TO_PREDICT, early)]
            belief, speed = self._advanced(belief, speed, _arrays(some, PIECES_TO_PREDICT))
        return belief, speed, _arrays(pieces[early:], most), used


def _arrays(pieces: list[tuple[float, Float[np.ndarray, " n"]]], size: int) -> Pieces:
    """Lay pieces out as arrays of a fixed size, filled up with pieces of no length."""
    filled = pieces + [(0.0, pieces[-1][1])] * (size - len(pieces))
    durations, commands = zip(*filled, strict=True)
    return np.array(durations), np.array(commands)
