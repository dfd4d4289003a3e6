"""Settings of the process."""

import os
import subprocess
import sys

import pytest

from airpuck.cli import main

from ..apparatus.commands import airpuck_process

FOLDER = "JAX_COMPILATION_CACHE_DIR"

#: Prints whether the setting came in time, and the share of a program's time that the calling
#: thread spends in it: the maximum of several runs, since other programs may use the cores.
SHARE = """
import sys, time
import jax, numpy as np
from airpuck.compute.compiled import program
from airpuck.compute.process import large_programs_are_fast, low_latency

if "late" in sys.argv:
    jax.numpy.ones(3)
in_time = low_latency() if "never" not in sys.argv else False

def long(xp, vector):
    matrix = vector.reshape(12, 12)
    return (jax.lax.fori_loop(0, 20_000, lambda _, m: matrix @ m / 12, matrix),)

run, ones = program(long, np.ones(144), compiled=True), np.ones(144)
run(ones)
shares = []
for _ in range(5):
    own, whole = time.thread_time(), time.process_time()
    run(ones)
    shares.append((time.thread_time() - own) / (time.process_time() - whole))
assert large_programs_are_fast() == in_time
print(in_time, max(shares))
"""


@pytest.mark.parametrize("set_", ["early", "late", "never"])
def test_large_programs_run_in_the_calling_thread_if_set_in_time(set_):
    command = [sys.executable, "-c", SHARE, set_]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    in_time, share = done.stdout.split()
    assert in_time == str(set_ == "early")
    assert (float(share) > 0.5) == (set_ == "early")


@pytest.fixture
def cache(tmp_path, monkeypatch):
    """The default folder of a user."""
    for name in [name for name in os.environ if name.startswith(("JAX_", "XDG_"))]:
        monkeypatch.delenv(name)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path / "cache"


@pytest.mark.slow
def test_commands_cache_their_compiled_programs(cache, tmp_path):
    process = airpuck_process("excite", "--duration", "0.5", "-o", tmp_path / "bag")
    assert process.returncode == 0, process.stderr
    assert process.stderr == ""
    assert list((cache / "airpuck" / "compiled").iterdir())


def settings(monkeypatch):
    """Return the environment that a command sets for JAX."""
    monkeypatch.setattr("sys.argv", ["airpuck", "--version"])
    with pytest.raises(SystemExit, match="0"):
        main()
    return {name: value for name, value in os.environ.items() if name.startswith("JAX_")}


def test_the_users_cache_setting_takes_precedence(cache, monkeypatch):
    monkeypatch.setenv(FOLDER, "mine")
    assert settings(monkeypatch) == {FOLDER: "mine"}
    assert not cache.exists()


def test_without_a_cache_folder_nothing_is_stored(cache, monkeypatch):
    cache.write_text("a file")
    assert not settings(monkeypatch)
