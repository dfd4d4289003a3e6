"""Rising thrust: the paper's penalty and the cutting planes."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from airpuck.identification.monotone import SlopeConstraints, monotone_penalty
from airpuck.physics.thrust import lowest_slope, thrust_slope

coefficient = st.floats(-2, 2).map(lambda x: round(x, 3))


@given(st.tuples(coefficient, coefficient, coefficient))
def test_penalty_is_the_papers(abc):
    a, b, c = abc
    expected = max(0, -a) + max(0, -a - 2 * b - 3 * c)
    if c > 0 and 0 <= -b / (3 * c) <= 1:
        expected += max(0, b**2 / (3 * c) - a)
    assert monotone_penalty(np, np.array([abc])) == pytest.approx(expected, abs=1e-9)


@given(st.lists(coefficient, min_size=1, max_size=5))
def test_penalty_vanishes_exactly_where_the_curve_rises(coefficients):
    curve = np.array([coefficients])
    slope, _ = lowest_slope(curve)
    # Between the points of the grid for high degrees, a slope can dip a little.
    if abs(slope[0]) > 1e-2:
        assert (monotone_penalty(np, curve) == 0) == (slope[0] > 0)


def test_penalty_has_finite_gradients_for_cubics_without_a_cubic_term():
    gradient = jax.grad(lambda c: monotone_penalty(jnp, c))(jnp.array([[-0.1, 1.0, 0.0]]))
    assert np.isfinite(gradient).all()


def test_rows_are_slopes():
    constraints = SlopeConstraints(np.ones((2, 3), dtype=bool))
    curves = np.random.default_rng(0).normal(size=(2, 3))
    ends = np.tile([0.0, 1.0], (2, 1))
    np.testing.assert_allclose(
        constraints.rows() @ curves.ravel(), thrust_slope(curves, ends).ravel()
    )


def test_a_cut_is_made_where_the_curve_falls_most():
    constraints = SlopeConstraints(np.ones((1, 3), dtype=bool))
    falling = np.array([[0.2, -1.0, 1.0]])  # F' = 0.2 - 2φ + 3φ² is lowest at φ = 1/3
    assert constraints.cut(falling)
    np.testing.assert_allclose(constraints.rows()[-1], [1, 2 / 3, 1 / 3], atol=1e-12)
    assert not constraints.cut(np.array([[0.5, 0.5, 0.5]]))


def test_a_slope_that_nothing_can_change_is_not_constrained():
    only_quadratic = np.array([[False, True]])
    rows = SlopeConstraints(only_quadratic).rows()
    np.testing.assert_array_equal(rows, [[1, 2]])
