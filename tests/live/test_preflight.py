"""The check before flight, of a twin in another process."""

import pytest

from ..apparatus.processes import Process, Watch

pytestmark = [pytest.mark.slow, pytest.mark.realtime]


def test_a_twin_passes_the_preflight_check(domain):
    twin, watch = Process("twin", "--quiet", domain=domain), Watch(domain)
    try:
        watch.until(lambda: watch.heard["/optitrack/drone/pose"], 60.0)
        status, out, err = Process("preflight", "--model", "paper:M3", domain=domain).end(90)
    finally:
        twin.kill()
        watch.close()
    assert status == 0, out + err
    assert "as expected" in out
    assert out.count("order and sign agree") == 6


def test_missing_poses_are_reported(domain):
    status, out, err = Process("preflight", "-q", domain=domain).end(90)
    assert status == 2
    assert "none arrived" in out
    assert err.startswith("airpuck: not ready to fly: fix poses")
