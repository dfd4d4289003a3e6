"""An encoder of your own: the last pose, and motors that already follow the last command."""

import numpy as np


class LastPose:
    """Uses the newest state, as if motors had no lag. Pass an object to `airpuck.evaluate`."""

    name = "last pose"
    causal = False  # smoothed velocities look a few samples ahead

    def begin(self, dynamics, past):
        """Return the initial state and the dynamics of a prediction."""
        return self.encode(np, dynamics, past), dynamics

    def encode(self, xp, dynamics, past):
        """Return the extended state: x, y, yaw, their rates, motor speeds."""
        return xp.concatenate([past.state[-1], past.command[-1]])
