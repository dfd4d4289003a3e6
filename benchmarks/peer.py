"""The peer: a competent user's afternoon of work with NumPy and SciPy.

All windows at once, Runge-Kutta steps, exact motor lag, the batch as last axis; then
`scipy.optimize.least_squares` with finite differences. It shares only the data with airpuck.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import least_squares

WEIGHTS = np.array([1.0, 1.0, 0.1])


class Peer:
    """M3 in θ = (18 thrust coefficients, inertia, time constant, angle offset, centre of mass)."""

    def __init__(self, time, state, command, starts, past, horizon, vehicle):
        index = starts + np.arange(past + horizon)[:, None]
        self.h = np.diff(time[index], axis=0)
        self.u = np.moveaxis(command[index], 2, 1).copy()
        y = np.moveaxis(state[index], 2, 1)
        self.start, self.target = y[past - 1], y[past:, :3]
        self.past, self.mass = past, vehicle.mass_kg
        self.angle = np.deg2rad([p.direction_deg for p in vehicle.propellers])
        self.place = np.array([p.position_m for p in vehicle.propellers])

    def residual(self, theta):
        """Predict all windows; returns the weighted errors."""
        a, b, c = theta[:18].reshape(6, 3).T[:, :, None]
        inertia, tau, offset, rx, ry = theta[18:23]
        angle = self.angle + offset
        along = np.stack([np.cos(angle), np.sin(angle)])
        arm = self.place.T - np.array([[rx], [ry]])
        turn = (arm[0] * along[1] - arm[1] * along[0]) / inertia
        along = along / self.mass

        def rates(yaw, spin, speed):
            force = ((c * speed + b) * speed + a) * speed
            forward, left = along @ force
            angular = turn @ force
            cos, sin = np.cos(yaw), np.sin(yaw)
            x, y = cos * rx - sin * ry, sin * rx + cos * ry
            return (
                cos * forward - sin * left + y * angular + x * spin**2,
                sin * forward + cos * left - x * angular + y * spin**2,
                angular,
            )

        speed = self.u[0]
        for k in range(self.past - 1):
            speed = self.u[k] + (speed - self.u[k]) * np.exp(-self.h[k] / tau)
        x, y, yaw, vx, vy, spin = self.start
        errors = np.empty_like(self.target)
        for k in range(len(errors)):
            h, u = self.h[self.past - 1 + k], self.u[self.past - 1 + k]
            half = np.exp(-h / 2 / tau)
            middle = u + (speed - u) * half
            end = u + (speed - u) * half**2
            ax1, ay1, aw1 = rates(yaw, spin, speed)
            ax2, ay2, aw2 = rates(yaw + h / 2 * spin, spin + h / 2 * aw1, middle)
            ax3, ay3, aw3 = rates(yaw + h / 2 * (spin + h / 2 * aw1), spin + h / 2 * aw2, middle)
            ax4, ay4, aw4 = rates(yaw + h * (spin + h / 2 * aw2), spin + h * aw3, end)
            x = x + h * vx + h**2 / 6 * (ax1 + ax2 + ax3)
            y = y + h * vy + h**2 / 6 * (ay1 + ay2 + ay3)
            yaw = yaw + h * spin + h**2 / 6 * (aw1 + aw2 + aw3)
            vx = vx + h / 6 * (ax1 + 2 * ax2 + 2 * ax3 + ax4)
            vy = vy + h / 6 * (ay1 + 2 * ay2 + 2 * ay3 + ay4)
            spin = spin + h / 6 * (aw1 + 2 * aw2 + 2 * aw3 + aw4)
            speed = end
            errors[k] = np.stack([x, y, yaw]) - self.target[k]
        return (WEIGHTS[:, None] * errors).ravel()

    def errors(self, theta):
        """Predict all windows; returns predicted minus measured poses, shape (T, 3, W)."""
        return self.residual(theta).reshape(self.target.shape) / WEIGHTS[:, None]

    def fit(self, theta, loss="linear", scale=1.0):
        """Minimise from `theta`; returns scipy's result."""
        low = np.full(len(theta), -np.inf)
        low[18], low[19] = 1e-6, 1e-4
        return least_squares(
            self.residual,
            theta,
            bounds=(low, np.inf),
            x_scale="jac",
            ftol=1e-6,
            xtol=1e-6,
            loss=loss,
            f_scale=scale,
        )
