"""How far a craft may stray from its path, given what its model does not know."""

from __future__ import annotations

import math

import numpy as np

from airpuck.control.authority import control_authority
from airpuck.control.lqr import LQRSettings, cost_to_go, lqr_gain, point_mass
from airpuck.control.tuning import Tuning
from airpuck.deviation.time_scale import response_time
from airpuck.estimate.axis_filter import process_noise
from airpuck.evaluation.presentation import largest_acceleration
from airpuck.fleet.search import Reach
from airpuck.model.model_file import Model
from airpuck.model.tolerances import bar

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
