"""What commands keep of compiled programs."""

import os

import pytest

from airpuck.cli import main

from .command_line import airpuck_process

FOLDER = "JAX_COMPILATION_CACHE_DIR"


@pytest.fixture
def cache(tmp_path, monkeypatch):
    """The folder of a user who has decided nothing."""
    for name in [name for name in os.environ if name.startswith(("JAX_", "XDG_"))]:
        monkeypatch.delenv(name)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path / "cache"


def test_commands_keep_what_they_compile(cache, tmp_path):
    process = airpuck_process("excite", "--duration", "0.5", "-o", tmp_path / "bag")
    assert process.returncode == 0, process.stderr
    assert process.stderr == ""
    assert list((cache / "airpuck" / "compiled").iterdir())


def settings(monkeypatch):
    """What a command leaves in the environment, where JAX reads its settings."""
    monkeypatch.setattr("sys.argv", ["airpuck", "--version"])
    with pytest.raises(SystemExit, match="0"):
        main()
    return {name: value for name, value in os.environ.items() if name.startswith("JAX_")}


def test_a_user_decides_otherwise(cache, monkeypatch):
    monkeypatch.setenv(FOLDER, "mine")
    assert settings(monkeypatch) == {FOLDER: "mine"}
    assert not cache.exists()


def test_without_a_folder_nothing_is_kept(cache, monkeypatch):
    cache.write_text("a file")
    assert not settings(monkeypatch)
