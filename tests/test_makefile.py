"""Commands that make would run."""

import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


@pytest.mark.skipif(shutil.which("make") is None, reason="make is not installed")
@pytest.mark.parametrize(
    ("target", "installed"),
    [
        ("install", "-e '.[plan]' -e ./packages/airpuck-hockey\n"),
        ("play", "-e '.[plan]' -e ./packages/airpuck-hockey\n"),
        ("dev", "-e '.[dev]' -e ./packages/airpuck-hockey\n"),
        ("live", "-e '.[plan,ros2,pages]' -e ./packages/airpuck-hockey\n"),
    ],
)
def test_a_target_installs_what_it_uses_with_uv_and_with_pip(target, installed):
    # As in a fresh checkout.
    command = ["make", "-n", "-B", target, "VENV=.no-venv"]
    said = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout
    assert said.replace(" ||", "\n").count(installed) == 2
