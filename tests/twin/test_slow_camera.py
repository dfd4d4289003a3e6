"""A slow craft that is flown with a camera of 8 frames a second."""

from pathlib import Path

import numpy as np
import pytest

from airpuck import SetPoint
from airpuck.control.tuning import read_tuning
from airpuck.craft.vehicle import read_vehicle
from airpuck.model.model_file import nominal_model
from airpuck.twin.experiments import track
from airpuck.twin.settings import read_twin_settings

FREE_FLYERS = Path(__file__).parents[2] / "examples" / "free_flyers"
GOAL = (0.1, 0.05, 0.3)


@pytest.mark.slow
@pytest.mark.parametrize("law", ["lqr", "mpc"])
def test_a_craft_seen_by_a_slow_camera_settles_at_a_set_point(law: str) -> None:
    model = nominal_model(read_vehicle(FREE_FLYERS / "atmos.toml"))
    settings = read_twin_settings(FREE_FLYERS / "twin.toml")
    camera = {"rate_hz": 8.0, "latency_s": 0.1, "latency_jitter_s": 0.005}
    seen = settings.motion_capture.model_copy(update=camera)
    log = track(
        model,
        SetPoint(*GOAL),
        12.0,
        settings=settings.model_copy(update={"motion_capture": seen}),
        tuning=read_tuning(FREE_FLYERS / "atmos_tuning.toml").with_law(law),
    )
    recording = log.recording
    # Only the first steps come before the first pose.
    assert sum(status in ("no pose", "stale pose") for status in log.status) <= 2
    error = np.abs(recording["pose"].values[-8:, :3] - GOAL).max(axis=0)
    assert (error < [0.01, 0.01, 0.03]).all(), error
