"""Arrival times of single packets: how much later or earlier than the transport delay.

The arrival of a packet that switches motors is visible in the poses. If the packet is late by δ,
the craft ends up slower by δ times the change of acceleration. A regression estimates δ for each
packet.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from jaxtyping import Float, Int

from airpuck.data.sampling import mean_hold
from airpuck.data.trajectory import Trajectory
from airpuck.deviation.motor_regression import (
    accelerations_along,
    accelerations_by_motor,
    normal_equations,
    solved,
    twice_integrated,
)
from airpuck.model.model_file import Model
from airpuck.physics.motor import lag_decay, motor_speeds

#: Time before the expected arrival, and total time, long enough for the motors' response [s].
_LEAD, _LENGTH = 8 / 240, 32 / 240
#: Smallest change of a command that switches a motor.
_SWITCH = 0.1
#: Largest useful standard error of a packet's delay [s].
_KNOWN = 4e-3
#: Packets later or earlier than this were lost, or their motors did not respond [s].
_LOST = 0.06
#: Fewest samples around an arrival: a line needs two, and estimating the noise needs more.
_FEWEST = 6
#: Assumed error of other packets nearby, as a standard deviation [s]; how long before the window
#: they still matter [s]; and the largest number on either side.
_USUAL, _BEFORE, _MOST = 0.01, 0.03, 16
#: Assumed relative errors of each motor's thrust and of the inertia in a window, as standard
#: deviations.
_SHARE = 0.03
#: Multiple of the typical misfit above which a late packet alone cannot be the cause.
_MISFIT = 9.0
#: Step of the difference quotients of speed, and number of Gauss-Newton iterations.
_STEP, _PASSES = 1e-6, 3
#: `_KNOWN`, `_SHARE` and `_PASSES` of a thorough search.
_THOROUGH = 12e-3, 1.0, 8
#: Most windows that are regressed together; each takes some 0.2 MB.
_BATCH = 512
#: Squared densities of the disturbance to try, per variance of the pose [1/s³].
_RATIOS = np.concatenate([[0.0], np.logspace(2, 9, 57)])


@dataclass(frozen=True, eq=False)
class PacketDelays:
    """Arrival times of packets relative to the mean delay."""

    #: Indices of the packets in ``Trajectory.command``, increasing.
    packet: Int[np.ndarray, " B"]
    #: Arrival minus the arrival that the model's delay predicts [s].
    deviation: Float[np.ndarray, " B"]
    #: Standard error of the deviation, from the noise of the poses and unmodelled motion [s].
    standard_error: Float[np.ndarray, " B"]

    def __len__(self) -> int:
        return len(self.packet)


#: No packet's arrival is known.
UNKNOWN = PacketDelays(np.zeros(0, dtype=int), np.zeros(0), np.zeros(0))


def delay_for(model: Model, trajectory: Trajectory) -> float:
    """Return how long after its time in a trajectory a command acts, according to a model."""
    if not model.delay_learned:
        return trajectory.delay
    return trajectory.acting_delay(model.transport_delay, model.vehicle.nominal.transport_delay_s)


def commands_at(trajectory: Trajectory, delay: float) -> Float[np.ndarray, "N n"]:
    """Return the mean command over each step, if all act after a delay [s]."""
    return mean_hold(trajectory.command_time + delay, trajectory.command, trajectory.time)[0]


def packet_delays(trajectory: Trajectory, model: Model, *, thorough: bool = False) -> PacketDelays:
    """Estimate packet arrival times from the poses around packets that switched a motor.

    Over the samples around an arrival the poses are

        y = p + v t + ∬ a + Σⱼ δⱼ ∬ ∂a/∂δⱼ + noise,

    where a are the modelled accelerations along the measured yaw; p, v and the δ of all packets
    nearby are unknown. The δ get a prior of 10 ms, which is removed from the results. The noise
    consists of the poses' noise and of white accelerations that the model does not explain; both
    sizes are fitted to the residuals of the recording (maximum likelihood). A `thorough`
    search also finds packets that are very late, or less well known, and motors of any strength.
    """
    near = _surroundings(trajectory, model)
    if near is None:
        return UNKNOWN
    late = np.zeros(len(trajectory.command_time))
    known, share, passes = _THOROUGH if thorough else (_KNOWN, _SHARE, _PASSES)
    found = _regressed(near, late, share=share)
    for _ in range(passes - 1):
        late[found.packet] = np.clip(found.late, -_LOST, _LOST)
        found = _regressed(near, late, found, share)
    # Estimates without the prior.
    gain = np.maximum(found.gain, 1e-12)
    error, deviation = np.sqrt(found.variance / gain), found.late / gain
    good = (found.usual | thorough) & (np.abs(deviation) < _LOST) & (error < known)
    return PacketDelays(found.packet[good], deviation[good], error[good])


def delay_response(
    trajectory: Trajectory, model: Model, delays: PacketDelays, modelled: Float[np.ndarray, "P N 3"]
) -> Float[np.ndarray, "P B"]:
    """Return the derivative of the estimated delays with respect to the modelled accelerations.

    Another delay of the model moves the first and last arrivals beyond the poses: their derivative
    is zero.
    """
    near = _surroundings(trajectory, model)
    if near is None or not len(delays):
        return np.zeros((len(modelled), len(delays)))
    late = np.zeros(len(trajectory.command_time))
    late[delays.packet] = delays.deviation
    found = _regressed(near, late)
    number = np.searchsorted(found.packet[:-1], delays.packet)
    seen = found.packet[number] == delays.packet
    return np.where(seen, found.response(number, modelled), 0.0)


def moved(
    trajectory: Trajectory, packet: Int[np.ndarray, " B"], late: Float[np.ndarray, " B"]
) -> Trajectory:
    """Move packets by a time [s]; the others keep theirs, but do not overtake these."""
    time = trajectory.command_time.copy()
    time[packet] += late
    earliest, latest = np.full_like(time, -np.inf), np.full_like(time, np.inf)
    earliest[packet] = latest[packet] = time[packet]
    earliest = np.maximum.accumulate(earliest)
    latest = np.minimum.accumulate(latest[::-1])[::-1]
    return replace(trajectory, command_time=np.maximum.accumulate(np.clip(time, earliest, latest)))


def _surroundings(trajectory: Trajectory, model: Model) -> _Surroundings | None:
    """Return the samples around all switches; None if no packet's delay can be estimated."""
    if not float(model.dynamics.motor_time_constant) > 0:
        return None
    arrival = trajectory.command_time + delay_for(model, trajectory)
    change = np.diff(trajectory.command, axis=0, prepend=trajectory.command[:1])
    packet = np.flatnonzero(np.abs(change).max(axis=1) > _SWITCH)
    if trajectory.steps(_LENGTH) < _FEWEST:
        return None
    first = np.searchsorted(trajectory.time, arrival[packet]) - trajectory.steps(_LEAD)
    length = trajectory.steps(_LENGTH)
    whole = np.isin(first, trajectory.window_starts(length))
    # Poses that are interpolated across many lost frames tell of no packet.
    lost = np.concatenate([[0], np.cumsum(~trajectory.bridged)])
    whole[whole] = lost[first[whole] + length] == lost[first[whole]]
    if not whole.any():
        return None
    return _Surroundings(trajectory, model, arrival, change, packet[whole], first[whole])


class _Surroundings:
    """The samples around B switches, and the m packets near each."""

    def __init__(
        self,
        trajectory: Trajectory,
        model: Model,
        arrival: Float[np.ndarray, " K"],
        change: Float[np.ndarray, "K n"],
        packet: Int[np.ndarray, " B"],
        first: Int[np.ndarray, " B"],
    ) -> None:
        self._trajectory, self._dynamics = trajectory, model.dynamics
        self._arrival, self._change = arrival, change
        length = trajectory.steps(_LENGTH)
        #: Indices of the samples, (E, B).
        self.index = first + np.arange(length)[:, None]
        self.components = _Components(trajectory.sample_period, length)
        self._lag = float(model.dynamics.motor_time_constant)
        held, _ = mean_hold(arrival, trajectory.command, trajectory.time)
        self._speed = motor_speeds(
            trajectory.time, held, model.dynamics.lag, model.dynamics.idle_lag
        )
        period = np.median(np.diff(arrival))
        before, after = (
            int(min(np.ceil(reach / period), _MOST)) for reach in (_LEAD + _BEFORE, _LENGTH - _LEAD)
        )
        near = packet + np.arange(-before, after + 1)[:, None]
        self._there = (near >= 0) & (near < len(arrival))
        #: Indices of the packets nearby, (m, B).
        self.packet = np.clip(near, 0, len(arrival) - 1)

    def linearised(
        self, late: Float[np.ndarray, " K"], windows: Int[np.ndarray, " W"]
    ) -> tuple[Float[np.ndarray, "k 3 W"], Float[np.ndarray, "k 3 u W"]]:
        """Return components of poses minus predicted ones, and their derivatives.

        The u unknowns are each δ, and the relative excess strength of each motor and of all
        moments.
        """
        index, packet = self.index[:, windows], self.packet[:, windows]
        time, state = self._trajectory.time[index], self._trajectory.state[index]
        state, duration = np.moveaxis(state, -1, 1), np.diff(time, axis=0)
        change = self._change[packet] * self._there[:, windows, None]
        change = np.moveaxis(change, -1, 0)
        planned = time[:, None] - self._arrival[packet]
        since = planned - late[packet]
        answer = self._answer(since)
        speed = np.moveaxis(self._speed[index], -1, 1)
        speed = speed + np.einsum("nmb,emb->enb", change, answer - self._answer(planned))
        modelled = accelerations_along(self._dynamics, state, speed)
        # A packet that arrives later removes what the motors gain at this moment.
        gain = np.where(since > 0, answer - 1, 0) / self._lag
        steps = _STEP * np.eye(speed.shape[1])[..., None]
        by_speed = [
            (accelerations_along(self._dynamics, state, speed + step) - modelled) / _STEP
            for step in steps
        ]
        slope = np.einsum("necb,nmb->ecmb", by_speed, change) * gain[:, None]
        by_motor, _ = accelerations_by_motor(self._dynamics, state, speed)
        turning = np.zeros_like(by_motor[:, :, :1])
        turning[:, 2, 0] = by_motor[:, 2].sum(axis=1)
        residual = state[:, :3] - twice_integrated(modelled, duration)
        slope = np.concatenate([slope, by_motor, turning], axis=2)
        return self.components.of_poses(residual), self.components.of_accelerations(slope)

    def _answer(self, since: Float[np.ndarray, "E m B"]) -> Float[np.ndarray, "E m B"]:
        """Speed of a motor after a unit step of its command."""
        return 1 - lag_decay(np, np.maximum(since, 0.0), self._lag)


class _Components:
    """Components of E poses in which noise is uncorrelated and straight lines are removed.

    Their variance is r (1 + λ d) for poses of variance r and accelerations of squared density λ r.
    """

    def __init__(self, step: float, length: int) -> None:
        self._integral = twice_integrated(np.eye(length), np.full((length - 1, 1), step))
        line = np.stack([np.ones(length), np.linspace(-1, 1, length)], axis=1)
        rest = np.linalg.qr(line, mode="complete")[0][:, 2:].T
        spread = rest @ self._integral
        spectrum, vectors = np.linalg.eigh(spread @ spread.T / step)
        self._matrix, self._spectrum = vectors.T @ rest, np.maximum(spectrum, 0.0)

    def of_poses(self, values: Float[np.ndarray, "E *shape"]) -> Float[np.ndarray, "k *shape"]:
        """Return the components of poses."""
        return np.tensordot(self._matrix, values, 1)

    def of_accelerations(
        self, values: Float[np.ndarray, "E *shape"]
    ) -> Float[np.ndarray, "k *shape"]:
        """Return the components of the poses that result from accelerations."""
        return np.tensordot(self._matrix @ self._integral, values, 1)

    def variances(self, rest: Float[np.ndarray, "k 3 B"]) -> Float[np.ndarray, "k 3"]:
        """Find the most likely variance of every component, the same for x and y."""
        power = np.mean(rest**2, axis=2)
        growth = 1 + _RATIOS[:, None] * self._spectrum
        found = []
        for own in (power[:, :2].mean(axis=1), power[:, 2]):
            variance = np.mean(own / growth, axis=1)
            best = np.argmin(len(own) * np.log(variance) + np.log(growth).sum(axis=1))
            found.append(variance[best] * growth[best])
        return np.stack([found[0], found[0], found[1]], axis=1)


class _Regression:
    """Regularised least squares for the delays of m packets nearby and other errors."""

    def __init__(
        self,
        near: _Surroundings,
        late: Float[np.ndarray, " K"],
        linearised: Callable[[int, int], tuple[np.ndarray, np.ndarray]],
        variance: Float[np.ndarray, "k 3"],
        share: float,
    ) -> None:
        self._near, self._late, self._share = near, late.copy(), share
        self._weight = 1 / np.sqrt(variance)
        m, rest, steps, spreads = len(near.packet), [], [], []
        for windows in _batches(near.packet.shape[1]):
            residual, slope = linearised(windows[0], windows[-1] + 1)
            _, step, covariance = self._solve(residual, slope, windows)
            rest.append(residual - np.einsum("kcjb,jb->kcb", slope, step))
            steps.append(step[:m])
            spreads.append(np.diagonal(covariance, axis1=1, axis2=2).T[:m])
        #: Remaining residuals, (k, 3, B).
        self.rest = np.concatenate(rest, axis=2)
        misfit = np.mean(self.rest**2 / variance[..., None], axis=(0, 1))
        #: Whether packet delays alone explain the poses, (B,).
        self.where_usual = misfit < _MISFIT * np.median(misfit)
        step, spread = np.concatenate(steps, axis=1), np.concatenate(spreads, axis=1)
        order = np.argsort(spread, axis=None, kind="stable")
        #: Indices of the D packets, increasing.
        self.packet, first = np.unique(near.packet.ravel()[order], return_index=True)
        # For each packet, its number in the window that determines it best, and this window.
        self._best = row, column = np.unravel_index(order[first], spread.shape)
        #: For each packet: delay [s], its variance [s²], and whether the estimate is reliable.
        self.late, self.variance = late[self.packet] + step[row, column], spread[row, column]
        self.usual = self.where_usual[column]
        #: Fraction of a delay that is recovered; the prior removes the rest.
        self.gain = 1 - self.variance / _USUAL**2

    def response(
        self, number: Int[np.ndarray, " D"], modelled: Float[np.ndarray, "P N 3"]
    ) -> Float[np.ndarray, "P D"]:
        """Return the derivative of delays by the modelled accelerations, without the prior."""
        found = np.zeros((len(modelled), len(number)))
        for part in _batches(len(number)):
            row, windows = (best[number[part]] for best in self._best)
            change = np.moveaxis(modelled[:, self._near.index[:, windows]], (1, 3, 0), (0, 1, 2))
            aim = self._aim(self._near.components.of_accelerations(-change))
            rows, _, covariance = self._solve(*self._near.linearised(self._late, windows), windows)
            own = covariance[np.arange(len(row)), row]
            found[:, part] = (own[:, None] @ np.swapaxes(rows, 1, 2) @ aim)[:, 0].T
        return found / np.maximum(self.gain[number], 1e-12)

    def _solve(
        self,
        residual: Float[np.ndarray, "k 3 W"],
        slope: Float[np.ndarray, "k 3 u W"],
        windows: Int[np.ndarray, " W"],
    ) -> tuple[Float[np.ndarray, "W r u"], Float[np.ndarray, "u W"], Float[np.ndarray, "W u u"]]:
        """Return the weighted rows of some windows, the unknowns, and their covariance."""
        packet, unknowns = self._near.packet[:, windows], slope.shape[2]
        m = len(packet)
        weighted = np.moveaxis(slope * self._weight[..., None, None], -1, 0)
        # Products of strided matrices take ten times as long.
        rows = np.ascontiguousarray(weighted.reshape(len(windows), -1, unknowns))
        precision = np.repeat([_USUAL**-2, self._share**-2], [m, unknowns - m])
        information, score, _ = normal_equations(rows, self._aim(residual[:, :, None])[..., 0])
        score[:, :m] -= _USUAL**-2 * self._late[packet].T
        solution, covariance = solved(information, score, np.diag(precision))
        return rows, solution.T, covariance

    def _aim(self, residual: Float[np.ndarray, "k 3 P W"]) -> Float[np.ndarray, "W r P"]:
        """Return weighted residuals, row by row."""
        weighted = np.moveaxis(residual * self._weight[..., None, None], -1, 0)
        return weighted.reshape(len(weighted), -1, residual.shape[2])


def _regressed(
    near: _Surroundings,
    late: Float[np.ndarray, " K"],
    before: _Regression | None = None,
    share: float = _SHARE,
) -> _Regression:
    """Repeat the regression with other delays of all packets and the same noise."""

    # A long recording is linearised again for each use, a short one once.
    @lru_cache(maxsize=1)
    def linearised(start: int, stop: int) -> tuple[np.ndarray, np.ndarray]:
        return near.linearised(late, np.arange(start, stop))

    def at(rest: Float[np.ndarray, "k 3 B"]) -> _Regression:
        return _Regression(near, late, linearised, near.components.variances(rest), share)

    if before is None:
        residual = [linearised(part[0], part[-1] + 1)[0] for part in _batches(near.packet.shape[1])]
        # Noise and delays barely depend on each other.
        before = at(np.concatenate(residual, axis=2))
    return at(before.rest[..., before.where_usual])


def _batches(count: int) -> list[Int[np.ndarray, " W"]]:
    """Return the numbers of windows that are regressed together."""
    return np.array_split(np.arange(count), -(-count // _BATCH))
