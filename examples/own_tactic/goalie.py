"""A tactic of your own: stand between puck and goal. `airpuck match --left goalie.py:Goalie`."""

import numpy as np

from airpuck import SetPoint
from airpuck_hockey import Intention


class Goalie:
    """Stays at home, and shifts along its goal with the puck."""

    def decide(self, view):
        """Return where to stand; called once a control period, in the craft's own frame."""
        x, y = view.pitch.home[:2]
        if view.puck is not None:
            y = float(np.clip(view.puck.mean[1], -0.15, 0.15))
        return Intention("defend", SetPoint(float(x), y, 0.0))
