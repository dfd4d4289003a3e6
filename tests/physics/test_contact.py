"""The law of contact, against its own definition in plain and in array form."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from airpuck.physics.puck import PlainNumbers, contact_impulse, mobility

speeds = st.floats(-5, 5)
share = st.floats(0, 1)
arms = st.floats(-0.1, 0.1)
MASS, INERTIA = 0.14, 3e-4


@given(speeds, speeds, share, st.floats(0, 2), share, arms, arms)
def test_plain_numbers_and_arrays_agree(normal, slip, restitution, friction, grip, arm_n, arm_t):
    k = mobility(MASS, INERTIA, arm_n, arm_t)
    arrays = mobility(MASS, INERTIA, np.array([arm_n]), np.array([arm_t]))
    law = (restitution, friction, grip)
    plain = contact_impulse(PlainNumbers, k, normal, slip, *law)
    array = contact_impulse(np, arrays, np.array([normal]), np.array([slip]), *law)
    np.testing.assert_array_equal(plain, np.ravel(array))


@given(st.floats(-5, -0.01), speeds, share, st.floats(0, 2), share, arms)
def test_a_contact_at_the_middle_gives_back_pushes_and_keeps_to_the_cone(
    normal, slip, restitution, friction, grip, arm_n
):
    k = mobility(MASS, INERTIA, arm_n, 0.0)
    n, t = contact_impulse(PlainNumbers, k, normal, slip, restitution, friction, grip)
    assert normal + k[0] * n == pytest.approx(-restitution * normal, abs=1e-12)
    assert n > 0
    assert abs(t) <= friction * n + 1e-15
    after = slip + k[1] * t
    assert abs(after) <= abs(slip) + 1e-12
    if abs(t) < friction * n * (1 - 1e-9):
        assert after == pytest.approx((1 - grip) * slip, abs=1e-12)


@given(st.floats(-5, 0), speeds, share, st.floats(0, 2), share, arms, arms)
def test_no_contact_gives_energy(normal, slip, restitution, friction, grip, arm_n, arm_t):
    k_nn, k_tt, k_nt = k = mobility(MASS, INERTIA, arm_n, arm_t)
    n, t = contact_impulse(PlainNumbers, k, normal, slip, restitution, friction, grip)
    work = n * (normal + (k_nn * n + k_nt * t) / 2) + t * (slip + (k_nt * n + k_tt * t) / 2)
    assert work <= 1e-12
