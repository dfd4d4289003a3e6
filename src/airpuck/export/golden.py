"""A flight of the controller in Python, for a program in another language to repeat."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from airpuck.control.mpc import Ongoing
from airpuck.control.reference import SetPoint
from airpuck.control.tracking import TrackingController
from airpuck.control.tuning import Tuning
from airpuck.model.model_file import Model
from airpuck.physics.rigid_body import step
from airpuck.planning.plan import Plan

#: Rate of poses [1/s], and number of control steps.
_RATE, _STEPS = 240, 120
#: Set points, each held for the same time: near, turned, far, back.
_TARGETS = ((0.0, 0.0, 0.0), (0.3, 0.1, 2.0), (-0.6, 0.3, -1.0), (0.0, 0.0, 0.0))
#: Departure of a planned flight, and time for which it continues after its end [s].
_DEPARTS, _AFTERWARDS = 0.05, 0.2
#: Frames that are lost, that are not finite, and that show another object.
_LOST, _BAD, _JUMPING = range(110, 130), range(170, 172), range(230, 233)
#: Standard deviation of the poses [m, m, rad].
_NOISE = (5e-5, 5e-5, 6e-4)


def golden_flight(model: Model, tuning: Tuning, plan: Plan | None = None) -> Iterator[str]:
    """Yield the lines of a flight: targets, poses, plans, results of steps, and commands sent.

    Motors act without delay, unlike the model's, so that the controller has errors to correct. A
    planned flight begins after the first pose, and the targets follow it.
    """
    random, period = np.random.default_rng(0), tuning.period_s
    pilot = TrackingController(model, SetPoint(0.0, 0.0, 0.0), tuning, compiled=False)
    n = model.vehicle.n_propellers
    state = np.concatenate([np.zeros(6), np.full(n, model.vehicle.command_min)])
    frame = planned = 0
    if plan is not None:
        state[:6] = plan.states[0, :6]
        planned = math.ceil((plan.duration + _AFTERWARDS) / period)
        pilot.reference = plan.starting(_DEPARTS)
        yield _line("depart", _DEPARTS)
    for k in range(planned + _STEPS):
        now = (k + 1) * period
        if k >= planned and (k - planned) % (_STEPS // len(_TARGETS)) == 0:
            pose = _TARGETS[(k - planned) * len(_TARGETS) // _STEPS]
            pilot.reference = SetPoint(*pose)
            yield _line("target", *pose)
        while frame / _RATE <= now:
            seen = state[:3] + random.normal(size=3) * _NOISE + (frame in _JUMPING)
            if frame in _BAD:
                seen[frame % 3] = math.nan
            if frame not in _LOST:
                pilot.pose(frame / _RATE, seen)
                yield _line("pose", frame / _RATE, *seen)
            frame += 1
        if isinstance(pilot.state, Ongoing):
            # Each plan depends on the previous one: without a copy, rounding would accumulate.
            kept = pilot.state
            yield _line("plan", kept.since, kept.answered, float(kept.way), *kept.plan.ravel())
        result = pilot.step(now)
        yield _line("step", now, result.status, *result.command)
        pilot.sent(now, result.command)
        yield _line("sent", now, *result.command)
        state = step(np, model.dynamics, state, result.command, period)


def _line(*values: str | float) -> str:
    """Format values with all their digits."""
    return ",".join(v if isinstance(v, str) else repr(float(v)) for v in values)
