"""People in a league: their recorded games, and damaged or foreign bags."""

import shutil
from dataclasses import replace

import numpy as np
import pytest

from airpuck.boundary.errors import InputError
from airpuck.recording.bag import write_bag
from airpuck.recording.stream import COLUMNS, Recording, Stream
from airpuck_hockey.game.contestant import contestant
from airpuck_hockey.game.game import KINDS, Game
from airpuck_hockey.matches.match import LeagueResult
from tests.apparatus.studies import study

RATINGS = study("ratings")
with_people = RATINGS.with_people
START_NS = 1_700_000_000_000_000_000
NAMES = {"left": "airpuck:medium", "right": "you"}


def stream(name: str, rows: list[list[float]], period: float) -> Stream:
    """Return a stream of equally spaced rows."""
    stamp = START_NS + (1e9 * period * np.arange(len(rows))).astype(np.int64)
    return Stream(stamp, stamp, np.array(rows), COLUMNS[name])


def game(left: int, right: int, *, x: float = 0.9, names: dict[str, str] = NAMES) -> Recording:
    """Return a recorded game of a minute that ended with a score; the mallet is at x."""
    rows = [[0.0, 0.0, 0.0, 1.0, 0.0], [left, right, KINDS.index("goal"), 1.0, 0.0]]
    return Recording(
        {
            "mallet": stream("mallet", [[x, 0.0, 0.0]] * 601, 0.1),
            "puck": stream("puck", [[0.3, 0.0, 0.0]] * 601, 0.1),
            "game": stream("game", rows, 30.0),
        },
        "game",
        about=names,
    )


@pytest.fixture
def anna(tmp_path):
    """Return a folder with two games of a person: one on the right, one on the left."""
    write_bag(game(2, 5), tmp_path / "anna" / "game-1")
    turned = {"left": "you", "right": "airpuck:medium"}
    write_bag(game(7, 6, x=-0.9, names=turned), tmp_path / "anna" / "more" / "game-2")
    return tmp_path / "anna"


def test_a_person_is_rated_against_the_levels_played(anna, tmp_path):
    write_bag(game(9, 2), tmp_path / "ben" / "game-1")
    league = with_people({"players": [], "matrix": []}, [anna, tmp_path / "ben"])
    assert sorted(league["players"]) == ["airpuck:medium", "anna", "ben"]
    rated = dict(zip(league["players"], RATINGS.rated(league), strict=True))
    assert rated["anna"][0] > rated["airpuck:medium"][0] > rated["ben"][0]
    assert rated["anna"][1] < rated["anna"][0] < rated["anna"][2]
    one, other = (league["players"].index(name) for name in ("anna", "airpuck:medium"))
    assert league["matrix"][one][other] == {
        "games": 2,
        "wins": 2,
        "losses": 0,
        "goals_for": 12,
        "goals_against": 8,
        "seconds": pytest.approx(120.0),
    }
    assert league["people"]["ben"]["reaction_s"]["value"] is None  # no one hit the puck


def test_people_join_the_players_of_a_league(tmp_path):
    write_bag(game(3, 1, names={"left": "wild", "right": "you"}), tmp_path / "anna" / "game-1")
    played = LeagueResult(("keeper", "wild"), ()).to_json()
    league = with_people(played, [tmp_path / "anna"])
    assert league["players"] == ["keeper", "wild", "anna"]
    assert league["matrix"][1][2]["goals_for"] == 3


def test_a_game_left_immediately_is_a_draw(tmp_path):
    begun = Game(contestant("keeper"), contestant("human"))
    begun.step()
    write_bag(begun.recording(), tmp_path / "anna" / "game-1")
    league = with_people({"players": [], "matrix": []}, [tmp_path / "anna"])
    assert league["matrix"][0][1]["goals_for"] == 0


def without_names(folder):
    path = folder / "metadata.yaml"
    path.write_text(path.read_text().replace("left: airpuck", "port: airpuck"))


def truncated(folder):
    (path,) = folder.glob("*.mcap")
    path.write_bytes(path.read_bytes()[:-200])


def empty(folder):
    (path,) = folder.glob("*.mcap")
    path.write_bytes(b"")


def replaced(**changes):
    def change(folder):
        shutil.rmtree(folder)
        changed = game(1, 2)
        write_bag(replace(changed, **{k: v(changed) for k, v in changes.items()}), folder)

    return change


def without_game(recording):
    return {name: one for name, one in recording.streams.items() if name != "game"}


def with_score(value):
    def change(recording):
        values = recording["game"].values.copy()
        values[:, 0] = value
        return {**recording.streams, "game": replace(recording["game"], values=values)}

    return change


@pytest.mark.parametrize(
    ("damage", "word"),
    [
        (without_names, "play --record"),
        (truncated, "damaged"),
        (empty, "is empty"),
        (replaced(about=lambda _: {"left": "a\x1b[31m", "right": "you"}), "play --record"),
        (replaced(about=lambda _: {"left": "anna", "right": "you"}), "rename"),
        (replaced(streams=without_game), "game"),
        (replaced(streams=with_score(-1.0)), "no score"),
        (replaced(streams=with_score(1e9)), "no score"),
        (shutil.rmtree, "contains no bags"),
    ],
)
def test_foreign_and_damaged_bags_are_rejected(tmp_path, damage, word):
    write_bag(game(2, 5), tmp_path / "anna" / "game-1")
    damage(tmp_path / "anna" / "game-1")
    with pytest.raises(InputError, match=word):
        with_people({"players": [], "matrix": []}, [tmp_path / "anna"])


def test_a_missing_folder_is_named(tmp_path):
    with pytest.raises(InputError, match="ana: there is no such folder"):
        with_people({"players": [], "matrix": []}, [tmp_path / "ana"])


def test_two_people_need_different_names(anna, tmp_path):
    shutil.copytree(anna, tmp_path / "others" / "anna")
    with pytest.raises(InputError, match="rename"):
        with_people({"players": [], "matrix": []}, [anna, tmp_path / "others" / "anna"])
