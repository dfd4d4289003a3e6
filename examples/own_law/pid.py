"""A law of your own; see docs/control.md, "A law of your own"."""

import numpy as np

import airpuck


class PID(airpuck.Law):
    """Proportional, integral and derivative action; the state is the integral of the error."""

    def __init__(self, model, tuning, options):
        self.dynamics, self.period = model.dynamics, tuning.period_s
        self.speed_for = airpuck.InverseThrust(model.dynamics.thrust)

    def init(self):
        """Begin with an integral of zero."""
        return np.zeros(3)

    def step(self, state, moment):
        """Push towards the target from where the craft will be when the command acts."""
        craft, _ = moment.foresee()
        error = moment.reference.at(moment.now, 0.0).state - craft.state
        error[2] = np.remainder(error[2] + np.pi, 2 * np.pi) - np.pi
        near = np.abs(error[:3]) < [0.05, 0.05, 0.2]  # far away the integral would only wind up
        state = np.clip(state + self.period * near * error[:3], -0.05, 0.05)
        wanted = [8, 8, 30] * error[:3] + [5, 5, 10] * error[3:] + 4 * state
        matrix, offset = airpuck.acceleration_map(np, self.dynamics, craft.state[2], craft.state[5])
        force = np.linalg.pinv(matrix) @ (wanted - offset) + 0.1
        return airpuck.Step(np.clip(self.speed_for(force), 0.03, 1), "exact", wanted, craft), state
