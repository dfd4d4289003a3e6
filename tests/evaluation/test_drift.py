"""What changed between two models of one craft."""

from dataclasses import replace

import numpy as np
import pytest

from airpuck.boundary.errors import InputError
from airpuck.evaluation.drift import drift
from airpuck.model.model_file import published_model
from airpuck.model.uncertainty import Uncertainty

from ..noisy import TRUTH


def estimated(rng, error=0.02, clusters=40):
    """The truth as an estimate with independent normal errors, and these known."""
    vector = TRUTH.parameters.to_vector()
    deviation = np.where(TRUTH.free, error * np.abs(vector), 0.0)
    estimate = vector + rng.normal(size=len(vector)) * deviation
    known = Uncertainty(
        estimate,
        np.diag(deviation**2),
        np.where(TRUTH.free, deviation, np.nan),
        np.zeros((0, len(vector))),
        clusters,
        2.02,
    )
    parameters = TRUTH.parameters.with_vector(estimate)
    return replace(TRUTH, parameters=parameters, uncertainty=known)


def test_nothing_moves_where_nothing_moved():
    rng = np.random.default_rng(3)
    alarms = [drift(estimated(rng), estimated(rng)).verdicts[0] for _ in range(20)]
    assert sum(not line.startswith("nothing moved") for line in alarms) <= 3  # 5 % of 20


def test_the_arithmetic_by_hand():
    rng = np.random.default_rng(4)
    one, two = estimated(rng), estimated(rng, clusters=20)
    change = next(c for c in drift(one, two).changes if c.label == "I")
    before, after = (1e3 * m.parameters.inertia for m in (one, two))
    joint = np.hypot(1, 1) * 0.02 * 1e3 * TRUTH.parameters.inertia
    assert change.standard_error == pytest.approx(joint, rel=1e-6)
    assert change.z == pytest.approx((after - before) / joint, rel=1e-6)


def test_a_propeller_that_lost_a_tenth_is_named(fits):
    motor = TRUTH.vehicle.propeller_names[2]
    found = drift(fits[0], fits[2])
    assert found.verdicts[0].startswith(f"thrust of {motor} at")
    full = next(c for c in found.changes if c.label == f"F(1) {motor}")
    assert full.moved
    assert f"thrust of {motor} at full speed fell by" in full.verdict
    assert abs(full.after / full.before - 0.9) < 4 * full.standard_error / full.before
    others = {c.words for c in found.changes if c.moved and motor not in c.words}
    assert not others


def test_two_flights_of_one_craft_differ_in_nothing(fits):
    (sentence,) = drift(fits[0], fits[1]).verdicts
    assert sentence.startswith("nothing moved: of 17 quantities")


def test_models_without_errors_or_of_other_crafts_are_refused(fits):
    with pytest.raises(InputError, match="know the error"):
        drift(published_model("M3"), fits[0])


def test_shared_data_and_other_terms_are_noted(fits):
    other = replace(fits[0], name="M2").with_delay(0.03)
    assert other.uncertainty
    known = replace(other.uncertainty, estimate=other.parameters.to_vector())
    other = replace(other, uncertainty=known)
    notes = " ".join(drift(fits[0], other).notes)
    assert "same files" in notes
    assert "different terms" in notes
    assert "30.0 ms" in notes
