"""Errors of a model, estimated from made-up innovations."""

import numpy as np
import pytest

from airpuck.deviation.significance import verdicts
from airpuck.evaluation.late_packets import LatePackets
from airpuck.evaluation.residuals import model_errors

MOTORS, PERIOD, SAMPLES = ("a", "b", "c", "d"), 1 / 240, 3000


def innovations(truth, excited=1.0, seed=0, alike=False):
    """White innovations plus the effects of errors of delay, four motors and mass."""
    rng = np.random.default_rng(seed)
    directions = rng.normal(size=(SAMPLES, 3, 6)) * [300.0, 100.0, *[excited] * 4]
    if alike:
        directions[..., 3] = directions[..., 2]
    translation = directions[..., 2:].sum(axis=2) * [1, 1, 0]
    values = rng.normal(size=(SAMPLES, 3)) + directions @ truth[:6] + truth[6] * translation
    nothing = np.zeros((SAMPLES, 3, 0))
    return LatePackets(values, values, directions, nothing, np.full(3, 0.007))


def found(truth, **given):
    return model_errors(MOTORS, innovations(truth, **given), np.ones(SAMPLES, dtype=bool), PERIOD)


def test_all_errors_are_estimated_jointly():
    truth = np.array([0.012, -0.008, -0.2, 0.0, 0.1, 0.02, -0.1])
    errors = found(truth)
    assert [error.name for error in errors] == ["delay", "lag", *MOTORS, "mass"]
    for error, value in zip(errors, truth, strict=True):
        assert error.value == pytest.approx(value, abs=4 * error.standard_error)
    # An error of 2 % of a motor is significant, but does not count.
    assert [e.name for e in errors if not e.passed] == ["delay", "lag", "a", "c", "mass"]
    said = "\n".join(verdicts(errors))
    assert "commands act 12.0 ms" in said and "later than modelled" in said
    assert "\na gives " in said and "less than modelled" in said
    assert "is the model too light?" in said
    assert "is shown of b, d" in said


def test_healthy_craft_are_not_accused():
    accused = 0
    for seed in range(100):
        errors = found(np.zeros(7), excited=0.4, seed=seed)
        assert all(error.tested for error in errors)
        accused += any(not error.passed for error in errors)
    assert accused == 0


def test_motors_that_commands_do_not_reveal_are_not_tested():
    truth = np.array([0.0, 0.0, -0.3, 0.0, 0.0, 0.0, 0.0])
    weakly = found(truth, excited=0.05)
    assert not any(error.tested for error in weakly[2:])
    assert all(error.passed for error in weakly)
    assert "not tested, since the commands do not reveal them: a (± " in verdicts(weakly)[0]
    # For two motors that always run alike, only the sum is known.
    alike = {error.name: error for error in found(truth, alike=True)}
    assert not alike["a"].tested and not alike["b"].tested
    assert alike["c"].tested and alike["d"].tested


def test_an_error_shared_by_all_motors_is_one_finding():
    truth = np.array([0.0, 0.0, -0.15, -0.15, -0.15, -0.15, 0.0])
    (line,) = [line for line in verdicts(found(truth)) if line.startswith("all motors give less")]
    assert float(line.split("modelled, ")[1].split()[0]) == pytest.approx(15, abs=3)
