"""The shared regression, against SciPy's integrals and NumPy's least squares."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from airpuck.deviation.motor_regression import normal_equations, solved, twice_integrated
from airpuck.estimate.estimator import HeldCommands

from ..apparatus.examples import examples


@examples(30)
@given(st.integers(0, 10**6))
def test_integrals_are_exact_for_piecewise_linear_accelerations(seed):
    rng = np.random.default_rng(seed)
    duration = rng.uniform(0.003, 0.006, 6)
    values = rng.normal(size=7)
    time = np.insert(np.cumsum(duration), 0, 0.0)
    ours = twice_integrated(values[:, None], duration[:, None])[:, 0]
    # Backwards from rest at the present, piece by piece.
    state, theirs = np.zeros(2), [0.0]
    for k in range(5, -1, -1):
        state = solve_ivp(
            lambda t, y: [y[1], np.interp(t, time, values)],
            (time[k + 1], time[k]),
            state,
            rtol=1e-10,
            atol=1e-14,
        ).y[:, -1]
        theirs.append(state[0])
    np.testing.assert_allclose(ours, theirs[::-1], atol=1e-11)


def test_a_prior_acts_as_a_measurement_of_zero():
    rng = np.random.default_rng(0)
    rows, aim, root = rng.normal(size=(2, 9, 4)), rng.normal(size=(2, 9)), rng.normal(size=(4, 4))
    information, score, square = normal_equations(rows, aim)
    found, covariance = solved(information, score, root.T @ root)
    for k in range(2):
        both, zeros = np.concatenate([rows[k], root]), np.append(aim[k], np.zeros(4))
        np.testing.assert_allclose(found[k], np.linalg.lstsq(both, zeros, rcond=None)[0])
        np.testing.assert_allclose(covariance[k], np.linalg.inv(both.T @ both))
        assert square[k] == np.sum(aim[k] ** 2)


def test_commands_are_held_until_the_next_begins():
    one, two, idle = (np.full(1, value) for value in (1.0, 2.0, 0.0))
    held = HeldCommands(idle)
    held.add(1.0, one)
    held.add(9.0, idle)  # its time was wrong: a later command begins earlier
    held.add(2.0, two)
    assert held.cut(0.5, 2.5) == [(0.5, idle), (1.0, one), (0.5, two)]
    assert held.cut(1.2, 1.5) == [(1.5 - 1.2, one)]
    held.drop(1.5)
    assert [begins for begins, _ in held.until(5.0)] == [1.0, 2.0]
