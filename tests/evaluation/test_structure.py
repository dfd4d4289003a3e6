"""Structure in residuals is found where it exists, with its size, and nowhere else."""

from dataclasses import replace

import numpy as np
import pytest

from airpuck.evaluation.residuals import resid

from ..apparatus.noisy_flights import TRUTH, noisy

pytestmark = pytest.mark.slow

#: Spin drag of the craft that its model lacks [1/s].
DRAG = 1.0


@pytest.fixture(scope="module")
def of_the_truth():
    return resid(TRUTH, noisy(duration=10.0, seed=4)).structure


@pytest.fixture(scope="module")
def dragged():
    drag = np.array([0.0, 0.0, DRAG, 0.0])
    model = replace(TRUTH, parameters=replace(TRUTH.parameters, drag=drag))
    return resid(TRUTH, noisy(model, duration=20.0, seed=5))


def test_a_craft_like_its_model_has_none(of_the_truth):
    assert len(of_the_truth) == 21
    assert not any(one.shown for one in of_the_truth)


def test_bands_hold_the_truth(of_the_truth):
    # 126 means whose truth is zero, 99 % bands: more than 6 outside has a probability of 0.1 %.
    outside = sum(np.sum(np.abs(one.mean) > one.half_band) for one in of_the_truth)
    assert outside <= 6


def test_spin_drag_is_found_with_its_size(dragged):
    found = {(one.regressor, one.channel): one for one in dragged.structure}
    worst = min(dragged.structure, key=lambda one: one.p_value)
    of_spin = found["spin", "yaw"]
    assert worst is of_spin and not of_spin.passed
    # The mean of each bin is -DRAG times its mean spin, nearly the middle one.
    inner = slice(1, -1)
    np.testing.assert_allclose(
        of_spin.mean[inner], -DRAG * of_spin.middle[inner], atol=1.5 * of_spin.half_band.max()
    )
    assert of_spin.unit == "rad/s²"
    assert of_spin.verdict in dragged.verdicts
    assert not dragged.passed
    assert not any(one.shown for one in dragged.structure if one.channel != "yaw")


def test_figures_have_units(dragged):
    written = dragged.to_json()["structure"]
    by_unit = {"yaw": "size_rad_s2", "left": "size_m_s2"}
    for one in written:
        if one["channel"] in by_unit:
            assert one[by_unit[one["channel"]]] >= 0
            assert one["passed"] in (True, False)
