"""A table that is not flat."""

import numpy as np

from airpuck.physics.effects import GRAVITY, Dish
from airpuck.physics.rigid_body import Dynamics, rollout

BOWL, STEP = 0.05, 0.02


def test_a_craft_swings_in_a_bowl():
    curves, matrix = np.zeros((1, 1)), np.zeros((3, 1))
    dynamics = Dynamics(curves, matrix, np.zeros(2), 0.03, effects=(Dish(-BOWL, -BOWL, 0.0),))
    start = np.array([0.3, -0.2, 0.7, 0.0, 0.0, 0.4, 0.0])[:, None]
    steps = np.full(300, STEP)
    path = rollout(np, dynamics, start, np.zeros((300, 1, 1)), steps)[:, :2, 0]
    swing = np.cos(np.sqrt(GRAVITY * BOWL) * np.cumsum(steps))
    np.testing.assert_allclose(path, swing[:, None] * [0.3, -0.2], atol=2e-4)
