"""Commissioning a twin in another process."""

import signal

import numpy as np
import pytest

from airpuck import read_recording

from ..apparatus.processes import COMMANDS, IDLE, Process, Watch

pytestmark = [pytest.mark.slow, pytest.mark.realtime]


def test_ctrl_c_ends_a_live_run_with_idle_motors_and_keeps_all_flights(domain, tmp_path):
    twin, watch = Process("twin", "--quiet", domain=domain), Watch(domain)
    run = None

    def steered() -> bool:
        """Return whether several motors ran at once: pulses are of single ones."""
        running = np.array(watch.values(COMMANDS)).reshape(-1, 6) > IDLE + 1e-3
        return bool((running.sum(axis=1) > 1).any())

    try:
        watch.until(lambda: watch.heard["/optitrack/drone/pose"], 60.0)
        run = Process("commission", "-o", tmp_path, domain=domain)
        watch.until(steered, 120.0)
        run.signal(signal.SIGINT)
        status, out, err = run.end(60)
        watch.run(0.3)
    finally:
        for process in (run, twin):
            if process is not None:
                process.kill()
        watch.close()
    assert status == 2, out + err
    assert err.strip().endswith("not trusted: Stopped by the operator. Start again")
    np.testing.assert_array_equal(watch.values(COMMANDS)[-1], np.full(6, IDLE))
    flights = sorted((tmp_path / "flights").iterdir())
    rest, pulses, steered_one, *_ = (flight.name for flight in flights)
    # On a busy machine pulses come late, and the craft is first brought back.
    assert (rest, pulses) == ("01_rest", "02_pulses")
    assert steered_one in ("03_hover", "03_return")
    assert len(read_recording(flights[1])["pose"]) > 400
    assert "6 motors answer" in out + err
