"""A league: every player meets every other, on tables that none of them knows exactly."""

import json

import numpy as np
import pytest

from airpuck.boundary.errors import InputError
from airpuck_hockey.game.rules import Rules
from airpuck_hockey.matches import match
from airpuck_hockey.matches.match import LeagueResult, league
from tests.apparatus.commands import airpuck

SHORT = Rules(limit_s=3.0)
PLAYERS = ("keeper", "striker:hard", "human")


def test_all_pairs_play_once_on_each_side(tmp_path, monkeypatch):
    played = []
    original = match.Game

    def noted(left, right, **given):
        played.append((left.name, right.name, given["seed"], given["settings"].puck))
        assert given["believed"].puck != given["settings"].puck
        return original(left, right, **given)

    monkeypatch.setattr(match, "Game", noted)
    found = league(PLAYERS, 2, seed=7, rules=SHORT, workers=1, output=tmp_path)
    assert [game[:3] for game in played] == [
        ("keeper", "striker:hard", 7),
        ("keeper", "human", 7),
        ("striker:hard", "human", 7),
        ("striker:hard", "keeper", 8),
        ("human", "keeper", 8),
        ("human", "striker:hard", 8),
    ]
    # The seed alone determines the table, not the players.
    assert played[0][3] == played[1][3] != played[3][3]
    again = league(PLAYERS, 2, seed=7, rules=SHORT, workers=1, output=tmp_path)
    assert len(played) == 6
    assert again.to_json() == found.to_json()


def test_figures_of_a_pair_include_both_sides():
    games = (
        (0, 1, {"left_goals": 3, "right_goals": 1, "duration_s": 60.0}),
        (1, 0, {"left_goals": 2, "right_goals": 2, "duration_s": 30.0}),
        (1, 0, {"left_goals": 4, "right_goals": 0, "duration_s": 10.0}),
    )
    league = LeagueResult(("a", "b"), games)
    assert repr(league).startswith("LeagueResult(players=") and len(repr(league)) <= 400
    figures = league.to_json()
    (_, cell), (other, _) = figures["matrix"]
    assert cell == {
        "games": 3,
        "wins": 1,
        "losses": 1,
        "goals_for": 5,
        "goals_against": 7,
        "seconds": 100.0,
    }
    assert (other["goals_for"], other["goals_against"]) == (7, 5)


@pytest.mark.parametrize("players", [("keeper",), ("keeper", "human", "keeper")])
def test_a_league_needs_two_different_players(players):
    with pytest.raises(InputError, match="at least two players"):
        league(players, rules=SHORT)


def test_the_command_prints_the_standings_and_writes_the_matrix(tmp_path):
    ended = airpuck(
        *("league", "keeper", "human", "--games", "1", "--limit", "1", "--workers", "1"),
        *("--json", str(tmp_path / "league.json")),
    )
    figures = json.loads((tmp_path / "league.json").read_text())
    assert figures["players"] == ["keeper", "human"]
    assert "points per game" in ended.stdout
    assert figures["matrix"][0][0] is None
    assert figures["matrix"][0][1]["seconds"] == pytest.approx(1.0)


def test_goals_of_a_result_add_up():
    random = np.random.default_rng(1)
    games = tuple(
        (one, other, {"left_goals": a, "right_goals": b, "duration_s": 1.0})
        for one, other, a, b in random.integers(0, 4, (40, 4)).tolist()
        if one != other
    )
    found = LeagueResult(("a", "b", "c", "d"), games)
    assert found.total("goals").sum() == sum(g["left_goals"] + g["right_goals"] for *_, g in games)
    points = found.total("points")
    np.testing.assert_allclose(points + points.T, found.total("games"))


def test_only_pairs_with_a_given_player_play(tmp_path):
    rules = Rules(limit_s=0.2)
    found = league(PLAYERS, 1, rules=rules, workers=1, output=tmp_path, only="human")
    assert sorted(game[:2] for game in found.games) == [(0, 2), (1, 2)]
    with pytest.raises(InputError, match="bob is not among the players"):
        league(PLAYERS, 1, rules=rules, only="bob")
