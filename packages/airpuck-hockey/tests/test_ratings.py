"""Ratings from games of pairs."""

import numpy as np
import pytest

from tests.apparatus.studies import study

RATINGS = study("ratings")
ELO, ratings = RATINGS.ELO, RATINGS.ratings


def points_of(truth, games, random, draws):
    """Draw the points of a league of players of known ratings."""
    count = len(truth)
    points = np.zeros((count, count))
    for one in range(count):
        for other in range(one):
            chance = 1 / (1 + 10 ** ((truth[other] - truth[one]) / ELO))
            drawn = 2 * draws * min(chance, 1 - chance)
            results = random.choice(
                [1.0, 0.5, 0.0], games, p=[chance - drawn / 2, drawn, 1 - chance - drawn / 2]
            )
            points[one, other], points[other, one] = results.sum(), games - results.sum()
    return points


def test_ten_wins_to_one_are_nearly_400_points():
    # With many games the prior does not matter.
    value, _ = ratings(np.array([[0.0, 10_000.0], [1000.0, 0.0]]))
    assert value[0] - value[1] == pytest.approx(400.0, abs=1.0)
    assert value.sum() == pytest.approx(0.0, abs=1e-9)


def test_a_player_who_wins_every_game_has_a_finite_rating():
    value, covariance = ratings(np.array([[0.0, 5.0, 5.0], [0.0, 0.0, 2.5], [0.0, 2.5, 0.0]]))
    assert 200 < value[0] < 800
    assert value[1] == pytest.approx(value[2])
    assert covariance[0, 0] > covariance[1, 1]


def test_standard_errors_fall_with_the_root_of_the_games():
    few, many = (ratings(np.full((4, 4), n / 2) * (1 - np.eye(4)))[1] for n in (100, 10_000))
    assert few[0, 0] / many[0, 0] == pytest.approx(100, rel=0.02)
    # Each of p equal players has played n (p - 1) games; the variance of the difference of two of
    # them is 2 / (n p / 4) in units of log odds.
    difference = np.array([1, -1, 0, 0])
    expected = (ELO / np.log(10)) ** 2 * 2 / (10_000 * 4 / 4)
    assert difference @ many @ difference == pytest.approx(expected, rel=0.01)


@pytest.mark.parametrize(("draws", "least", "most"), [(0.0, 0.93, 0.975), (0.3, 0.95, 1.0)])
def test_intervals_cover_the_true_ratings(draws, least, most):
    # A draw tells more than a coin; with draws the intervals are wider than they need to be.
    random, inside = np.random.default_rng(0), []
    for _ in range(150):
        truth = random.normal(0, 200, 6)
        value, covariance = ratings(points_of(truth, 8, random, draws))
        error = value - (truth - truth.mean())
        inside.append(np.abs(error) <= 1.96 * np.sqrt(np.diag(covariance)))
    assert least < np.mean(inside) <= most
