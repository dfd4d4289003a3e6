"""Shared fixtures; and while the tests run, every jaxtyping signature is checked."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from jaxtyping import install_import_hook

from . import typechecker  # noqa: F401  (the hook names it)

_hook = install_import_hook("airpuck", "tests.typechecker.check")

TRAINING = "2023_10_18-11_28_12_sysid_h1_old"
VALIDATION = "2023_11_22-11_57_44_sysid_h1_old"
BLUE = "2024_03_05-16_12_50_sysid_h1_blue"


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave long studies out unless they are asked for."""
    if "study" in (config.option.markexpr or ""):
        return
    for item in items:
        if item.get_closest_marker("study"):
            item.add_marker(pytest.mark.skip(reason="long; runs with `make studies`"))


@pytest.fixture(scope="session")
def data() -> Path:
    """Folder of the public dataset; skips, or fails where CI says that it must be there."""
    folder = os.environ.get("AIRPUCK_DATA")
    if folder and Path(folder).is_dir():
        return Path(folder)
    reason = "needs the real recordings: set AIRPUCK_DATA to a folder made by `airpuck fetch`"
    if os.environ.get("AIRPUCK_REQUIRE_DATA"):
        pytest.fail(reason)
    pytest.skip(reason)


@pytest.fixture(scope="session")
def experiments(data: Path) -> Path:
    """Folder of the experiments in the public dataset."""
    return data / "experiments"
