"""A pilot of your own; see docs/control.md, "A controller of your own"."""

import numpy as np

import airpuck


class Spring(airpuck.Pilot):
    """Springs and dampers in x, y and yaw."""

    def __init__(self, model, reference):
        self.reference, self.matrix = reference, model.dynamics.configuration
        self.speed_for = airpuck.InverseThrust(model.parameters.thrust)
        self.before = self.now = (0.0, np.zeros(3))

    def pose(self, time, pose):
        """Keep the latest two poses."""
        self.before, self.now = self.now, (time, np.array(pose))

    def step(self, time):
        """Push towards the reference, against the velocity."""
        (t0, before), (t1, pose) = self.before, self.now
        velocity = (pose - before) / max(t1 - t0, 1e-3)
        ahead = self.reference.at(time, 0.0).state[:3] - pose
        wanted = [6, 6, 30] * ahead - [4, 4, 8] * velocity
        cos, sin = np.cos(pose[2]), np.sin(pose[2])
        body = [cos * wanted[0] + sin * wanted[1], cos * wanted[1] - sin * wanted[0], wanted[2]]
        force = np.linalg.pinv(self.matrix) @ body + 0.1
        return airpuck.Step(np.clip(self.speed_for(force), 0.03, 1))
