"""A table that is not flat, or rough."""

import numpy as np

from airpuck.craft.vehicle import GRAVITY
from airpuck.physics.effects import Dish, Friction
from airpuck.physics.rigid_body import Dynamics, rollout

BOWL, STEP = 0.05, 0.02


def test_a_craft_oscillates_in_a_bowl():
    curves, matrix = np.zeros((1, 1)), np.zeros((3, 1))
    dynamics = Dynamics(curves, matrix, np.zeros(2), 0.03, effects=(Dish(-BOWL, -BOWL, 0.0),))
    start = np.array([0.3, -0.2, 0.7, 0.0, 0.0, 0.4, 0.0])[:, None]
    steps = np.full(300, STEP)
    path = rollout(np, dynamics, start, np.zeros((300, 1, 1)), steps)[:, :2, 0]
    swing = np.cos(np.sqrt(GRAVITY * BOWL) * np.cumsum(steps))
    np.testing.assert_allclose(path, swing[:, None] * [0.3, -0.2], atol=2e-4)


def test_dry_friction_brakes_at_a_constant_rate_until_rest():
    curves, matrix = np.zeros((1, 1)), np.zeros((3, 1))
    dynamics = Dynamics(curves, matrix, np.zeros(2), 0.03, effects=(Friction(0.1, 2.0),))
    start = np.array([0.0, 0.0, 0.7, 0.12, -0.16, 4.0, 0.0])[:, None]
    path = rollout(np, dynamics, start, np.zeros((300, 1, 1)), np.full(300, 0.01))[..., 0]
    np.testing.assert_allclose(path[99, 3:6], [0.06, -0.08, 2.0], rtol=0.01)
    np.testing.assert_allclose(path[-1, 3:6], 0.0, atol=1e-3)
