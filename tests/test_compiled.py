"""What commands keep of compiled programs."""

import os

import pytest

from .test_cli import airpuck


def environment(tmp_path, **more):
    kept = {k: v for k, v in os.environ.items() if not k.startswith(("JAX_", "XDG_"))}
    return kept | {"XDG_CACHE_HOME": str(tmp_path / "cache")} | more


def excite(tmp_path, env):
    process = airpuck("excite", "--duration", "0.5", "-o", tmp_path / "bag", env=env)
    assert process.returncode == 0, process.stderr
    assert process.stderr == ""


def test_commands_keep_what_they_compile(tmp_path):
    excite(tmp_path, environment(tmp_path))
    assert list((tmp_path / "cache" / "airpuck" / "compiled").iterdir())


@pytest.mark.parametrize("where", ["elsewhere", "nowhere", "no folder"])
def test_a_user_decides_otherwise(tmp_path, where):
    more = {}
    if where == "elsewhere":
        more = {"JAX_COMPILATION_CACHE_DIR": str(tmp_path / "mine")}
    elif where == "nowhere":
        more = {"JAX_ENABLE_COMPILATION_CACHE": "false"}
    else:
        (tmp_path / "cache").write_text("a file")
    excite(tmp_path, environment(tmp_path, **more))
    kept = tmp_path / "cache" / "airpuck" / "compiled"
    assert not kept.exists() or not list(kept.iterdir())
