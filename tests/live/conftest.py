from __future__ import annotations

import os

import pytest


@pytest.fixture(scope="session")
def domain() -> int:
    """A DDS domain of this process's own, so that tests that run side by side do not meet."""
    pytest.importorskip("cyclonedds")
    return 1 + os.getpid() % 200
