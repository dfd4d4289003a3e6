"""Paths of a fleet: what a craft can fly, how closely it follows, and the motions themselves.

A path has piecewise constant accelerations and ends at rest.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from airpuck.control.authority import control_authority
from airpuck.control.lqr import LQRSettings, cost_to_go, lqr_gain, point_mass
from airpuck.control.reference import Preview, Target
from airpuck.control.tuning import Tuning
from airpuck.deviation.time_scale import response_time
from airpuck.estimate.axis_filter import process_noise
from airpuck.evaluation.presentation import largest_acceleration
from airpuck.model.model_file import Model
from airpuck.model.tolerances import bar

#: A craft follows the mean of its path over this time [s], so that its acceleration changes no
#: faster than its motors can follow. All craft of a fleet use the same time.
SMOOTHED = 0.06
#: Shares of what the craft can do alone that its path uses for pushing and for turning. Thrusts
#: have a convex range, so both together are possible; the rest is for feedback.
_PUSH, _TURN = 0.4, 0.15
#: Errors that are assumed of a model without an uncertainty: of accelerations, relative to them,
#: and of the response time [s].
_UNKNOWN = (0.05, 0.003)
#: The least margin: what noise, jitter of the radio and motor lag cost with a perfect model; in
#: studies/fleet.py at most 5.7 mm [m].
_LEAST = 0.006
#: Standard errors that count as certain.
_CERTAIN = 3.0
#: Time after which a craft has recovered from an impulse [s].
_SETTLED = 3.0
#: Limits of a path [m/s², rad/s].
_FASTEST_PUSH, _SPIN = 2.5, 6.0


@dataclass(frozen=True)
class Reach:
    """What a craft can do, and how well it follows a path."""

    #: Largest acceleration in any direction [m/s²], and of the yaw [rad/s²].
    push: float
    turn: float
    #: Largest speed [m/s] and spin [rad/s].
    speed: float
    spin: float
    #: Radius of the craft, and its largest distance from its path [m].
    radius: float
    margin: float

    @property
    def room(self) -> float:
        """Radius of the disc around its path that the craft may touch [m]."""
        return self.radius + self.margin + self.push * SMOOTHED**2 / 24


def reach_of(model: Model, tuning: Tuning, speed: float) -> Reach:
    """Return what a craft can do on a path, and how well it follows."""
    alone = control_authority(model).alone
    weakest = min(alone[name] for name in ("forward", "back", "left", "right"))
    push = min(_PUSH * weakest, _FASTEST_PUSH)
    turn = _TURN * min(alone["turn left"], alone["turn right"])
    margin = tracking_margin(model, tuning, push)
    return Reach(push, turn, speed, _SPIN, model.vehicle.radius_m, margin)


def tracking_margin(model: Model, tuning: Tuning, push: float) -> float:
    """Bound the distance from a path, for a craft within three standard errors of its model.

    Errors of thrusts act as accelerations in proportion to the path's; errors of the response time
    add what the acceleration changes in that time. See docs/fleet.md, "Margin".
    """
    strength, late = _errors(model)
    reaction, change = responses(tuning, response_time(model))
    return _LEAST + push * (strength * reaction + late * change)


def _errors(model: Model) -> tuple[float, float]:
    """Return three standard errors: of accelerations, relative to them, and of the response [s]."""
    if model.known is None:
        return _UNKNOWN
    relative = bar(model, largest_acceleration) / largest_acceleration(model)
    strength, late = float(np.max(np.abs(relative))), float(bar(model, response_time))
    if not math.isfinite(strength + late):
        return _UNKNOWN
    return _CERTAIN * strength, _CERTAIN * late


def responses(tuning: Tuning, delay: float) -> tuple[float, float]:
    """Return Σ|g| and Σ|Δg|, for the position g after an impulse of acceleration [s², s].

    The loop is linear: the LQR, on the belief of a Kalman filter that estimates accelerations which
    the model lacks, predicted to when a command acts.
    """
    period, noise = tuning.period_s, tuning.estimation
    states, inputs = point_mass(period)
    gain = lqr_gain(tuning.of(LQRSettings).weights, period)[0, [0, 3]]
    pushed = np.append(inputs[[0, 3], 0], 0.0)
    step = np.eye(3)
    step[:2, :2], step[:2, 2] = states[np.ix_([0, 3], [0, 3])], pushed[:2]
    densities = np.square([[noise.acceleration_density], [max(noise.disturbance_density, 1e-4)]])
    (spread,) = process_noise(np, period, *densities)
    square = np.array([[noise.position_m**2]])
    covariance = cost_to_go(step.T, np.eye(3)[:, :1], spread, square)
    corrects = covariance[:, 0] / (covariance[0, 0] + square[0, 0])
    true, belief = pushed / period, np.zeros(3)
    coming, places = [0.0] * round(delay / period), [0.0]
    for _ in range(round(_SETTLED / period)):
        places.append(float(true[0]))
        belief = belief + corrects * (true[0] - belief[0])
        ahead = belief
        for command in coming:
            ahead = step @ ahead + pushed * command
        coming.append(float(-gain @ ahead[:2] - ahead[2]))
        command = coming.pop(0)
        true, belief = step @ true + pushed * command, step @ belief + pushed * command
    return period * float(np.abs(places).sum()), float(np.abs(np.diff(places)).sum())


class Motion(NamedTuple):
    """Pose, rate, and the integral of the pose since the path began, at several times."""

    pose: Float[np.ndarray, "N 3"]
    rate: Float[np.ndarray, "N 3"]
    integral: Float[np.ndarray, "N 3"]


@dataclass(frozen=True, eq=False)
class Route:
    """A motion of x, y and yaw from a state to rest.

    Attributes
    ----------
    begin : float
        When it begins [s].
    pose, rate : array, shape (3,)
        State at the beginning.
    durations, accelerations : array, shape (3, S)
        Successive pieces of each coordinate [s; m/s², m/s², rad/s²].
    """

    begin: float
    pose: Float[np.ndarray, " 3"]
    rate: Float[np.ndarray, " 3"]
    durations: Float[np.ndarray, "3 S"]
    accelerations: Float[np.ndarray, "3 S"]

    @classmethod
    def at_rest(cls, time: float, pose: Any) -> Route:
        """Return the path of a craft that rests at a pose."""
        none = np.zeros((3, 0))
        return cls(time, np.array(pose, dtype=float), np.zeros(3), none, none)

    def later(self, time: float) -> Route:
        """Return the same motion, later by a time [s]."""
        return replace(self, begin=self.begin + time)

    @cached_property
    def end(self) -> float:
        """When the craft comes to rest [s]."""
        return self.begin + float(self.durations.sum(axis=1).max(initial=0.0))

    @cached_property
    def rest(self) -> Float[np.ndarray, " 3"]:
        """The pose at which the path ends."""
        return self.moved(np.array([self.end])).pose[0]

    @cached_property
    def push(self) -> float:
        """Bound of its acceleration [m/s²]."""
        return float(np.hypot(*np.abs(self.accelerations[:2]).max(axis=1, initial=0.0)))

    @cached_property
    def _pieces(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Beginnings of all pieces since the path began [s], and rates and poses gained there."""
        begins, rates = pieces(self.rate, self.durations, self.accelerations)
        gained = rates * self.durations + self.accelerations * self.durations**2 / 2
        return begins, rates, gained

    def places(self, times: Float[np.ndarray, " N"]) -> Float[np.ndarray, "N 2"]:
        """Return x and y at several times; `moved` in half the time."""
        since = np.maximum(times - self.begin, 0.0)
        begins, rates, _ = self._pieces
        within = np.clip(since[:, None, None] - begins[:2], 0.0, self.durations[:2])
        gained = (rates[:2] + self.accelerations[:2] / 2 * within) * within
        return self.pose[:2] + gained.sum(axis=2)

    def moved(self, times: Float[np.ndarray, " N"]) -> Motion:
        """Return the motion at several times; before the beginning the craft rests."""
        since = np.maximum(times - self.begin, 0.0)
        begins, rates, gained = self._pieces
        elapsed = since[:, None, None] - begins
        within = np.clip(elapsed, 0.0, self.durations)
        pose = self.pose + np.sum((rates + self.accelerations * within / 2) * within, axis=2)
        rate = self.rate + np.sum(self.accelerations * within, axis=2)
        part = (rates / 2 + self.accelerations * within / 6) * within**2
        part = part + gained * np.maximum(elapsed - self.durations, 0.0)
        return Motion(pose, rate, self.pose * since[:, None] + part.sum(axis=2))

    def followed(self, since: float, until: float, then: Route | None = None) -> Route:
        """Return the part between two times, continued by another path that begins there."""
        begin = max(since, self.begin)
        start = self.moved(np.array([begin]))
        begins = self.begin + self._pieces[0]
        first, last = np.maximum(begins, since), np.minimum(begins + self.durations, until)
        kept = np.maximum(last - first, 0.0)
        # A coordinate that already rests waits for the others.
        waits = until - begin - kept.sum(axis=1)
        durations = np.hstack([kept, waits[:, None]])
        accelerations = np.hstack([self.accelerations, np.zeros((3, 1))])
        if then is not None:
            durations = np.hstack([durations, then.durations])
            accelerations = np.hstack([accelerations, then.accelerations])
        used = (durations > 0).any(axis=0)
        return Route(
            begin, start.pose[0], start.rate[0], durations[:, used], accelerations[:, used]
        )


class Following:
    """The reference of a craft: the mean of its path over the last `SMOOTHED` seconds.

    At any time, the mean is within a s²/24 of the path half of that time earlier, for accelerations
    up to a. As this lag is the same for all craft, paths keep their distance.
    """

    def __init__(self, path: Route) -> None:
        #: The agreed path; replaced by paths that agree with it up to the present.
        self.path = path

    def at(self, now: float, ahead: float) -> Target:
        """Return the target at ``now + ahead``; see `Reference.at`."""
        wanted = self.over(now, np.array([ahead]))
        return Target(wanted.states[0], wanted.accelerations[0])

    def over(self, now: float, ahead: Float[np.ndarray, " N"]) -> Preview:
        """Return the targets at several times; see `airpuck.control.reference.preview`."""
        times = now + ahead
        after, before = self.path.moved(times), self.path.moved(times - SMOOTHED)
        # Before its beginning a path has no integral: the craft rested there.
        early = np.minimum(times - SMOOTHED - self.path.begin, 0.0)[:, None]
        integral = after.integral - before.integral - early * self.path.pose
        poses, rates = integral / SMOOTHED, (after.pose - before.pose) / SMOOTHED
        accelerations = (after.rate - before.rate) / SMOOTHED
        return Preview(np.hstack([poses, rates]), accelerations)


def pieces(
    rate: Float[np.ndarray, "*paths"],
    durations: Float[np.ndarray, "*paths S"],
    accelerations: Float[np.ndarray, "*paths S"],
) -> tuple[Float[np.ndarray, "*paths S"], Float[np.ndarray, "*paths S"]]:
    """Return the beginnings of successive pieces, from the first on [s], and the rates there."""
    rates = rate[..., None] + np.cumsum(accelerations * durations, axis=-1)
    rates = np.concatenate([rate[..., None], rates], axis=-1)[..., :-1]
    return np.cumsum(durations, axis=-1) - durations, rates


def braked(
    offset: Float[np.ndarray, "*#shape"],
    rate: Float[np.ndarray, "*#shape"],
    push: Float[np.ndarray, "*#shape"],
    fastest: float | Float[np.ndarray, "*#shape"],
) -> tuple[Float[np.ndarray, "*full 3"], Float[np.ndarray, "*full 3"]]:
    """Return durations and accelerations that bring double integrators to rest at zero soonest.

    Each accelerates, coasts at its largest speed if it reaches that, and brakes.
    """
    stops = offset + rate * np.abs(rate) / (2 * push)
    side = np.where(stops < 0, -1.0, 1.0)
    distance, away = side * offset, side * rate
    peak = np.minimum(np.sqrt(np.maximum(push * distance + away**2 / 2, 0.0)), fastest)
    gains = (away + peak) / push
    coasts = distance - (2 * peak**2 - away**2) / (2 * push)
    coasts = np.maximum(coasts, 0.0) / np.maximum(peak, 1e-9)
    durations = np.stack([np.abs(gains), coasts, peak / push], axis=-1)
    pushes = np.stack([-np.sign(gains), np.zeros_like(gains), np.ones_like(gains)], axis=-1)
    return durations, pushes * (side * push)[..., None]
