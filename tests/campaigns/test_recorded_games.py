"""People in a league: their recorded games, and damaged or foreign bags."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest

from airpuck.hockey.contestant import contestant
from airpuck.hockey.game import KINDS, Game
from airpuck.recording.bag_writer import write_bag
from airpuck.recording.stream import COLUMNS, Recording, Stream

from ..apparatus.commands import airpuck, refused

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


def test_a_person_is_rated_by_goals_against_the_level_that_played(anna, tmp_path):
    write_bag(game(9, 2), tmp_path / "ben" / "game-1")
    result = airpuck("league", "--bags", anna, tmp_path / "ben", "--json", "-")
    figures = json.loads(result.stdout)
    assert sorted(figures["players"]) == ["airpuck:medium", "anna", "ben"]
    assert figures["rated_by"] == "goals"
    rated = {one["player"]: one for one in figures["ratings"]}
    assert rated["anna"]["value"] > rated["airpuck:medium"]["value"] > rated["ben"]["value"]
    assert rated["anna"]["low"] < rated["anna"]["value"] < rated["anna"]["high"]
    one, other = (figures["players"].index(name) for name in ("anna", "airpuck:medium"))
    cell = figures["matrix"][one][other]
    assert cell == {
        "games": 2,
        "wins": 2,
        "losses": 0,
        "goals_for": 12,
        "goals_against": 8,
        "seconds": pytest.approx(120.0),
    }
    assert set(figures["people"]) == {"anna", "ben"}
    assert figures["people"]["ben"]["reaction_s"]["value"] is None  # no one hit the puck


def test_people_join_the_players_of_a_league(tmp_path):
    write_bag(game(3, 1, names={"left": "wild", "right": "you"}), tmp_path / "anna" / "game-1")
    arguments = ("keeper", "wild", "--games", 1, "--limit", 0.1, "--workers", 1)
    bags = ("--bags", tmp_path / "anna")
    figures = json.loads(airpuck("league", *arguments, *bags, "--json", "-").stdout)
    assert figures["players"] == ["keeper", "wild", "anna"]
    assert figures["matrix"][1][2]["goals_for"] == 3


def test_a_game_that_was_left_at_once_is_a_draw(tmp_path):
    begun = Game(contestant("keeper"), contestant("human"))
    begun.step()
    write_bag(begun.recording(), tmp_path / "anna" / "game-1")
    result = airpuck("league", "--bags", tmp_path / "anna", "--json", "-")
    assert json.loads(result.stdout)["matrix"][0][1]["goals_for"] == 0


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
    refused(airpuck("league", "--bags", tmp_path / "anna"), word)


def test_a_folder_that_does_not_exist_is_named(tmp_path):
    refused(airpuck("league", "--bags", tmp_path / "ana"), "ana: there is no such folder")
    refused(airpuck("league", "--bags", tmp_path, f"{tmp_path}/ben/"), "ben/: there is no such")
    refused(airpuck("league", tmp_path, "wild"), "is a folder; for a person's games, use --bags")


def test_two_people_need_two_names(anna, tmp_path):
    shutil.copytree(anna, tmp_path / "others" / "anna")
    refused(airpuck("league", "--bags", anna, tmp_path / "others" / "anna"), "rename")
