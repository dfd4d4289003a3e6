"""What really happened in a recording: when packets came, what failed, what the model lacks.

All causes are regressions of the craft's changes of velocity along its measured motion, over steps
of 25 ms: in these, errors of neighbouring steps are nearly independent. A cause counts only if it
lowers the criterion of Schwarz (1978, BIC): its drop of the squared residual, in units of the usual
one, exceeds ln N for each of its parameters, plus 2 ln K if it is one of K alternatives (Chen and
Chen, Biometrika 95, 2008). Otherwise six free gains in every window would explain everything.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from airpuck.data.trajectory import Span, Trajectory
from airpuck.data.windows import Windows
from airpuck.deviation.motor_regression import (
    accelerations_along,
    accelerations_by_motor,
    body_accelerations,
    following,
    other_accelerations,
)
from airpuck.deviation.packet_delays import commands_at, delay_for, moved, packet_delays
from airpuck.model.model_file import Model
from airpuck.physics.effects import BodyMotion, Effect
from airpuck.physics.motor import motor_speeds
from airpuck.physics.rigid_body import Dynamics
from airpuck.physics.thrust import thrust

#: Length of a step [s]: about the motors' lag, and as long as the smoothing of velocities.
_STEP_S = 0.025
#: Degrees of freedom of Student's distribution of the residuals.
_TAIL = 8.0
#: Fraction of the modelled changes below which residuals do not count, however good the model.
_NEGLIGIBLE = 0.02
#: A motor that was commanded to less than this was idle, and starts with the first command above;
#: a fault that begins this long after is a failed start [1, s].
_IDLE, _AFTER_START = 0.06, 0.12
#: Time around a fault that its ends are fitted to, and how far they may move [s].
_AROUND, _REACH = 0.25, 0.12
#: Steps of the search for the ends of faults [s].
_SEARCH = (0.015, 0.004)
#: Number of poses around a packet that determine its delay, times three channels.
_OF_PACKET = 96
#: Smallest delay of a packet that counts [s].
_LEAST_LATE = 1e-3
#: Standard errors from which the usual delay is not the model's.
_CERTAIN = 4.0
#: Largest change of a motor's strength that may pass for a fault: beyond, it does not turn.
_MOST_CHANGED = 0.7
#: Step of the difference quotients in timing [s].
_TIME_STEP = 1e-3
#: Most gains of one window, and the largest fraction by which a motor is stronger than modelled.
_MOST_GAINS, _MORE = 3, 0.5


@dataclass(frozen=True, eq=False)
class KnownFault:
    """A time in which motors did not follow their commands."""

    owner: str
    motors: Bool[np.ndarray, " n"]
    #: From when to when, at the motors [s]; and until when the last command was held.
    begin: float
    stop: float
    held: float

    def applied(
        self, time: Float[np.ndarray, " N"], held: Float[np.ndarray, "N n"]
    ) -> Float[np.ndarray, "N n"]:
        """Return the commands that motors followed instead of the held ones."""
        ends = np.append(time[1:], time[-1])[:, None]
        given = _replaced(time[:, None], ends, held[..., None], self, np.zeros((3, 1)))
        return np.where(self.motors, given[..., 0], held)


@dataclass(frozen=True)
class Missing(Effect):
    """Accelerations that a model lacks: constant ones, in the world, and drag."""

    x: Any = 0.0
    y: Any = 0.0
    yaw: Any = 0.0
    linear: Any = 0.0
    angular: Any = 0.0

    def acceleration(self, xp: Any, motion: BodyMotion) -> tuple[Any, Any, Any]:
        """Add them."""
        forward = motion.cos * self.x + motion.sin * self.y - self.linear * motion.forward
        left = motion.cos * self.y - motion.sin * self.x - self.linear * motion.left
        return forward, left, self.yaw - self.angular * motion.spin


@dataclass(frozen=True, eq=False)
class Hindsight:
    """Everything that is known afterwards about W predictions of a recording."""

    #: The recording with packets at their times of arrival, less the delay.
    arrived: Trajectory
    #: Packets that came late or early by an amount that counts.
    packets: int
    faults: tuple[KnownFault, ...]
    #: The model with its missing terms, and the delay to add [s].
    dynamics: Dynamics
    later: float
    #: Excess strength in each window: common, and of single motors.
    common: Float[np.ndarray, " W"]
    single: Float[np.ndarray, "n W"]


class Increments:
    """Changes of velocity along a measured motion: measured, and caused by each motor."""

    def __init__(
        self, dynamics: Dynamics, trajectory: Trajectory, held: Float[np.ndarray, "N n"]
    ) -> None:
        self.dynamics, self.trajectory, self.held = dynamics, trajectory, held
        self.speed = motor_speeds(trajectory.time, held, dynamics.lag, dynamics.idle_lag)
        self.by_motor, rest = accelerations_by_motor(dynamics, trajectory.state, self.speed)
        self.residual = trajectory.state[:, 3:] - self.summed(self.by_motor.sum(axis=2) + rest)

    def summed(self, rate: Float[np.ndarray, "N *k"]) -> Float[np.ndarray, "N *k"]:
        """Integrate over time from the first sample on."""
        h = np.diff(self.trajectory.time).reshape(-1, *(1,) * (rate.ndim - 1))
        return np.concatenate([0 * rate[:1], np.cumsum(h / 2 * (rate[1:] + rate[:-1]), axis=0)])


def look_back(
    model: Model, trajectory: Trajectory, windows: Windows, spans: Sequence[Span]
) -> Hindsight:
    """Find what happened in a recording, of which `spans` are known faults."""
    delay, dynamics = delay_for(model, trajectory), model.dynamics
    first = Increments(dynamics, trajectory, commands_at(trajectory, delay))
    scale = _usual(first, _knots(trajectory))
    faults = tuple(
        f for alike in _together(spans) if (f := _fault(first, alike, scale)) is not None
    )
    arrived, packets = _retimed(model, trajectory, faults, delay)

    def heard(later: float = 0.0) -> Float[np.ndarray, "N n"]:
        held = commands_at(arrived, delay + later)
        for fault in faults:
            held = fault.applied(trajectory.time, held)
        return held

    lacks = _Lacks(dynamics, arrived, heard, faults)
    better = Increments(lacks.dynamics, arrived, heard(lacks.later))
    common, single = _gains(better, windows, lacks)
    return Hindsight(arrived, packets, faults, lacks.dynamics, lacks.later, common, single)


def _knots(trajectory: Trajectory) -> Int[np.ndarray, " K"]:
    """Return the samples at which steps begin and end."""
    return np.arange(0, len(trajectory), trajectory.steps(_STEP_S))


def _usual(design: Increments, knots: Int[np.ndarray, " K"]) -> Float[np.ndarray, " 3"]:
    """Return the usual residual of a step in each channel, robust to faults."""
    residual = np.diff(design.residual[knots], axis=0)
    change = np.diff(design.summed(design.by_motor.sum(axis=2))[knots], axis=0)
    least = _NEGLIGIBLE * np.sqrt(np.mean(change**2, axis=0))
    return np.maximum(np.median(np.abs(residual), axis=0) / 0.6745, np.maximum(least, 1e-12))


def _replaced(begins: Any, ends: Any, held: Any, fault: Any, moves: Any) -> Any:
    """Return commands (e, n, B) with a fault whose begin, stop and hold are moved by (3, B)."""
    begin, stop, until = fault.begin + moves[0], fault.stop + moves[1], fault.held + moves[2]
    until = np.clip(until, begin, stop)
    duration = np.maximum(ends - begins, 1e-12)

    def part(a: Any, b: Any) -> Any:
        inside = np.minimum(ends, b) - np.maximum(begins, a)
        return np.clip(inside / duration, 0.0, 1.0)[:, None]

    last = np.clip(np.searchsorted(begins[:, 0], begin) - 1, 0, len(begins) - 1)
    kept = np.moveaxis(held[last, :, 0], -1, 0)
    holding = part(begin, until)
    return held * (1 - holding - part(until, stop)) + kept * holding


def _together(spans: Sequence[Span]) -> list[list[Span]]:
    """Put spans that begin together into groups: two motors that fail at once."""
    groups: list[list[Span]] = []
    for span in sorted(spans, key=lambda one: one.start):
        if groups and span.start - groups[-1][-1].start < _STEP_S:
            groups[-1].append(span)
        else:
            groups.append([span])
    return groups


def _fault(
    design: Increments, spans: Sequence[Span], scale: Float[np.ndarray, " 3"]
) -> KnownFault | None:
    """Fit the ends of a fault to the motion around it; None if it is no fault of motors."""
    names, time, span = design.trajectory.propellers, design.trajectory.time, spans[0]
    causes = {one.cause for one in spans}
    stalled = np.array([f"{name} stalled" in causes for name in names])
    # If several motors fail at once, they share a cause.
    silent = span.cause in ("radio out", "not armed") or stalled.sum() > 1
    if not (silent or stalled.any()):
        return None
    begin, owner, free = span.start, "outages" if silent else "single motors", [1, 1, silent]
    if span.cause == "not armed":
        begin, free = time[0] - _AROUND, [0, 1, 0]
    if not silent:
        command = design.held[:, stalled]
        starts = time[1:][((command[1:] >= _IDLE) & (command[:-1] < _IDLE)).any(axis=1)]
        near = starts[np.abs(starts - begin) < _AFTER_START]
        if len(near):
            begin, owner, free = float(near[-1]), "failed starts", [0, 1, 0]
    fault = KnownFault(owner, stalled | silent, begin, span.stop, begin)
    low, high = np.searchsorted(time, [begin - _AROUND, span.stop + _AROUND])
    part = slice(int(low), int(high))
    return _best_ends(design, fault, part, np.array(free, dtype=bool), scale)


def _best_ends(
    design: Increments,
    fault: KnownFault,
    part: slice,
    free: Bool[np.ndarray, " 3"],
    scale: Float[np.ndarray, " 3"],
) -> KnownFault | None:
    """Search the ends of a fault one after the other; None if it explains too little."""
    time, state = design.trajectory.time[part], design.trajectory.state[part]
    dynamics, held = design.dynamics, design.held[part]
    knots = np.arange(0, len(time), design.trajectory.steps(_STEP_S))
    steps = np.diff(time)[:, None]

    def costs(moves: Float[np.ndarray, "3 B"]) -> Float[np.ndarray, " B"]:
        given = _replaced(time[:-1, None], time[1:, None], held[:-1, :, None], fault, moves)
        given = np.where(fault.motors[:, None], given, held[:-1, :, None])
        before = np.tile(design.speed[part][0][:, None], (1, moves.shape[1]))
        speed = following(dynamics, before, given, np.broadcast_to(steps, given[:, 0].shape))
        rates = accelerations_along(dynamics, state[..., None], speed)
        gained = np.cumsum(steps[:, None] / 2 * (rates[1:] + rates[:-1]), axis=0)
        gained = np.concatenate([0 * gained[:1], gained])[knots]
        left = np.diff(state[knots, 3:], axis=0)[..., None] - np.diff(gained, axis=0)
        return _loss(left / scale[:, None]).sum(axis=(0, 1))

    best = np.zeros(3)
    for step in _SEARCH:
        around = step * np.arange(-round(_REACH / _SEARCH[0]), round(_REACH / _SEARCH[0]) + 1)
        for _ in range(2):
            for k in np.flatnonzero(free):
                # A silent radio may hold the last command for long.
                tried = np.tile(best[:, None], (1, len(around)))
                tried[k] += 2 * np.abs(around) if k == 2 and step == _SEARCH[0] else around
                best = tried[:, np.argmin(costs(tried))]
    begin, stop, until = np.array([fault.begin, fault.stop, fault.held]) + best
    inside = (time[knots[1:]] > begin) & (time[knots[:-1]] < stop)
    penalty = np.log(3 * len(knots))
    never = costs(np.array([[1e9], [-1e9], [0.0]]))[0]
    explains = never - costs(best[:, None])[0] - free.sum() * penalty
    saved = _saved_by_gain(design, part, knots, inside, scale) - penalty
    if explains < max(saved, 0.0):
        return None
    return replace(fault, begin=float(begin), stop=float(stop), held=float(until))


def _saved_by_gain(
    design: Increments,
    part: slice,
    knots: Int[np.ndarray, " K"],
    inside: Bool[np.ndarray, " k"],
    scale: Float[np.ndarray, " 3"],
) -> float:
    """Return what a change in strength explains instead of a fault, inside it or around it, too."""
    rates = np.diff(design.summed(design.by_motor)[part][knots], axis=0) / scale[:, None]
    values = np.diff(design.residual[part][knots], axis=0)[..., None] / scale[:, None]
    rates = np.concatenate([rates.sum(axis=2, keepdims=True), rates], axis=2)
    saved = 0.0
    for where in (inside, np.full(len(inside), True)):
        x = rates * where[:, None, None]
        gain = np.sum(x * values, axis=(0, 1)) / np.sum(x**2 + 1e-12, axis=(0, 1))
        left = values - x * np.clip(gain, -_MOST_CHANGED, _MOST_CHANGED)
        losses = _loss(values).sum(axis=(0, 1)) - _loss(left).sum(axis=(0, 1))
        saved = max(saved, float(losses.max()))
    return saved


def _loss(residual: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
    """Return minus twice the logarithm of Student's density, up to a constant."""
    return (_TAIL + 1) * np.log1p(residual**2 / _TAIL)


def _retimed(
    model: Model, trajectory: Trajectory, faults: Sequence[KnownFault], delay: float
) -> tuple[Trajectory, int]:
    """Move packets whose delay differs from the usual one to their times of arrival."""
    found = packet_delays(trajectory, model, thorough=True)
    if not len(found):
        return trajectory, 0
    middle = float(np.median(found.deviation))
    error = np.median(np.abs(found.deviation - middle)) / 0.6745 / np.sqrt(len(found))
    # An error of the usual delay is one of the model.
    late = found.deviation - (middle if abs(middle) > _CERTAIN * error else 0.0)
    arrival = trajectory.command_time[found.packet] + delay
    counts = (late / found.standard_error) ** 2 > np.log(_OF_PACKET)
    counts &= np.abs(late) > _LEAST_LATE
    for fault in faults:
        counts &= (arrival < fault.begin - _STEP_S) | (arrival > fault.stop + _STEP_S)
    return moved(trajectory, found.packet[counts], late[counts]), int(counts.sum())


class _Lacks:
    """What a model lacks throughout a recording, and the slow changes of its motors."""

    def __init__(
        self, dynamics: Dynamics, trajectory: Trajectory, heard: Any, faults: Sequence[KnownFault]
    ) -> None:
        design = Increments(dynamics, trajectory, heard())
        knots, n = _knots(trajectory), len(trajectory.propellers)
        columns, groups = self._columns(design, heard)
        rates = np.diff(design.summed(columns)[knots], axis=0)
        values = np.diff(design.residual[knots], axis=0)
        scale = _usual(design, knots)
        time = trajectory.time[knots]
        fine = np.add.reduceat(~trajectory.usable, knots)[:-1] == 0
        for fault in faults:
            fine &= (time[1:] < fault.begin) | (time[:-1] > fault.stop + 3 * _STEP_S)
        weight, found = fine[:, None] / scale, np.zeros(rates.shape[2])
        added = found
        # What changes in strength explains is no error of the model's structure.
        for some in (groups[: n + 1], groups[n + 1 :]):
            known = rates @ found
            for _ in range(2):
                x = (rates * weight[..., None]).reshape(-1, rates.shape[2])
                score = x.T @ ((values - known) * weight).ravel()
                penalty = np.log(3 * fine.sum())
                more, _ = selected((x.T @ x)[None], score[None], some, penalty, len(some))
                left = (values - known - rates @ more[0]) / scale
                weight = fine[:, None] / scale / np.sqrt(1 + left**2 / _TAIL)
                added = more[0]
            found = found + added
        self.middle, self.half = float(time.mean()), float(np.ptp(time)) / 2
        self.common, self.single = found[:2], found[2 : 2 + 2 * n].reshape(2, n)
        self.dynamics, self.later = self._corrected(dynamics, found[2 + 2 * n :])

    def _columns(
        self, design: Increments, heard: Any
    ) -> tuple[Float[np.ndarray, "N 3 m"], list[Int[np.ndarray, " _"]]]:
        """Return the accelerations that each possible error adds, and the groups of errors."""
        dynamics, trajectory = design.dynamics, design.trajectory
        time, state, n = trajectory.time, trajectory.state, len(trajectory.propellers)
        drift = ((time - time.mean()) / (np.ptp(time) / 2))[:, None, None]
        each = design.by_motor
        both = each.sum(axis=2, keepdims=True)
        turn = body_accelerations(state)
        full = thrust(dynamics.thrust, np.ones(n))
        matrix = np.asarray(dynamics.configuration)
        self._other = _others(matrix)
        force = thrust(dynamics.thrust, design.speed.T)
        aside = np.einsum("tij,jdk,kt->tidk", turn, self._other, force).reshape(len(time), 3, -1)
        bent = np.einsum("tij,jk,tk->tik", turn, matrix, design.speed * (1 - design.speed) * full)
        slow = replace(dynamics, motor_time_constant=dynamics.motor_time_constant + _TIME_STEP)
        later = Increments(dynamics, trajectory, heard(_TIME_STEP)).by_motor.sum(axis=2)
        slower = Increments(slow, trajectory, design.held).by_motor.sum(axis=2)
        timing = (np.stack([later, slower], axis=2) - both) / _TIME_STEP
        parts = [both, both * drift, each, each * drift, aside, bent, timing]
        parts.append(other_accelerations(state))
        single = [2 + np.array([k, n + k]) for k in range(n)]
        sizes = np.cumsum([2 + 2 * n, 2 * n, n, 2, 3, 2])
        several = [np.arange(a, b) for a, b in pairwise(sizes)]
        return np.concatenate(parts, axis=2), [np.arange(2), *single, *several]

    def _corrected(
        self, dynamics: Dynamics, found: Float[np.ndarray, " m"]
    ) -> tuple[Dynamics, float]:
        """Return the dynamics with what was found, and the additional delay [s]."""
        n = dynamics.configuration.shape[1]
        aside, bend, timing, rest = np.split(found, [2 * n, 3 * n, 3 * n + 2])
        turned = np.einsum("jdk,dk->jk", self._other, aside.reshape(2, n))
        curves = np.array(dynamics.thrust, dtype=float)
        full = thrust(curves, np.ones(n))
        curves[:, 0] += bend * full
        curves[:, 1] -= bend * full
        lag = max(float(dynamics.motor_time_constant) + timing[1], 0.0)
        effects = (*dynamics.effects, Missing(*rest)) if rest.any() else dynamics.effects
        matrix = np.asarray(dynamics.configuration) + turned
        better = replace(dynamics, thrust=curves, configuration=matrix, effects=effects)
        return replace(better, motor_time_constant=lag), float(timing[0])


def _others(matrix: Float[np.ndarray, "3 n"]) -> Float[np.ndarray, "3 2 n"]:
    """Return for each motor two effects at right angles to its own, as large as it."""
    size = np.sqrt(np.mean(matrix**2, axis=1, keepdims=True))
    scaled = matrix / np.maximum(size, 1e-12)
    found = np.empty((3, 2, matrix.shape[1]))
    for k, own in enumerate(scaled.T):
        rest = np.linalg.qr(np.column_stack([own, np.eye(3)]))[0][:, 1:]
        found[:, :, k] = rest * np.linalg.norm(own) * size
    return found


def selected(
    gram: Float[np.ndarray, "B m m"],
    score: Float[np.ndarray, "B m"],
    groups: Sequence[Int[np.ndarray, " _"]],
    penalty: float,
    most: int,
) -> tuple[Float[np.ndarray, "B m"], Bool[np.ndarray, "B m"]]:
    """Add groups of regressors one after the other while each lowers the criterion; solve.

    A parameter costs `penalty`, and a choice among K groups 2 ln K.
    """
    size, m = score.shape
    used, found, explained = np.zeros((size, m), bool), np.zeros((size, m)), np.zeros(size)
    for _ in range(most):
        best, gain = used.copy(), np.zeros(size)
        solution = found.copy()
        for group in groups:
            tried = used.copy()
            tried[:, group] = True
            new = ~used[:, group].all(axis=1)
            answer = _solved(gram, score, tried)
            more = (answer * score).sum(axis=1) - explained
            more -= len(group) * penalty + 2 * np.log(len(groups))
            better = new & (more > gain)
            for kept, these in ((best, tried), (gain, more), (solution, answer)):
                kept[better] = these[better]
        if not (gain > 0).any():
            break
        used, found = best, solution
        explained = (found * score).sum(axis=1)
    return found, used


def _solved(gram: Any, score: Any, used: Any) -> Float[np.ndarray, "B m"]:
    """Solve normal equations for the regressors in use; the others are zero."""
    pairs = used[:, :, None] & used[:, None]
    scale = np.sqrt(np.maximum(np.diagonal(gram, axis1=1, axis2=2), 1e-30))
    normal = np.where(pairs, gram / (scale[:, :, None] * scale[:, None]), 0.0)
    normal += (1e-8 + ~used)[:, :, None] * np.eye(used.shape[1])
    return np.linalg.solve(normal, (score / scale * used)[..., None])[..., 0] / scale


def _gains(
    design: Increments, windows: Windows, lacks: _Lacks
) -> tuple[Float[np.ndarray, " W"], Float[np.ndarray, "n W"]]:
    """Find the excess strength of all motors, and of single ones, in each window."""
    trajectory, n = design.trajectory, len(design.trajectory.propellers)
    scale = _usual(design, _knots(trajectory))
    spacing = trajectory.steps(_STEP_S)
    knots = windows.present[:, None] + np.arange(0, windows.prediction_length + 1, spacing)
    middle = windows.time[windows.present + windows.prediction_length // 2]
    drift = np.stack([np.ones_like(middle), (middle - lacks.middle) / lacks.half])
    common, single = lacks.common @ drift, lacks.single.T @ drift
    each = np.diff(design.summed(design.by_motor)[knots], axis=1)
    rates = np.concatenate([each.sum(axis=3, keepdims=True), each], axis=3) / scale[:, None]
    values = np.diff(design.residual[knots], axis=1) / scale
    slow = np.concatenate([common[None], single])
    values = values - np.einsum("wkcm,mw->wkc", rates, slow)
    gram, score = (np.einsum("wkcm,wkc...->wm...", rates, one) for one in (rates, values))
    alone = [np.array([k]) for k in range(n + 1)]
    found, _ = selected(gram, score, alone, np.log(values[0].size), _MOST_GAINS)
    total = slow + found.T
    # No motor turns backwards, or gives much more than all of its thrust.
    likely = ((total[0] + total[1:] > -1 - _MORE) & (total[0] + total[1:] < _MORE)).all(axis=0)
    total = np.where(likely, total, slow)
    return total[0], total[1:]
