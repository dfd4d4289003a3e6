"""`airpuck skills`, and input that `airpuck play` rejects."""

import json
import os
import signal
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from airpuck.boundary.errors import InputError
from airpuck.cli.app import commands
from airpuck_hockey.game.contestant import PLAYERS
from tests.apparatus.commands import airpuck, refused


def test_skills_are_measured_on_the_command_line():
    ended = airpuck("skills", "--episodes", "1", "--only", "defend", "--seed", "3", "--json", "-")
    assert ended.returncode == 0, ended.stderr
    figures = json.loads(ended.stdout)
    assert set(figures) == {"defend"}
    assert set(figures["defend"]) == {"successes", "episodes", "stopped", "interval_95"}
    assert figures["defend"]["successes"] == 1
    assert "defend: 1 of 1" in ended.stderr
    assert refused(airpuck("skills", "--episodes", "0"), "--episodes")


def test_listing_the_commands_imports_no_heavy_package():
    code = (
        "import sys; from airpuck.cli.app import known_commands; known_commands(); "
        "print(*{'numpy', 'scipy', 'jax', 'matplotlib'} & set(sys.modules))"
    )
    words = [sys.executable, "-c", code]
    assert not subprocess.run(words, capture_output=True, text=True, check=True).stdout.split()


@pytest.mark.parametrize("name", ["match", "league"])
def test_the_help_lists_every_player(name):
    shown = " ".join(airpuck(name, "--help", env={**os.environ, "COLUMNS": "1000"}).stdout.split())
    assert f"{', '.join(PLAYERS)}, each with :LEVEL" in shown


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        (("play", "--domain", "3"), "--domain: no such option"),
        (("play", "--port", "0"), "--port: must be from 1 to 65535"),
        (("play", "--level", "hrd"), "--level: must be .*, not 'hrd'; did you mean 'hard'"),
        (("play", "hard"), "hard: unexpected argument; use --level hard .see .*play --help"),
        (("skills", "shots"), "shots: unexpected argument .see .*skills --help"),
        (("match", "wall", "x.py:M"), "wall: unexpected argument; use --left wall --right x.py:M"),
        (("animate", "a", "b", "-o", "c.gif"), "b: unexpected argument .see .*animate --help"),
        (("play-live", "--port", "-1"), "--port: must be from 0 to 65535"),
        (("play-live", "--port", "0", "--no-browser"), "--no-browser: has no effect with --port 0"),
        (("play-live", "--domain", "233"), "--domain: must be from 0 to 232"),
    ],
)
def test_wrong_usage_of_play_ends_in_one_line(arguments, problem):
    with pytest.raises(InputError, match=problem):
        commands()([*arguments], standalone_mode=False)


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="finds the server in /proc")
def test_a_killed_page_server_costs_neither_figures_nor_a_traceback(tmp_path):
    pytest.importorskip("websockets")
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    file = tmp_path / "figures.json"
    command = ["play", "--no-browser", "--port", str(port), "--duration", "60", "--json", str(file)]
    playing = subprocess.Popen(
        [sys.executable, "-c", "from airpuck.cli import main; main()", *command],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        assert playing.stderr is not None
        assert "Play at" in playing.stderr.readline()
        servers = [
            int(child)
            for child in Path(f"/proc/{playing.pid}/task/{playing.pid}/children")
            .read_text()
            .split()
            if b"spawn_main" in Path(f"/proc/{child}/cmdline").read_bytes()
        ]
        assert len(servers) == 1
        os.kill(servers[0], signal.SIGKILL)
        _, said = playing.communicate(timeout=60)
    finally:
        playing.kill()
    assert playing.returncode == 1
    assert "Traceback" not in said
    assert "airpuck: the page server has ended" in said
    assert json.loads(file.read_text())["page_server_ended"] is True
