from __future__ import annotations

import os

import pytest


@pytest.fixture(scope="session")
def domain() -> int:
    """A DDS domain of this process's own, so that tests that run side by side do not meet."""
    pytest.importorskip("cyclonedds")
    return 1 + os.getpid() % 200


@pytest.fixture
def pair(domain):
    """Two who meet on the graph."""
    from airpuck.live.graph import Graph

    first, second = Graph("first", domain=domain), Graph("second", domain=domain)
    yield first, second
    first.close()
    second.close()
