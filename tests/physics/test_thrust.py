"""Thrust polynomials and Proposition 1."""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from airpuck import InputError, InverseThrust
from airpuck.physics.thrust import is_monotone, lowest_slope, thrust, thrust_slope

coefficient = st.floats(-2, 2).map(lambda x: round(x, 3))
cubic = st.tuples(coefficient, coefficient, coefficient).map(lambda abc: np.array([abc]))


def proposition(a: float, b: float, c: float) -> bool:
    """prop:thrust of the paper, word for word."""
    ends = a >= 0 and a + 2 * b + 3 * c >= 0
    if c > 0 and 0 <= -b / (3 * c) <= 1:
        return ends and a - b**2 / (3 * c) >= 0
    return ends


def test_thrust_matches_a_hand_calculation():
    curve = np.array([[0.1, 1.0, -0.5]])
    assert thrust(curve, np.array([0.5])) == pytest.approx(0.05 + 0.25 - 0.0625)
    assert thrust_slope(curve, np.array([0.5])) == pytest.approx(0.1 + 1.0 - 0.375)


def test_the_last_axis_is_the_batch():
    curves = np.array([[1.0, 0.0], [0.0, 1.0]])
    speed = np.array([[0.1, 0.2, 0.3], [0.1, 0.2, 0.3]])
    np.testing.assert_allclose(thrust(curves, speed), [[0.1, 0.2, 0.3], [0.01, 0.04, 0.09]])


@given(cubic, st.floats(0, 1))
def test_the_slope_equals_the_derivative(curve, speed):
    step = 1e-6
    ends = [thrust(curve, np.array([speed + s])) for s in (-step, step)]
    np.testing.assert_allclose(
        thrust_slope(curve, np.array([speed])), (ends[1] - ends[0]) / (2 * step), atol=1e-8
    )


@given(cubic)
def test_monotonicity_matches_proposition_1(curve):
    slope, _ = lowest_slope(curve)
    # At the limit itself, rounding decides.
    if abs(slope[0]) > 1e-9:
        assert bool(is_monotone(curve)[0]) == proposition(*curve[0])


@given(st.lists(coefficient, min_size=1, max_size=6))
def test_the_lowest_slope_is_a_minimum(coefficients):
    curve = np.array([coefficients])
    slope, speed = lowest_slope(curve)
    grid = np.linspace(0, 1, 2001)[None]
    assert slope[0] <= thrust_slope(curve, grid).min() + 1e-9
    np.testing.assert_allclose(thrust_slope(curve, speed), slope, atol=1e-9)


@given(
    st.tuples(st.floats(1e-3, 1), st.floats(-1, 2), st.floats(-1, 1)),
    st.lists(st.floats(0, 1), min_size=1),
)
def test_the_inverse_undoes_thrust(abc, speeds):
    curve = np.array([abc])
    assume(lowest_slope(curve)[0][0] > 1e-3)
    speed = np.array([speeds])
    np.testing.assert_allclose(InverseThrust(curve)(thrust(curve, speed)), speed, atol=1e-10)


@pytest.mark.parametrize("curve", [(0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (1e-6, 1.2, -0.7)])
def test_the_inverse_exists_where_the_slope_vanishes(curve):
    # At a slope of zero the speed is ill-defined, but the thrust is still met.
    force = np.linspace(0, float(sum(curve)), 101)[None]
    speed = InverseThrust(np.array([curve]))(force)
    np.testing.assert_allclose(thrust(np.array([curve]), speed), force, atol=1e-14)


def test_the_inverse_is_clipped_at_the_ends_of_its_range():
    curve = np.array([[0.1, 1.0, -0.5]])
    np.testing.assert_array_equal(
        InverseThrust(curve)(np.array([[-1.0, 0.0, 0.6, 9.0]])), [[0, 0, 1, 1]]
    )


def test_a_nan_thrust_gives_a_nan_speed():
    # Half thrust, as a bisection of nothing would give, is a command that flies.
    speed = InverseThrust(np.array([[0.1, 1.0, -0.5]] * 2))(np.array([np.nan, 0.6]))
    np.testing.assert_array_equal(speed, [np.nan, 1.0])


def test_a_falling_curve_has_no_inverse():
    with pytest.raises(InputError, match=r"propeller 2 falls at φ = 1\.000"):
        InverseThrust(np.array([[1.0, 0.0, 0.0], [0.1, 1.6, -1.2]]))
