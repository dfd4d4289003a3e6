"""`airpuck skills`, and what `airpuck play` refuses."""

import json

import pytest

from airpuck.boundary.errors import InputError
from airpuck.cli.app import app

from ..command_line import airpuck, refused


def test_skills_on_the_command_line():
    ended = airpuck("skills", "--episodes", "1", "--only", "defend", "--seed", "3", "--json", "-")
    assert ended.returncode == 0, ended.stderr
    figures = json.loads(ended.stdout)
    assert set(figures) == {"defend"}
    assert set(figures["defend"]) == {"successes", "episodes", "stopped", "interval_95"}
    assert figures["defend"]["successes"] == 1
    assert "defend: 1 of 1" in ended.stderr
    assert refused(airpuck("skills", "--episodes", "0"), "--episodes")


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        (("--no-page",), "--no-page: is for --live, which is not given"),
        (("--domain", "3"), "--domain: is for --live, which is not given"),
        (("--live", "--no-page", "--port", "9000"), "--port: does not go with --no-page"),
        (("--live", "--no-page", "--no-browser"), "--no-browser: does not go with --no-page"),
        (("--live", "--port", "0"), "--port: must be from 1 to 65535"),
    ],
)
def test_play_refuses_in_one_line(arguments, problem):
    with pytest.raises(InputError, match=problem):
        app([*("play", *arguments)], standalone_mode=False)
