"""C compilers: which are present, and how the tests call them."""

import os
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path

import pytest

#: C99 without a single warning.
STRICT = ("-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Werror")
#: In single precision no double may appear.
SINGLE = ("-DAIRPUCK_SINGLE", "-Wdouble-promotion", "-Wfloat-conversion")
SANITIZED = ("-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")


def compiler(name: str) -> str:
    """Return a program; without it, skip the test, or fail where CI requires it."""
    found = shutil.which(name)
    if found is None and os.environ.get("AIRPUCK_REQUIRE_TOOLS"):
        pytest.fail(f"CI must install {name}")
    return found or pytest.skip(f"needs {name}")


def build(
    program: Path, sources: Sequence[Path], *options: str, using: str = "gcc", link: str = "-lm"
) -> Path:
    """Compile C sources without warnings; headers lie beside them."""
    folders = [f"-I{folder}" for folder in dict.fromkeys(source.parent for source in sources)]
    command = [compiler(using), *STRICT, *options, *folders, *map(str, sources)]
    done = subprocess.run(
        [*command, "-o", str(program), link], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return program
