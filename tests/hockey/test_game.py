"""Games between two sides."""

from collections import Counter

import pytest

from airpuck.boundary.errors import InputError
from airpuck.hockey.contestant import contestant
from airpuck.hockey.game import Game
from airpuck.hockey.rules import Rules

HARD, EASY = contestant("human:hard"), contestant("human:easy")


def played(seed: int, left=HARD, right=EASY, rules=None) -> Game:
    game = Game(left, right, rules=rules, seed=seed)
    game.play()
    return game


def test_the_events_of_a_game_make_its_score_and_the_better_hand_wins():
    games = [played(seed, rules=Rules(goals=3)) for seed in range(3)]
    for game in games:
        scored = Counter(event.side for event in game.events if event.kind == "goal")
        assert (scored[-1], scored[1]) == game.score
        assert game.events[-1].kind == "over"
        assert max(game.score) == 3 or game.time == pytest.approx(300.0)
    assert sum(game.score[0] > game.score[1] for game in games) >= 2


def test_the_same_seed_gives_the_same_game():
    first, second = (played(5, rules=Rules(limit_s=10.0)) for _ in range(2))
    assert first.events == second.events
    assert first.recording()["puck"] == second.recording()["puck"]
    assert first.events != played(6, rules=Rules(limit_s=10.0)).events


def test_a_hand_that_points_nowhere_is_named():
    class Lost:
        def target(self, time, own, puck, opponent):
            return float("nan"), 0.0

    nobody = type(HARD)("lost", hand=lambda play, seed: Lost())
    with pytest.raises(InputError, match="hand lost: target"):
        Game(nobody, HARD).step()
