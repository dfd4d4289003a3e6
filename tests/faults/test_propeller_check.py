"""Verdicts on propellers whose effects are given."""

import numpy as np
import pytest

from airpuck.faults.propeller_check import (
    DEAD,
    UNCLEAR,
    force_to_moment,
    judge_propellers,
    match_effects,
    may_agree,
)

#: Forward, left and turn: four propellers, two along each axis, that turn the craft in pairs.
STATED = np.array([[1.0, -1, 0, 0], [0, 0, 1, -1], [0.5, -0.5, -0.5, 0.5]])
NAMES = ("front", "back", "left", "right")


def judged(shares, errors, inertia=1.0):
    """Judge propellers that give these shares of their stated effects, known to these errors."""
    measured, error = STATED * shares, np.ones((3, 1)) * errors * np.linalg.norm(STATED, axis=0)
    given = NAMES, np.ones(4, dtype=bool), (0.0, inertia)
    return judge_propellers(measured, error, STATED, *given)


@pytest.mark.parametrize(
    ("share", "error", "verdict"),
    [
        # Half of the usual effect, or nearly nothing, known well.
        (0.1, 0.001, "agrees"),
        (0.01, 0.001, DEAD),
        # 2.6 errors are 0.45 and 0.25 of the usual 0.2: 0.2 ± 0.45 may be half, 0.2 ± 0.25 may not.
        (0.04, 0.45 * 0.2 / 2.6, UNCLEAR),
        (0.04, 0.25 * 0.2 / 2.6, DEAD),
        # 0.2 ± 0.04 is not nothing.
        (0.04, 0.04 * 0.2 / 2.6, "agrees"),
    ],
)
def test_dead_means_possibly_zero_and_certainly_below_half(share, error, verdict):
    *others, last = judged([0.2, 0.2, 0.2, share], [0.001, 0.001, 0.001, error])
    assert [one.verdict for one in others] == ["agrees"] * 3
    assert last.verdict == verdict


def test_strength_is_the_force_along_the_stated_direction():
    found = judged([0.5, 1.0, 1.0, 2.0], 0.01)
    np.testing.assert_allclose([one.strength for one in found], [0.5, 1.0, 1.0, 2.0])
    # A force of 1 known to 0.01 √1.25; moments do not count.
    errors = [one.strength_error for one in found]
    np.testing.assert_allclose(errors, 0.01 * np.sqrt(1.25))


def test_noise_does_not_count_as_force_or_moment():
    """Squares by hand: forces 9 - 1, moments 1; 1 if a square is at most four times its noise."""
    stated, measured = np.array([[1.0], [0.0], [1.0]]), np.array([[2.0], [0.0], [1.0]])
    error = np.array([[0.6], [0.8], [0.0]])
    assert force_to_moment(measured, error, stated) == 1
    measured[0] = 3.0
    assert force_to_moment(measured, error, stated) == pytest.approx(np.sqrt(8))
    assert force_to_moment(measured, error, stated * [[1], [1], [0]]) == 1


def test_an_uncertain_effect_may_have_the_stated_direction():
    """26 degrees are allowed: 0.6 across for 1 along is too much unless 2.6 errors bridge it."""
    along, across = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.6, 0.0])
    excess = 0.6 - np.tan(np.arccos(0.9))
    for share, agrees in ((0.9, False), (1.1, True)):
        error = np.full(3, share * excess / 2.6)
        assert may_agree(along + across, error, along) == agrees
    assert not may_agree(-along, np.full(3, 0.01), along)


def test_a_swapped_cable_is_preferred_to_two_reversed_propellers():
    """Opposed propellers: each one's reversed effect is the other's effect."""
    found = match_effects(
        STATED[:, [1, 0, 2, 3]] * [[1], [1], [0]], STATED * [[1], [1], [0]], np.arange(4)
    )
    assert [(found[k].acts_as, found[k].sign) for k in range(4)] == [(1, 1), (0, 1), (2, 1), (3, 1)]
