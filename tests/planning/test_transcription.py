"""Paths between nodes, and the derivatives that the solver gets."""

import numpy as np
import pytest

import airpuck
from airpuck.planning.transcription import Path, Transcription


def test_a_path_with_several_legs_is_resampled_per_leg():
    durations, states = np.array([0.4, 1.0]), np.zeros((5, 12))
    states[:, 0] = [0.0, 0.2, 0.4, 0.9, 1.4]  # as the time passes
    commands = np.repeat(np.arange(4.0)[:, None], 6, axis=1)
    path = Path(durations, states, commands)
    np.testing.assert_allclose(path.times, states[:, 0])
    for intervals in (4, 10):
        finer = path.resampled(intervals)
        assert len(finer.commands) == 2 * intervals
        np.testing.assert_allclose(finer.times, finer.states[:, 0])
        np.testing.assert_allclose(finer.times[[0, intervals, -1]], [0.0, 0.4, 1.4])
        np.testing.assert_array_equal(finer.commands[:: intervals // 2, 0], range(4))
    assert path.resampled(2) is path


def test_the_solver_gets_the_same_derivatives_as_casadi_computes():
    pytest.importorskip("casadi")
    model = airpuck.read_model("paper:M3")
    solver = Transcription(model, intervals=3, legs=2, discs=1).solver
    names, lagrangian = ["x", "p", "lam:f", "lam:g"], {"gamma": ["f", "g"]}
    rng = np.random.default_rng(0)
    itself = solver.oracle()
    point = [rng.uniform(0.2, 0.8, itself.size1_in(k)) for k in (0, 1)]
    multipliers = [0.7, rng.normal(size=itself.size1_out(1))]
    slopes = itself.factory("slopes", names[:2], ["jac:g:x"])
    np.testing.assert_allclose(
        solver.get_function("nlp_jac_g")(*point)[1].full(), slopes(*point).full(), atol=1e-12
    )
    curves = itself.factory("curves", names, ["triu:hess:gamma:x:x"], lagrangian)
    given = solver.get_function("nlp_hess_l")(*point, *multipliers).full()
    np.testing.assert_allclose(given, curves(*point, *multipliers).full(), atol=1e-10)
    assert np.abs(given).max() > 1
