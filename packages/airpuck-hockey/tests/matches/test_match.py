"""Several games of two players: stored, and not played twice."""

import contextlib
import json
import os
import pty
import shutil
import signal
import subprocess
import sys
from functools import partial

import pytest

import airpuck_hockey
from airpuck.boundary.errors import InputError
from airpuck.boundary.signals import Stopped
from airpuck.campaigns import items
from airpuck.campaigns.campaign import read_spec
from airpuck.recording.read import read_recording
from airpuck_hockey.game.rules import Rules
from airpuck_hockey.matches import match as match_module
from airpuck_hockey.matches.match import Match, match
from tests.apparatus.commands import airpuck, refused

SHORT = Rules(goals=2, limit_s=8.0)


@pytest.mark.slow
def test_games_add_up_and_are_played_once(tmp_path, monkeypatch):
    first = match("human:hard", "human:easy", 3, seed=5, rules=SHORT, workers=1, output=tmp_path)
    figures = first.to_json()
    assert figures["games"] == 3
    assert figures["left_wins"] + figures["right_wins"] + figures["draws"] == 3
    assert figures["left_goals"] == sum(game["left_goals"] for game in figures["results"])
    assert [game["seed"] for game in figures["results"]] == [5, 6, 7]
    (bag,) = (tmp_path / "games").glob("6-*")
    recording = read_recording(bag, needs=("pose", "puck"))
    goals = recording["game"].values[-1, :2].tolist()
    assert goals == [figures["results"][1][f"{side}_goals"] for side in ("left", "right")]
    played = []
    original = match_module.Game

    def noted(*args, **kwargs):
        played.append(kwargs["seed"])
        return original(*args, **kwargs)

    monkeypatch.setattr(match_module, "Game", noted)
    again = match("human:hard", "human:easy", 4, seed=5, rules=SHORT, workers=1, output=tmp_path)
    assert played == [8]
    assert again.games[:3] == first.games
    # A game without its bag is played again; games of other players have separate bags.
    shutil.rmtree(bag)
    match("human:hard", "human:easy", 3, seed=5, rules=SHORT, workers=1, output=tmp_path)
    assert played == [8, 6]
    assert bag.exists()
    match("human:easy", "human:easy", 1, seed=6, rules=SHORT, workers=1, output=tmp_path)
    assert len(list((tmp_path / "games").glob("6-*"))) == 2


def test_an_interrupted_match_states_whether_its_games_are_kept(tmp_path, monkeypatch):
    def interrupted(item, tell):
        raise Stopped(signal.SIGINT)

    monkeypatch.setattr(match_module, "compute", interrupted)
    for output, words in (((), "only -o DIR keeps"), (("-o", tmp_path), "run it again to play")):
        ended = airpuck("match", "--left", "striker", "--workers", 1, *output)
        assert ended.returncode == 130
        assert words in ended.stderr


def test_the_interval_of_wins_is_wilsons():
    found = match("human:hard", "human:easy", 1, rules=Rules(limit_s=0.1), workers=1).to_json()
    assert found["draws"] == 1
    # For no success in one trial the upper end is z² / (1 + z²).
    assert found["left_wins_interval"] == pytest.approx([0.0, 1.96**2 / (1 + 1.96**2)], abs=1e-4)


@pytest.mark.slow
def test_a_failing_tactic_fails_the_match(tmp_path):
    (tmp_path / "bad.py").write_text("class Bad:\n    def decide(self, view): return 1 / 0\n")
    name = f"{tmp_path / 'bad.py'}:Bad"
    with pytest.raises(InputError, match="ZeroDivisionError") as error:
        match(name, "human", rules=SHORT, workers=1)
    assert "bad.py:Bad" in str(error.value)


def test_the_key_depends_on_the_tactics_file_but_not_on_the_bag_folder(tmp_path):
    file = tmp_path / "mine.py"
    file.write_text("class Mine: ...\n")
    name = f"{file}:Mine"
    keys = [Match(left=name).key(), Match(left=name, bag="games/1").key()]
    assert keys[0] == keys[1]
    file.write_text("class Mine: ... # better\n")
    assert Match(left=name).key() != keys[0]
    assert Match(left=f"{file}:Other").key() != Match(left=name).key()
    assert Match().key() != Match(right="human:hard").key()


@pytest.mark.slow
def test_a_campaign_can_play_matches(tmp_path):
    (tmp_path / "mine.py").write_text("class Mine: ...\n")
    (tmp_path / "spec.toml").write_text(
        'kind = "match"\nseeds = 2\nbase.left = "mine.py:Mine"\n'
        'grid.right = ["human:easy", "airpuck:hard"]\n'
    )
    entries = read_spec(tmp_path / "spec.toml")
    assert [entry.item.right for entry in entries] == ["human:easy"] * 2 + ["airpuck:hard"] * 2
    assert entries[0].item.left == str(tmp_path / "mine.py:Mine")


@pytest.mark.slow
def test_a_match_is_played_from_the_command_line(tmp_path):
    who = ("--left", "human:hard", "--right", "human:easy")
    done = airpuck(
        "match", *who, "--games", "2", "--limit", "2", "--workers", "1", "--json", "-", cwd=tmp_path
    )
    assert done.returncode == 0, done.stderr
    figures = json.loads(done.stdout)
    assert (figures["left"], figures["right"], figures["games"]) == ("human:hard", "human:easy", 2)
    assert figures["rail_contacts"] == 0
    shown = airpuck("match", *who, "--limit", "2", "-q", cwd=tmp_path)
    assert "human:hard" in shown.stdout
    assert "times real time" in shown.stdout
    watched = airpuck("watch-match", *who, "--limit", "1", cwd=tmp_path)
    assert "over" in watched.stderr
    assert "times real time" not in watched.stdout  # it is shown in real time
    refused(airpuck("match", "--left", "robot", cwd=tmp_path), "robot", "unknown player")
    hands = "--left", "human", "--right", "wall", "--model", "paper:M2"
    refused(airpuck("match", *hands), "--model: has no effect: all players are hands")


def test_the_last_seed_of_a_match_has_a_limit():
    with pytest.raises(InputError, match=r"4\.61e18: each side has its own 64-bit seed"):
        match("human", "human", 2, seed=2**62 - 1, workers=1)


def test_a_module_imported_by_a_tactic_belongs_to_its_key(tmp_path):
    (tmp_path / "mine.py").write_text("import numpy\nfrom beside import far\nclass Mine: ...\n")
    (tmp_path / "beside").mkdir()
    (tmp_path / "beside" / "__init__.py").write_text("")
    (tmp_path / "beside" / "far.py").write_text("import farther\n")
    (tmp_path / "farther.py").write_text("number = 1\n")
    item = Match(left=f"{tmp_path / 'mine.py'}:Mine")
    before = item.key()
    (tmp_path / "unrelated.py").write_text("number = 1\n")
    assert item.key() == before
    (tmp_path / "farther.py").write_text("number = 2\n")
    assert item.key() != before


def test_every_key_depends_on_our_code(monkeypatch):
    before = Match().key()
    monkeypatch.setattr(items, "program", lambda module: "another")
    assert Match().key() != before


def test_a_folder_as_a_model_and_the_root_as_output_are_rejected(tmp_path):
    with pytest.raises(InputError, match="/: is a folder; a file is expected"):
        Match(model="/").key()
    with pytest.raises(InputError, match="/: output: is the root folder"):
        match("human", "human", rules=SHORT, output="/")
    (tmp_path / "spec.toml").write_text('kind = "fit"\nbase.recordings = ["/"]\n')
    with pytest.raises(InputError, match="/: contains too many files"):
        read_spec(tmp_path / "spec.toml")


def test_a_damaged_bag_is_rewritten(tmp_path):
    play = partial(match, "human", "human", rules=Rules(limit_s=0.1), workers=1, output=tmp_path)
    play()
    (bag,) = (tmp_path / "games").glob("*/*.mcap")
    refused(airpuck("animate", bag.parent, "-o", tmp_path / "a.gif"), "a game between two hands")
    content = bag.read_bytes()
    bag.write_bytes(content[:-100])
    play()
    assert bag.read_bytes() == content


@pytest.mark.slow
def test_a_game_is_drawn_in_a_terminal_with_its_progress():
    def shown(verb, *arguments):
        """Return what a terminal receives."""
        ours, theirs = pty.openpty()
        command = "from airpuck.cli import main; main()"
        words = ("--left", "human", "--right", "human", *arguments)
        process = subprocess.Popen(
            [sys.executable, "-c", command, verb, *words],
            stdin=theirs,
            stdout=theirs,
            stderr=theirs,
        )
        os.close(theirs)
        text = b""
        with contextlib.suppress(OSError):  # the end, on Linux
            while part := os.read(ours, 4096):
                text += part
        os.close(ours)
        assert process.wait() == 0, text
        return text.decode()

    assert "LLL" in shown("watch-match", "--limit", "0.3")
    assert "%" in shown("match", "--limit", "2")


@pytest.mark.slow
def test_games_are_played_by_the_workers_of_a_scheduler(cluster):
    cluster.scale(1)
    play = partial(
        airpuck_hockey.match, "human", "keeper", 2, rules=airpuck_hockey.Rules(limit_s=0.2)
    )
    there, here = (play(workers=w).to_json() for w in (cluster.scheduler_address, "1"))
    assert there | {"wall_s": 0} == here | {"wall_s": 0}
