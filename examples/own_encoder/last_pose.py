"""An encoder of your own: a prediction starts from the last pose, motors at their last command."""

import numpy as np


class LastPose:
    """Takes the newest state, and motors without any lag. Give it to `airpuck.evaluate`."""

    name = "last pose"
    causal = False  # smoothed velocities look a few samples ahead

    def begin(self, dynamics, past):
        """Return what to predict from, and the dynamics to predict with."""
        return self.encode(np, dynamics, past), dynamics

    def encode(self, xp, dynamics, past):
        """Return the extended state: x, y, yaw, their rates, motor speeds."""
        return xp.concatenate([past.state[-1], past.command[-1]])
