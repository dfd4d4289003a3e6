"""The search for a path: what it finds keeps to all limits."""

import itertools

import numpy as np
import pytest

from airpuck.craft.table import Table
from airpuck.fleet.path import Reach, Route
from airpuck.fleet.search import Journey, Search, Taken, opening

SLOW = Reach(push=2.4, turn=36.0, speed=0.1, spin=6.0, radius=0.07, margin=0.03)
FROM, TO = np.array([-0.9, 0.0, 0.0]), np.array([0.9, 0.0, 1.0])


def found(seed, *taken):
    """Return the path of a slow craft from one end of the table to the other."""
    search = Search(SLOW, np.array([1.0, 0.45]), seed)
    path = search.path(Route.at_rest(0.0, FROM), 0.2, TO, taken, keeps=np.inf)
    assert path is not None
    return path


@pytest.mark.parametrize("seed", range(5))
def test_a_slow_craft_goes_straight_to_a_free_goal(seed):
    np.testing.assert_allclose(found(seed).rest, TO, atol=1e-9)


@pytest.mark.parametrize("seed", range(5))
def test_a_path_keeps_its_speed_and_avoids_a_craft_near_its_end(seed):
    other = Taken(Route.at_rest(0.0, (0.55, 0.0, 0.0)), 0.2)
    path = found(seed, other)
    motion = path.moved(np.arange(0.0, 40.0, 0.01))
    assert np.hypot(*motion.rate[:, :2].T).max() <= SLOW.speed + 1e-6
    assert np.hypot(*(motion.pose[:, :2] - (0.55, 0.0)).T).min() >= 0.2


REACH = Reach(push=2.4, turn=30.0, speed=1.2, spin=6.0, radius=0.07, margin=0.01)
#: Four craft that change places in pairs, so that each goal is taken at the beginning.
PLACES = np.array([[-0.6, 0.2, 0.0], [0.6, 0.2, 0.5], [-0.6, -0.2, 0.0], [0.6, -0.2, -0.5]])


def journeys(goals):
    """Return journeys from the places to goals."""
    return [
        Journey(REACH, Route.at_rest(0.0, tuple(place)), goal)
        for place, goal in zip(PLACES, goals, strict=True)
    ]


def test_swapping_craft_get_paths_that_keep_apart():
    goals = PLACES[[3, 2, 1, 0]]
    paths = opening(journeys(goals), [Taken(Route.at_rest(0.0, (0.0, 0.0, 0.0)), 0.05)], Table())
    times = np.linspace(0.0, max(path.end for path in paths), 3000)
    poses = [path.moved(times).pose for path in paths]
    for pose, place, goal in zip(poses, PLACES, goals, strict=True):
        np.testing.assert_allclose(pose[0], place)
        np.testing.assert_allclose(pose[-1], goal, atol=1e-9)
        assert np.hypot(*pose[:, :2].T).min() >= 0.05 + REACH.room
    for one, other in itertools.combinations(poses, 2):
        assert np.hypot(*(one - other)[:, :2].T).min() >= 2 * REACH.room - 1e-9


def test_every_craft_computes_the_same_paths():
    goals = PLACES[[3, 2, 1, 0]]
    one, other = (opening(journeys(goals), [], Table()) for _ in range(2))
    for path, again in zip(one, other, strict=True):
        np.testing.assert_array_equal(path.durations, again.durations)
        np.testing.assert_array_equal(path.accelerations, again.accelerations)


@pytest.mark.slow
def test_all_craft_rest_if_one_cannot_reach_its_goal():
    goals = PLACES[[3, 2, 1, 0]]
    walled = [Taken(Route.at_rest(0.0, (*goals[0, :2], 0.0)), 0.02)]
    # The start of the last craft lies within the same disc, so only the first may move at all.
    paths = opening(journeys([goals[0], *PLACES[1:]]), walled, Table())
    assert max(path.end for path in paths) == 0.0


@pytest.mark.parametrize("far", [0.3, 0.9])
def test_a_single_craft_takes_the_shortest_time(far):
    start = Route.at_rest(0.0, (-far / 2, 0.0, 0.0))
    (path,) = opening([Journey(REACH, start, np.array([far / 2, 0.0, 0.0]))], [], Table())
    # From rest to rest on a line: accelerate, coast at the largest speed, brake.
    rises = REACH.speed / REACH.push
    slow = far < REACH.speed * rises
    least = 2 * np.sqrt(far / REACH.push) if slow else far / REACH.speed + rises
    assert path.end == pytest.approx(least, abs=0.06)
