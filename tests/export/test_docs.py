"""The examples of docs/export.md run, section by section."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from airpuck.export import KINDS
from tests.apparatus.c_programs import compiler

ROOT = Path(__file__).parents[2]
TEXT = (ROOT / "docs/export.md").read_text("utf-8")
SECTIONS = dict(re.findall(r"^## `?(\w+)`?\n(.*?)(?=^## |\Z)", TEXT, re.M | re.S))
#: Interpreters of fenced examples, and the package that has them.
PROGRAMS = {
    "sh": ("sh", "-e", "-c"),
    "python": (sys.executable, "-c"),
    "matlab": ("octave-cli", "--eval"),
}


def test_every_kind_has_a_section():
    assert set(KINDS) <= set(SECTIONS)


@pytest.mark.slow
@pytest.mark.parametrize("name", SECTIONS)
def test_examples_run(name, tmp_path):
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    path = f"{Path(sys.executable).parent}:{os.environ['PATH']}"
    for language, code in re.findall(r"^```(\w+)\n(.*?)^```", SECTIONS[name], re.M | re.S):
        if language not in PROGRAMS:
            continue
        program = PROGRAMS[language]
        compiler(program[0])
        done = subprocess.run(
            [*program, code],
            cwd=tmp_path,
            env={**os.environ, "PATH": path},
            capture_output=True,
            text=True,
        )
        assert done.returncode == 0, f"{code}\n{done.stdout}{done.stderr}"
