"""When single packets arrived: how much later or earlier than the transport delay says.

A packet that switches motors leaves its arrival in the poses: late by δ, it leaves the craft slower
by δ times the change of acceleration. Packet by packet δ is found by regression.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from airpuck.estimate.actuation import twice_integrated
from airpuck.model.motor import lag_decay, motor_speeds
from airpuck.model.rigid_body import acceleration, motor_accelerations
from airpuck.model_file import Model
from airpuck.trajectory import Trajectory
from airpuck.zero_order_hold import mean_hold

#: Samples before the expected arrival and in all: the motors' answer, at 240 Hz within 0.1 s.
_LEAD, _LENGTH = 8, 32
#: Least change of a command that switches a motor.
_SWITCH = 0.1
#: Largest standard error of a packet's delay that says something about it [s].
_KNOWN = 4e-3
#: Packets later or earlier than this were lost, or their motors did not answer [s].
_LOST = 0.06
#: How much other packets nearby are thought to be off, in standard deviations [s]; how long before
#: the window they still matter [s], and how many at most on either side.
_USUAL, _BEFORE, _MOST = 0.01, 0.03, 16
#: By how much each motor's thrust, and the inertia, may be wrong in a window, standard deviation.
_SHARE = 0.03
#: Times the typical misfit from which something else than a late packet was going on.
_MISFIT = 9.0
#: Step of the difference quotients of speed, and passes of Gauss-Newton.
_STEP, _PASSES = 1e-4, 3
#: Squared densities of the disturbance to try, per variance of the pose [1/s³].
_RATIOS = np.concatenate([[0.0], np.logspace(2, 9, 57)])


@dataclass(frozen=True, eq=False)
class PacketDelays:
    """When packets arrived, against the mean delay.

    Attributes
    ----------
    packet : array of int, shape (B,)
        Number of each packet in ``Trajectory.command``, increasing.
    deviation : array, shape (B,)
        Arrival after the one that the model's delay predicts [s].
    standard_error : array, shape (B,)
        Of the deviation, from the noise of the poses and what the model does not explain [s].
    """

    packet: Int[np.ndarray, " B"]
    deviation: Float[np.ndarray, " B"]
    standard_error: Float[np.ndarray, " B"]

    def __len__(self) -> int:
        return len(self.packet)


_NONE = PacketDelays(np.zeros(0, dtype=int), np.zeros(0), np.zeros(0))


def packet_delays(trajectory: Trajectory, model: Model) -> PacketDelays:
    """Estimate when packets arrived, from the poses around those that switched a motor.

    Over the samples around an arrival the poses are

        y = p + v t + ∬ a + Σⱼ δⱼ ∬ ∂a/∂δⱼ + noise,

    a the modelled accelerations along the measured yaw; p, v and the δ of all packets nearby are
    unknown. Those get a prior of 10 ms, which is taken out of what is returned. The noise is that
    of the poses and of white accelerations that the model does not explain, both as large as the
    residuals of the recording say (maximum likelihood).

    Parameters
    ----------
    trajectory : Trajectory
        A recording.
    model : Model
        The craft.

    Returns
    -------
    PacketDelays
        Of packets that arrived within 60 ms of the mean, and are known to 4 ms; none for a model
        without a motor lag.
    """
    if not float(model.dynamics.motor_time_constant) > 0:
        return _NONE
    shift = trajectory.delay
    if model.delay_learned:
        assumed = model.vehicle.nominal.transport_delay_s
        shift = trajectory.acting_delay(model.transport_delay, assumed)
    arrival = trajectory.command_time + shift
    change = np.diff(trajectory.command, axis=0, prepend=trajectory.command[:1])
    packet = np.flatnonzero(np.abs(change).max(axis=1) > _SWITCH)
    first = np.searchsorted(trajectory.time, arrival[packet]) - _LEAD
    whole = np.isin(first, trajectory.window_starts(_LENGTH))
    packet, first = packet[whole], first[whole]
    if len(packet) == 0:
        return _NONE
    near = _Surroundings(trajectory, model, arrival, change, packet, first)
    duration = np.full((_LENGTH - 1, 1), trajectory.sample_period)
    integral = twice_integrated(np.eye(_LENGTH), duration)
    components, spectrum = _components(integral, trajectory.sample_period)
    late, variance, usual = np.zeros(len(arrival)), None, np.ones(len(packet), dtype=bool)
    found = spread = np.zeros(near.packet.shape)
    best = near.best_known(spread)
    for _ in range(_PASSES):
        residual, slope = near.linearised(late)
        residual = np.tensordot(components, residual, 1)
        slope = np.tensordot(components @ integral, slope, 1)
        if variance is None:
            variance = _variances(residual, spectrum)
        # The noise hardly depends on the delays, the delays on the noise.
        for _ in range(2):
            found, spread, rest = _regress(residual, slope, variance, late[near.packet])
            misfit = np.mean(rest**2 / variance[..., None], axis=(0, 1))
            usual = misfit < _MISFIT * np.median(misfit)
            variance = _variances(rest[..., usual], spectrum)
        best = near.best_known(spread)
        late[near.packet[best]] = np.clip(found[best], -_LOST, _LOST)
    # What the data say without the prior.
    gain = 1 - spread[best] / _USUAL**2
    error = np.sqrt(spread[best] / np.maximum(gain, 1e-12))
    deviation = found[best] / np.maximum(gain, 1e-12)
    good = usual[best[1]] & (np.abs(deviation) < _LOST) & (error < _KNOWN)
    return PacketDelays(near.packet[best][good], deviation[good], error[good])


class _Surroundings:
    """The samples around B switches, and what the model says of them and of m packets nearby."""

    def __init__(
        self,
        trajectory: Trajectory,
        model: Model,
        arrival: Float[np.ndarray, " K"],
        change: Float[np.ndarray, "K n"],
        packet: Int[np.ndarray, " B"],
        first: Int[np.ndarray, " B"],
    ) -> None:
        index = first + np.arange(_LENGTH)[:, None]
        time = trajectory.time[index]
        self._dynamics, self._duration = model.dynamics, np.diff(time, axis=0)
        self._state = np.moveaxis(trajectory.state[index], -1, 1)
        self._lag = float(model.dynamics.motor_time_constant)
        held, _ = mean_hold(arrival, trajectory.command, trajectory.time)
        speed = motor_speeds(trajectory.time, held, self._lag)
        self._speed = np.moveaxis(speed[index], -1, 0)
        period, step = np.median(np.diff(arrival)), trajectory.sample_period
        before, after = (
            int(min(np.ceil(reach / period), _MOST))
            for reach in (_LEAD * step + _BEFORE, (_LENGTH - _LEAD) * step)
        )
        near = packet + np.arange(-before, after + 1)[:, None]
        there = (near >= 0) & (near < len(arrival))
        #: Numbers of the packets nearby, (m, B).
        self.packet = np.clip(near, 0, len(arrival) - 1)
        self._change = np.moveaxis(change[self.packet] * there[..., None], -1, 0)
        self._since = time[:, None] - arrival[self.packet]

    def linearised(
        self, late: Float[np.ndarray, " K"]
    ) -> tuple[Float[np.ndarray, "E 3 B"], Float[np.ndarray, "E 3 m B"]]:
        """Return poses less predicted ones, up to a line, and accelerations by each unknown.

        These are each δ, the share by which each motor is stronger, and that of all moments.
        """
        since = self._since - late[self.packet]
        moved = self._answer(since) - self._answer(self._since)
        speed = self._speed + np.einsum("nmb,emb->neb", self._change, moved)
        predicted = twice_integrated(self._accelerations(speed), self._duration)
        # A packet that comes later takes away what the motors gain at this moment.
        gain = -np.where(since > 0, lag_decay(np, np.maximum(since, 0.0), self._lag), 0) / self._lag
        slope = np.zeros((*predicted.shape[:2], *gain.shape[1:]))
        for motor in range(len(speed)):
            apart = np.zeros_like(speed)
            apart[motor] = _STEP
            by_speed = self._accelerations(speed + apart) - self._accelerations(speed - apart)
            moves = self._change[motor] * gain
            slope += by_speed[:, :, None] / (2 * _STEP) * moves[:, None]
        motion = np.moveaxis(self._state[:, 2:], 1, 0)
        by_motor = np.moveaxis(motor_accelerations(np, self._dynamics, motion, speed)[0], 2, 0)
        turning = np.zeros_like(by_motor[:, :, :1])
        turning[:, 2, 0] = by_motor[:, 2].sum(axis=1)
        return self._state[:, :3] - predicted, np.concatenate([slope, by_motor, turning], axis=2)

    def best_known(
        self, spread: Float[np.ndarray, "m B"]
    ) -> tuple[Int[np.ndarray, " P"], Int[np.ndarray, " P"]]:
        """Return where each packet is known best, by the variance of its delay."""
        order = np.argsort(spread, axis=None, kind="stable")
        _, first = np.unique(self.packet.ravel()[order], return_index=True)
        row, column = np.unravel_index(order[first], spread.shape)
        return row, column

    def _answer(self, since: Float[np.ndarray, "E m B"]) -> Float[np.ndarray, "E m B"]:
        """Speed of a motor after a unit step of its command."""
        return 1 - lag_decay(np, np.maximum(since, 0.0), self._lag)

    def _accelerations(self, speed: Float[np.ndarray, "n E B"]) -> Float[np.ndarray, "E 3 B"]:
        """Return the modelled accelerations along the measured motion."""
        motion = np.moveaxis(self._state[:, 2:], 1, 0)
        return np.stack(acceleration(np, self._dynamics, motion, speed), axis=1)


def _components(
    integral: Float[np.ndarray, "E E"], step: float
) -> tuple[Float[np.ndarray, "k E"], Float[np.ndarray, " k"]]:
    """Return components of E poses in which noise is uncorrelated and no line is left.

    Their variance is r (1 + λ d) for poses of variance r and accelerations of squared density λ r.
    """
    line = np.stack([np.ones(_LENGTH), np.linspace(-1, 1, _LENGTH)], axis=1)
    rest = np.linalg.qr(line, mode="complete")[0][:, 2:].T
    spread = rest @ integral
    spectrum, vectors = np.linalg.eigh(spread @ spread.T / step)
    return vectors.T @ rest, np.maximum(spectrum, 0.0)


def _variances(
    rest: Float[np.ndarray, "k 3 B"], spectrum: Float[np.ndarray, " k"]
) -> Float[np.ndarray, "k 3"]:
    """Find the most likely variance of every component, alike for x and y."""
    power = np.mean(rest**2, axis=2)
    growth = 1 + _RATIOS[:, None] * spectrum
    found = []
    for own in (power[:, :2].mean(axis=1), power[:, 2]):
        variance = np.mean(own / growth, axis=1)
        best = np.argmin(len(spectrum) * np.log(variance) + np.log(growth).sum(axis=1))
        found.append(variance[best] * growth[best])
    return np.stack([found[0], found[0], found[1]], axis=1)


def _regress(
    residual: Float[np.ndarray, "k 3 B"],
    slope: Float[np.ndarray, "k 3 u B"],
    variance: Float[np.ndarray, "k 3"],
    late: Float[np.ndarray, "m B"],
) -> tuple[Float[np.ndarray, "m B"], Float[np.ndarray, "m B"], Float[np.ndarray, "k 3 B"]]:
    """Regress on the delays of the packets nearby, linearised at `late`.

    Returns them, their variances, and what is left of the residuals.
    """
    weight = 1 / np.sqrt(variance)
    rows = np.moveaxis(slope * weight[..., None, None], -1, 0).transpose(0, 3, 1, 2)
    rows = rows.reshape(*rows.shape[:2], -1)
    aim = np.moveaxis(residual * weight[..., None], -1, 0).reshape(len(rows), -1)
    m, others = len(late), rows.shape[1] - len(late)
    precision = np.repeat([_USUAL**-2, _SHARE**-2], [m, others])
    covariance = np.linalg.inv(rows @ rows.transpose(0, 2, 1) + np.diag(precision))
    score = np.einsum("bjr,br->bj", rows, aim)
    score[:, :m] -= _USUAL**-2 * late.T
    step = np.einsum("bij,bj->ib", covariance, score)
    rest = residual - np.einsum("kcjb,jb->kcb", slope, step)
    return late + step[:m], np.diagonal(covariance, axis1=1, axis2=2).T[:m], rest
