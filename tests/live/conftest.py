import pytest


@pytest.fixture
def pair(domain):
    """Two participants of a graph."""
    from airpuck.live.graph import Graph

    first, second = Graph("first", domain=domain), Graph("second", domain=domain)
    yield first, second
    first.close()
    second.close()
