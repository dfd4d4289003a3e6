"""How far a craft may be from its path, by what its model does not know."""

from __future__ import annotations

import math

import numpy as np

from airpuck.control.authority import control_authority
from airpuck.control.lqr import lqr_gain, point_mass
from airpuck.control.tuning import Tuning
from airpuck.evaluation.presentation import largest_acceleration
from airpuck.fleet.path import SMOOTHED
from airpuck.fleet.search import Reach
from airpuck.judgement.findings import response_time
from airpuck.model.model_file import Model
from airpuck.model.tolerances import bar

#: Shares of what the craft can do alone that its path uses for pushing and for turning. Thrusts
#: have a convex range, so both together are possible; the rest is for feedback.
_PUSH, _TURN = 0.4, 0.15
#: Margin for a model without an uncertainty, and the least margin: what estimation and motor lag
#: cost with a perfect model [m].
_UNKNOWN, _LEAST = 0.03, 0.006
#: Standard errors that count as certain.
_CERTAIN = 3.0
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

    Errors of thrusts act as accelerations in proportion to the path's, errors of the response time
    in proportion to its jerk. The regulator turns an acceleration error into at most the sum of its
    absolute impulse response times that error.
    """
    if model.known is None:
        return _UNKNOWN
    relative = bar(model, largest_acceleration) / largest_acceleration(model)
    strength = _CERTAIN * float(np.max(np.abs(relative)))
    late = _CERTAIN * float(bar(model, response_time))
    if not math.isfinite(strength + late):
        return _UNKNOWN
    error = strength * push + late * 2 * push / SMOOTHED
    return _LEAST + error * _worst_response(tuning)


def _worst_response(tuning: Tuning) -> float:
    """Return the largest position error per acceleration error of the LQR's loop [s²]."""
    a, b = point_mass(tuning.period_s)
    closed = a - b @ lqr_gain(tuning.weights, tuning.period_s)
    state, total = b[:, 0], 0.0
    for _ in range(round(5 / tuning.period_s)):
        total += abs(state[0])
        state = closed @ state
    return total
