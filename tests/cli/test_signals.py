"""Signals that reach real commands, by another process or by a terminal that closes."""

import contextlib
import itertools
import json
import os
import pty
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from airpuck.recording.read import read_recording

pytestmark = pytest.mark.slow

PLAN = ("plan", "--from", "-0.5", "0", "0", "--to", "0.5", "0.2", "2", "-o", "plan.toml")
#: Before the command: take the terminal on standard input, and begin as `airpuck` does.
TERMINAL = """
import fcntl, signal, termios
fcntl.ioctl(0, termios.TIOCSCTTY, 0)
signal.signal(signal.SIGHUP, signal.SIG_DFL)  # these tests may run under nohup
"""
MAIN = "from airpuck.boundary.signals import catch_signals; catch_signals()\n"
MAIN += "from airpuck.cli import main; main()\n"
#: Sends Ctrl-C in the middle of the first solution.
INTERRUPTED = """
import casadi, os, subprocess
usual, sent = casadi.nlpsol, []

class Solver:
    def __init__(self, *arguments):
        self.solver = usual(*arguments)
        self.stats = self.solver.stats
    def __call__(self, **problem):
        if not sent:
            sent.append(subprocess.Popen(["sh", "-c", f"sleep 0.02; kill -INT {os.getpid()}"]))
        return self.solver(**problem)

casadi.nlpsol = Solver
"""
#: Says "here", and stays there until a signal comes.
HERE = """
import sys, time
def here(*_):
    print("here", flush=True)
    time.sleep(60.0)
"""
#: Two moments at which the terminal closes.
MOMENTS = {
    "while it imports": "sys.addaudithook(lambda _, given: given[:1] == ('casadi',) and here())\n",
    "while it works": "import casadi; casadi.nlpsol = here\n",
}


@contextlib.contextmanager
def on_a_terminal(
    folder: Path, *arguments: str, before: str = ""
) -> Iterator[tuple[subprocess.Popen[str], int]]:
    """Start a command on a terminal of its own; yield it and the terminal's other end."""
    outside, inside = pty.openpty()
    with (folder / "stderr").open("w") as errors:
        process = subprocess.Popen(
            [sys.executable, "-c", TERMINAL + before + MAIN, *arguments],
            stdin=inside,
            stdout=inside,
            stderr=errors,
            text=True,
            cwd=folder,
            start_new_session=True,
        )
    os.close(inside)
    try:
        yield process, outside
    finally:
        process.kill()
        process.wait()
        with contextlib.suppress(OSError):
            os.close(outside)


def test_ctrl_c_during_planning_ends_with_one_line(tmp_path: Path):
    words = sys.executable, "-c", INTERRUPTED + MAIN, *PLAN
    done = subprocess.run(words, capture_output=True, text=True, cwd=tmp_path, check=False)
    assert done.returncode == 130, done.stderr
    assert done.stderr.strip().splitlines() == ["airpuck: interrupted"]
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("moment", MOMENTS)
def test_closing_the_terminal_ends_a_command_with_status_129(tmp_path: Path, moment: str):
    with on_a_terminal(tmp_path, *PLAN, before=HERE + MOMENTS[moment]) as (process, outside):
        shown = b""
        while b"here" not in shown:
            shown += os.read(outside, 100)
        os.close(outside)
        assert process.wait(30) == 129
    assert (tmp_path / "stderr").read_text() == "airpuck: interrupted\n"
    assert [path.name for path in tmp_path.iterdir()] == ["stderr"]


def test_a_game_is_kept_when_its_terminal_closes(tmp_path: Path):
    connect = pytest.importorskip("websockets.sync.client").connect
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = str(free.getsockname()[1])
    game = ("play", "--no-browser", "--port", port, "--record", "games", "--level", "easy")
    with on_a_terminal(tmp_path, *game) as (process, outside):
        deadline = time.monotonic() + 120.0  # to compile on a busy machine
        while "http://" not in (tmp_path / "stderr").read_text():
            assert time.monotonic() < deadline
            time.sleep(0.1)
        with connect(f"ws://127.0.0.1:{port}/", compression=None) as page:
            for do in ("sit", "go"):
                page.send(json.dumps({"do": do}))
            for number in itertools.count():
                page.send(struct.pack("<Ifff", number, 0.3, 0.3, 0.0))
                message = page.recv(timeout=10)
                if isinstance(message, str) and json.loads(message).get("phase") == "play":
                    break
                assert time.monotonic() < deadline
            time.sleep(1.0)
            os.close(outside)
            status = process.wait(60)
    assert status == 0, (tmp_path / "stderr").read_text()
    assert "Traceback" not in (tmp_path / "stderr").read_text()
    recording = read_recording(tmp_path / "games" / "game-1", needs=("mallet", "puck"))
    assert np.ptp(recording["mallet"].stamp_ns) > 3e8
