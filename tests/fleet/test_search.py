"""The search for a path: what it finds keeps to all limits."""

import numpy as np
import pytest

from airpuck.fleet.path import Route
from airpuck.fleet.search import Reach, Search, Taken

SLOW = Reach(push=2.4, turn=36.0, speed=0.1, spin=6.0, radius=0.07, margin=0.03)
FROM, TO = np.array([-0.9, 0.0, 0.0]), np.array([0.9, 0.0, 1.0])


def found(seed, *taken):
    """Return the path of a slow craft from one end of the table to the other."""
    search = Search(SLOW, np.array([1.0, 0.45]), seed)
    path = search.path(Route.at_rest(0.0, FROM), 0.2, TO, taken, keeps=np.inf)
    assert path is not None
    return path


@pytest.mark.parametrize("seed", range(5))
def test_a_slow_craft_goes_straight_to_a_goal_that_is_free(seed):
    np.testing.assert_allclose(found(seed).rest, TO, atol=1e-9)


@pytest.mark.parametrize("seed", range(5))
def test_a_path_keeps_to_the_speed_and_clear_of_a_craft_near_its_end(seed):
    other = Taken(Route.at_rest(0.0, (0.55, 0.0, 0.0)), 0.2)
    path = found(seed, other)
    motion = path.moved(np.arange(0.0, 40.0, 0.01))
    assert np.hypot(*motion.rate[:, :2].T).max() <= SLOW.speed + 1e-6
    assert np.hypot(*(motion.pose[:, :2] - (0.55, 0.0)).T).min() >= 0.2
