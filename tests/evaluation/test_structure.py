"""Structure in residuals is found where it exists, with its size, and nowhere else."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from airpuck.evaluation.innovations import innovations
from airpuck.evaluation.residuals import resid
from airpuck.evaluation.structure import BINS, Structure, cut

from ..apparatus.noisy_flights import TRUTH, noisy

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


@pytest.mark.slow
def test_a_craft_that_matches_its_model_shows_no_structure(of_the_truth):
    assert len(of_the_truth) == 21
    assert not any(one.shown for one in of_the_truth)


@pytest.mark.slow
def test_bands_cover_the_truth(of_the_truth):
    # 126 means whose truth is zero, 99 % bands: more than 6 outside has a probability of 0.1 %.
    outside = sum(np.sum(np.abs(one.mean) > one.half_band) for one in of_the_truth)
    assert outside <= 6


@pytest.mark.slow
def test_spin_drag_is_detected_with_its_size(dragged):
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
    assert 0.02 < of_spin.share < 1  # of what the motors do: they can do more than the drag
    assert of_spin.verdict in dragged.verdicts
    assert not dragged.passed
    assert not any(one.shown for one in dragged.structure if one.channel != "yaw")


@pytest.mark.slow
def test_figures_have_units(dragged):
    written = dragged.to_json()["structure"]
    by_unit = {"yaw": "size_rad_s2", "left": "size_m_s2"}
    for one in written:
        if one["channel"] in by_unit:
            assert one[by_unit[one["channel"]]] >= 0
            assert one["passed"] in (True, False)


def test_samples_are_binned_by_body_speed_one_sample_earlier():
    flight = noisy(duration=2.0, seed=4)
    found, yaw = innovations(TRUTH, flight), 0.5
    world = np.random.default_rng(0).normal(size=(len(flight), 2))
    mean = np.zeros_like(found.mean)
    mean[:, 2, 0], mean[:, :2, 1] = yaw, world
    used = np.ones(len(flight), bool)
    forward, left, *_ = cut(flight, replace(found, mean=mean, used=used))
    body = (world[:, 0] + 1j * world[:, 1]) * np.exp(-1j * yaw)
    for bins, speed in ((forward, body.real), (left, body.imag)):
        speed = np.concatenate([speed[:1], speed[:-1]])
        assert bins.member.shape == (len(flight), BINS)
        assert (bins.member.sum(axis=1) == 1).all()
        assert np.ptp(bins.member.sum(axis=0)) <= 2
        each = [speed[column] for column in bins.member.T]
        assert all(a.max() < b.min() for a, b in pairwise(each))
        np.testing.assert_allclose(bins.middle, [np.median(one) for one in each])


@pytest.mark.parametrize(("share", "counts"), [(0.01, False), (0.5, True)])
def test_a_small_dependence_is_reported_as_small(share, counts):
    places, band = np.array([-1.0, 1.0]), np.full(2, 0.1)
    edges = np.array([-2.0, 0.0, 2.0])
    found = Structure("x", "m", "x", edges, places, 0.2 * places, band, 0.2, share, 1e-6)
    assert found.passed is not counts
    assert ("too little to count" in found.verdict) is not counts
    assert "-0.2 m/s² near -1 m to 0.2 m/s² near 1 m" in found.verdict
