"""Any misbehaviour of a user's tactic becomes one line that names its file."""

import json

import pytest

from airpuck.boundary.errors import InputError
from airpuck_hockey.game.rules import Rules
from airpuck_hockey.matches.match import match
from tests.apparatus import commands as command_line
from tests.apparatus.misdeeds import MISDEEDS, one_line, written

#: Misbehaviour that looks like an end by our own code, and what commands say of it.
MISTAKEN_FOR_OURS = {"sys.exit(0)": "SystemExit: 0", "raise KeyboardInterrupt": "KeyboardInterrupt"}


TACTIC = """
import airpuck_hockey

class Mine:
    def __init__(self):
        {init}wrong()
        self.where = {where}

    def decide(self, view):
        {decide}wrong()
        return airpuck_hockey.Intention("home", self.where)
"""


RENDEZVOUS = "airpuck.Rendezvous(0.01, [-0.8, 0, 0, 0, 0, 0], then=Where())"


@pytest.mark.parametrize("misdeed", MISDEEDS.values(), ids=MISDEEDS)
@pytest.mark.parametrize("place", ["init", "decide"])
def test_a_misbehaving_tactic_ends_in_one_line(tmp_path, capsys, place, misdeed):
    name = written(tmp_path, TACTIC, place, misdeed)
    with pytest.raises(InputError) as error:
        match(name, "human", rules=Rules(limit_s=0.1), workers=1)
    one_line(error, name, capsys)


@pytest.mark.parametrize("verb", ["match", "watch-match"])
def test_a_tactic_cannot_end_the_command_or_corrupt_its_json(tmp_path, verb):
    for misdeed, said in MISTAKEN_FOR_OURS.items():
        name = written(tmp_path, TACTIC, "at", misdeed)
        ended = command_line.airpuck(verb, "--left", name, "--limit", "0.1", "--json", "-")
        assert ended.returncode == 2
        assert ended.stdout == ""
        assert said in ended.stderr.splitlines()[-1]
    name = written(tmp_path, TACTIC, "decide", "pass")
    ended = command_line.airpuck(verb, "--left", name, "--limit", "0.1", "--json", "-")
    assert json.loads(ended.stdout)["games"] == 1
    assert "here I am" in ended.stderr


@pytest.mark.parametrize("where", ["Where()", RENDEZVOUS])
@pytest.mark.parametrize("place", ["at", "asked", "over"])
def test_a_misbehaving_reference_ends_in_one_line(tmp_path, capsys, place, where):
    name = written(tmp_path, TACTIC, place, where=where)
    with pytest.raises(InputError) as error:
        match(name, "human", rules=Rules(limit_s=0.1), workers=1)
    one_line(error, name, capsys)
