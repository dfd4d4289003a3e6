"""A recording for commands."""

from pathlib import Path

import pytest

from airpuck import write_bag

from ..apparatus.synthetic_flights import record


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("bags") / "flight"
    write_bag(record(duration=8.0, noise=1e-4), folder)
    return folder
