"""`airpuck skills`."""

import json

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
