"""Cameras as recordings show them, against the twin's settings."""

from dataclasses import replace

import pytest

from airpuck.identification.cameras import cameras_of
from airpuck.model.model_file import published_model
from airpuck.preprocessing.pipeline import preprocess
from airpuck.twin.experiments import excite
from airpuck.twin.settings import default_twin_settings

from ..apparatus.models import scaled

TRUTH = replace(published_model("M3"), frame="body", indexing="start")


def flown(duration: float = 8.0, **camera):
    settings = default_twin_settings()
    capture = settings.motion_capture.model_copy(update=camera)
    settings = settings.model_copy(update={"motion_capture": capture}).without_on_board()
    return preprocess(excite(TRUTH, duration, 1, settings=settings), TRUTH.vehicle)


@pytest.fixture(scope="module")
def rounded():
    noise = {"position_noise_m": 1.5e-4, "yaw_noise_rad": 1.8e-3}
    return flown(rate_hz=120.0, stamp_step_s=1e-3, **noise)


def known(found):
    assert found is not None
    return found


@pytest.mark.slow
@pytest.mark.parametrize("model", [TRUTH, scaled(TRUTH, 0.85)])
def test_noise_and_rate_are_estimated_despite_rounded_stamps(model, rounded):
    found = known(cameras_of(model, [rounded]))
    assert found.rate_hz == pytest.approx(120, rel=1e-3)
    assert found.position_noise_m == pytest.approx(1.5e-4, rel=0.15)
    assert found.yaw_noise_rad == pytest.approx(1.8e-3, rel=0.15)
    # A millisecond's rounding has a standard deviation of 0.29 ms.
    assert found.stamp_jitter_s == pytest.approx(0.29e-3, rel=0.4)


@pytest.mark.slow
def test_exact_stamps_have_no_jitter_at_any_rate():
    for rate in (50.0, 240.0):
        found = known(cameras_of(TRUTH, [flown(rate_hz=rate)]))
        assert found.stamp_jitter_s < 1e-4
        assert found.position_noise_m == pytest.approx(4.5e-5, rel=0.25)
        assert found.yaw_noise_rad == pytest.approx(6.5e-4, rel=0.25)
        assert found.rate_hz == pytest.approx(rate, rel=1e-3)


def test_a_contact_does_not_count_as_noise(rounded):
    state = rounded.state.copy()
    state[300:, :2] += 0.01
    found = known(cameras_of(TRUTH, [replace(rounded, state=state)]))
    assert found.position_noise_m == pytest.approx(1.5e-4, rel=0.15)


def test_a_few_poses_determine_nothing(rounded):
    assert cameras_of(TRUTH, [rounded.slice(0.0, 0.02)]) is None
