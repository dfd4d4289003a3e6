"""What causes the prediction error: the share of each cause, and the error if it were known.

Removing a cause means predicting again with what hindsight knows of it (`evaluation.hindsight`). A
share is the drop of the squared error, averaged over an order of removal and its reverse: where the
effects of causes on the poses add up, that is the mean over all orders (Shapley, 1953).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from airpuck.boundary.results import Result, plain
from airpuck.data.trajectory import Span, Trajectory
from airpuck.data.windows import Windows
from airpuck.deviation.motor_regression import with_effectiveness
from airpuck.deviation.packet_delays import commands_at, delay_for
from airpuck.estimate.encoder import Encoder
from airpuck.evaluation.evaluate import (
    RECOVERY_S,
    Protocol,
    ProtocolName,
    batches,
    by_channel,
    every_start,
    judged_windows,
    with_choices,
)
from airpuck.evaluation.hindsight import Hindsight, KnownFault, look_back
from airpuck.model.model_file import Model
from airpuck.physics.motor import motor_speeds
from airpuck.physics.rigid_body import Dynamics, rollout

#: Causes in the order of removal.
OWNERS = (
    "start",
    "packets",
    "outages",
    "failed starts",
    "single motors",
    "common gain",
    "structure",
)
UNEXPLAINED = "unexplained"


@dataclass(frozen=True, eq=False)
class ErrorBudget(Result):
    """Shares of each cause in the squared error of predictions from every start.

    Attributes
    ----------
    start : array, shape (W,)
        Start time of each prediction [s].
    errors : array, shape (3, W)
        Predicted minus measured x, y [m], γ [rad] at the horizon.
    drops : array, shape (K, 3, W)
        Drop of each squared error by each cause of `OWNERS` [m², m², rad²]; may be negative.
    known : array, shape (K, 3, W)
        Errors if one cause were known.
    all_known : array, shape (3, W)
        Errors if all causes were known: what stays unexplained.
    hindsight : Hindsight
        What happened.

    Examples
    --------
    >>> budget = airpuck.error_budget(model, trajectory)
    >>> isinstance(budget, airpuck.ErrorBudget), "outages" in budget.shares
    (True, True)
    """

    start: Float[np.ndarray, " W"]
    errors: Float[np.ndarray, "3 W"]
    drops: Float[np.ndarray, "K 3 W"]
    known: Float[np.ndarray, "K 3 W"]
    all_known: Float[np.ndarray, "3 W"]
    hindsight: Hindsight

    @cached_property
    def shares(self) -> dict[str, Float[np.ndarray, " 3"]]:
        """Share of each cause in the squared error of each channel; they add up to one."""
        total = np.maximum(np.sum(self.errors**2, axis=1), 1e-300)
        owned = dict(zip(OWNERS, self.drops.sum(axis=2) / total, strict=True))
        return owned | {UNEXPLAINED: np.sum(self.all_known**2, axis=1) / total}

    @cached_property
    def bounds(self) -> dict[str, Float[np.ndarray, " 3"]]:
        """Root mean square error if each cause were known; and if all were, for `UNEXPLAINED`."""
        found = np.sqrt(np.mean(np.concatenate([self.known, self.all_known[None]]) ** 2, axis=2))
        return dict(zip((*OWNERS, UNEXPLAINED), found, strict=True))

    def to_json(self) -> dict[str, Any]:
        """Return the fields for ``--json``.

        Returns
        -------
        dict
            ``owners``: ``share`` and ``rmse_if_known`` of each, by channel (``unexplained``: if all
            were known); ``windows``, ``packets_late_or_early``, ``faults``.
        """
        both = ("share", self.shares), ("rmse_if_known", self.bounds)
        return {
            "owners": {
                name: {key: plain(by_channel(values[name])) for key, values in both}
                for name in self.shares
            },
            "windows": len(self.start),
            "packets_late_or_early": self.hindsight.packets,
            "faults": plain([[one.owner, one.begin, one.stop] for one in self.hindsight.faults]),
        }


def error_budget(
    model: Model,
    trajectory: Trajectory,
    faults: Sequence[Span] = (),
    *,
    protocol: Protocol | ProtocolName = "paper",
    encoder: Encoder | str = "paper",
) -> ErrorBudget:
    """Divide the squared error of predictions among its causes.

    Predictions begin at every eighth sample at 240 Hz, half as many starts as in `evaluate`. What
    happened is known from the recording itself, so the bounds are hindsight: no predictor has them.

    Parameters
    ----------
    model : Model
        The model.
    trajectory : Trajectory
        The recording.
    faults : sequence of Span, optional
        Its faults (`airpuck.find_faults`), whose ends are refined.
    protocol : Protocol or {"paper", "paper-long", "causal"}, default "paper"
        See `airpuck.evaluate`.
    encoder : Encoder or {"paper", "actuation"}, default "paper"
        See `airpuck.evaluate`.

    Returns
    -------
    ErrorBudget
        Shares, bounds, and what happened.

    Examples
    --------
    >>> budget = airpuck.error_budget(model, trajectory)
    >>> bool(abs(sum(budget.shares.values())[0] - 1) < 1e-9)
    True
    """
    protocol, encoder = with_choices(model, trajectory, protocol, encoder)
    judged, spacing = every_start(trajectory, protocol)
    windows, past = judged_windows(model, trajectory, judged, encoder, 2 * spacing)
    hindsight = look_back(model, windows.trajectories[0], windows, faults)
    of = cache(_Again(model, windows, encoder, past, hindsight).predicted)
    drops = np.zeros((len(OWNERS), *of(frozenset()).shape))
    for order in (OWNERS, OWNERS[::-1]):
        known = frozenset[str]()
        for owner in order:
            then = known | {owner}
            drops[OWNERS.index(owner)] += (of(known) ** 2 - of(then) ** 2) / 2
            known = then
    alone = np.array([of(frozenset({owner})) for owner in OWNERS])
    start = windows.time[windows.present]
    return ErrorBudget(start, of(frozenset()), drops, alone, of(frozenset(OWNERS)), hindsight)


@dataclass(frozen=True, eq=False)
class _Again:
    """Predictions of a recording for which some causes of errors are known."""

    model: Model
    windows: Windows
    encoder: Encoder
    past: Int[np.ndarray, " W"]
    hindsight: Hindsight

    def predicted(self, known: frozenset[str]) -> Float[np.ndarray, "3 W"]:
        """Predict again; return the errors at the horizon."""
        found, model = self.hindsight, self.model
        windows = replace(self.windows, input=self._commands(known))
        dynamics = found.dynamics if "structure" in known else model.dynamics
        gain = found.single * ("single motors" in known) + found.common * ("common gain" in known)
        # A motor that does not turn has no strength, and an encoder that noticed knows better.
        for fault in found.faults:
            if fault.owner not in known:
                gain[:, self._touched(fault)] = 0.0
        errors, trajectory = np.empty((3, len(windows))), windows.trajectories[0]
        speed = motor_speeds(trajectory.time, windows.input, dynamics.lag, dynamics.idle_lag)
        for length, part in batches(self.past):
            starts = windows.starts[part]
            state, now = self.encoder.begin(dynamics, windows.past(starts, length))
            if "start" in known:  # smoothed states, and motor speeds from all commands before
                present = windows.present[part]
                state = np.concatenate([trajectory.state[present], speed[present]], axis=1).T
            now = _with_gain(now, dynamics, gain[:, part])
            commands, durations, measured = windows.future(starts)
            errors[:, part] = rollout(np, now, state, commands, durations)[-1, :3]
            errors[:, part] -= measured[-1, :3]
        return errors

    def _touched(self, fault: KnownFault) -> Bool[np.ndarray, " W"]:
        """Mark the windows that overlap a fault, or the motors' recovery from it."""
        windows = self.windows
        first = windows.time[windows.starts]
        last = windows.time[windows.present + windows.prediction_length]
        return (first < fault.stop + RECOVERY_S) & (last > fault.begin)

    def _commands(self, known: frozenset[str]) -> Float[np.ndarray, "N n"]:
        """Return the commands that motors are known to follow."""
        found, windows = self.hindsight, self.windows
        trajectory, held = windows.trajectories[0], windows.input
        delay = delay_for(self.model, trajectory)
        if "structure" in known:
            # Some models hold commands by whole samples.
            delay += found.later
            held = commands_at(trajectory, delay)
        if "packets" in known:
            held = held + commands_at(found.arrived, delay) - commands_at(trajectory, delay)
        for fault in found.faults:
            if fault.owner in known:
                held = fault.applied(trajectory.time, held)
        return held


def _with_gain(now: Dynamics, modelled: Dynamics, gain: Float[np.ndarray, "n B"]) -> Dynamics:
    """Replace an encoder's estimate of the motors where hindsight has one."""
    if not gain.any():
        return now
    thrust = with_effectiveness(modelled, 1 + gain).thrust
    guessed = np.asarray(now.thrust)
    if guessed.ndim == 3:
        thrust = np.where(gain.any(axis=0), thrust, guessed)
    return replace(with_effectiveness(modelled, 1 + gain), thrust=thrust)
