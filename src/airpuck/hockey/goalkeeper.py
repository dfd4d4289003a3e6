"""Keeping the goal: between puck and goal, and where the puck will cross."""

from __future__ import annotations

import math

import numpy as np

from airpuck.control.reference import Rendezvous, SetPoint
from airpuck.hockey.prediction import predict_crossing
from airpuck.hockey.tactic import Intention, View

#: The yaw does not count, velocities little.
_BLOCK = (0.005, 0.005, math.inf, 0.5, 0.5, math.inf)


class Goalkeeper:
    """Stays before the goal beside the puck, and goes to where it will cross: a `Tactic`."""

    def decide(self, view: View) -> Intention:
        """Return where to stand; see `Tactic.decide`."""
        home = SetPoint(*view.pitch.home, 0.0)
        if view.puck is None:
            return Intention("home", home)
        x, y = view.pitch.home
        crossing = None
        if view.puck.mean[3] < -0.1:
            crossing = predict_crossing(view.puck_model, view.puck, x, 1.0)
        if crossing is None or crossing.time < view.time:
            half = view.pitch.play.table.goal_width_m / 2
            return Intention("wait", SetPoint(x, float(np.clip(view.puck.mean[1], -half, half)), 0))
        y = float(view.pitch.clipped(np.array([x, crossing.state.y]))[1])
        there = SetPoint(x, y, 0.0)
        block = Rendezvous(crossing.time, (x, y, 0, 0, 0, 0), precision=_BLOCK, then=there)
        return Intention("defend", block, (crossing.time, x, crossing.state.y))
