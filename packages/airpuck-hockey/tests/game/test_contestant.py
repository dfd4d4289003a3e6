"""Players by name, and errors for invalid ones."""

from pathlib import Path

import numpy as np
import pytest

import airpuck
import airpuck_hockey
from airpuck import InputError, SetPoint
from airpuck_hockey import Game, Intention
from airpuck_hockey.game.contestant import PLAYERS, contestant
from tests.apparatus.refusals import rejected

TACTICS = """
import numpy as np
import airpuck
import airpuck_hockey

class Raises:
    def decide(self, view):
        return 1 / 0

class SaysUp:
    def decide(self, view):
        return "up"

class GoesNowhere:
    def decide(self, view):
        return airpuck_hockey.Intention("home", airpuck.SetPoint(float("nan"), 0, 0))

class HasNoReference:
    def decide(self, view):
        return airpuck_hockey.Intention("home", None)

class AvoidsAWord:
    def decide(self, view):
        return airpuck_hockey.Intention("home", airpuck.SetPoint(-0.8, 0, 0), avoid="it")

class MeetsNever:
    def decide(self, view):
        home = airpuck.SetPoint(-0.8, 0, 0)
        return airpuck_hockey.Intention("home", home, meet=(1.0, np.inf, 0.0))

class SeesNoPath:
    def decide(self, view):
        home = airpuck.SetPoint(-0.8, 0, 0)
        return airpuck_hockey.Intention("home", home, path=np.zeros((4, 3)))

class HopesInWords:
    def decide(self, view):
        return airpuck_hockey.Intention("home", airpuck.SetPoint(-0.8, 0, 0), chance="high")

class NeedsMore:
    def __init__(self, more):
        pass

class DecidesNothing:
    pass

class Stays:
    def decide(self, view):
        return airpuck_hockey.Intention("wait", airpuck.SetPoint(-0.8, 0.1, 0))
"""


@pytest.fixture
def tactics(tmp_path):
    (tmp_path / "mine.py").write_text(TACTICS)
    return tmp_path / "mine.py"


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("Raises", r"decide\(\) at 0\.0\d s: ZeroDivisionError: division by zero"),
        ("SaysUp", r"must return an Intention, not str"),
        ("GoesNowhere", r"x: must be a finite number, not nan"),
        # With checked signatures, `Intention` itself rejects some of them.
        ("HasNoReference", "reference"),
        ("AvoidsAWord", "avoid"),
        ("MeetsNever", r"meet: must be 3 finite numbers"),
        ("SeesNoPath", "path"),
        ("HopesInWords", "chance"),
        ("NeedsMore", r"cannot be made without arguments: TypeError"),
        ("DecidesNothing", r"lacks decide"),
    ],
)
def test_a_failing_tactic_is_named_in_one_line(tactics, name, words):
    with rejected(f"mine.py:{name}", match=words):
        game = Game(contestant(f"{tactics}:{name}"), contestant("human"))
        for _ in range(5):
            game.step()


@pytest.mark.slow
def test_a_user_tactic_plays_on_either_side(tactics):
    mine = contestant(f"{tactics}:Stays")
    game = Game(mine, mine, seed=1)
    for _ in range(150):
        game.step()
    for side in game.sides:
        own = np.array(side.state[:2]) * -side.sign
        np.testing.assert_allclose(own, (-0.8, 0.1), atol=0.03)
    assert isinstance(game.sides[1].player.intention, Intention)
    assert not isinstance(game.sides[1].player.intention.reference, SetPoint)  # turned


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("robot", "unknown player; use airpuck"),
        ("", "unknown player"),
        ("human:godlike", "unknown level; use easy, medium, hard"),
        ("airpuck:", "unknown level"),
        ("nowhere.py:Tactic", "there is no such file"),
    ],
)
def test_unknown_players_and_levels_are_named(name, words):
    with pytest.raises(InputError, match=words):
        contestant(name)


@pytest.mark.parametrize("level", ["easy", "medium", "hard"])
def test_every_player_has_three_levels(level):
    found = {name: contestant(f"{name}:{level}") for name in PLAYERS}
    assert {name for name, one in found.items() if one.player is not None} == {
        "airpuck",
        "predecessor",
    }
    assert {name for name, one in found.items() if one.hand is not None} >= {"keeper", "striker"}


def test_a_tactic_defends_its_goal():
    examples = Path(airpuck.__file__).parents[2] / "examples"
    name = f"{examples / 'own_tactic' / 'goalie.py'}:Goalie"
    game = airpuck_hockey.Game(
        airpuck_hockey.contestant(name), airpuck_hockey.contestant("human:easy"), seed=1
    )
    while game.time < 1.0:
        game.step()
    assert game.sides[0].state[0] < 0


@pytest.mark.parametrize(("given", "near"), [("keper", "keeper"), ("keeper:hrd", "hard")])
def test_an_unknown_name_suggests_the_closest_one(given, near):
    with pytest.raises(InputError, match=f"did you mean '{near}'\\?$"):
        airpuck_hockey.contestant(given)
