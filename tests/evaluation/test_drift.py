"""Changes between two models of one craft."""

import pickle
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import ttest_ind_from_stats

from airpuck.boundary.errors import InputError
from airpuck.evaluation.drift import Change, drift
from airpuck.evaluation.presentation import MainQuantity
from airpuck.model.model_file import published_model
from airpuck.model.quantities import EFFECTS

from ..apparatus.beliefs import believed
from ..apparatus.noisy_flights import TRUTH


def estimated(rng, error=0.02, clusters=40):
    """The truth plus independent normal errors of known size, as an estimate."""
    vector = TRUTH.parameters.to_vector()
    deviation = np.where(TRUTH.free, error * np.abs(vector), 0.0)
    estimate = vector + rng.normal(size=len(vector)) * deviation
    model = replace(TRUTH, parameters=TRUTH.parameters.with_vector(estimate))
    return believed(model, deviation, clusters=clusters)


@pytest.mark.slow
def test_models_of_an_unchanged_craft_show_no_drift():
    rng = np.random.default_rng(3)
    alarms = [drift(estimated(rng), estimated(rng)).verdicts[0] for _ in range(10)]
    assert sum(not line.startswith("nothing moved") for line in alarms) <= 2  # 5 % of 10


def test_drift_matches_a_hand_calculation():
    rng = np.random.default_rng(4)
    one, two = estimated(rng), estimated(rng, clusters=20)
    found = pickle.loads(pickle.dumps(drift(one, two)))  # as to workers and back
    change = next(c for c in found.changes if c.quantity.label == "I")
    before, after = (1e3 * m.parameters.inertia for m in (one, two))
    joint = np.hypot(1, 1) * 0.02 * 1e3 * TRUTH.parameters.inertia
    assert change.standard_error == pytest.approx(joint, rel=1e-6)
    assert change.z == pytest.approx((after - before) / joint, rel=1e-6)


def test_probabilities_match_welchs_test():
    """A fit's standard error equals the error of a mean over its blocks."""
    rng = np.random.default_rng(2)
    found = drift(estimated(rng, clusters=12), estimated(rng, clusters=8)).changes
    most = max(found, key=lambda change: abs(change.z))
    error = most.standard_error / np.sqrt(2)  # both fits have the same
    spread = {"std1": error * np.sqrt(12), "std2": error * np.sqrt(8)}
    welch = ttest_ind_from_stats(
        most.before, nobs1=12, mean2=most.after, nobs2=8, equal_var=False, **spread
    )
    # The smallest of many p-values is adjusted for their number.
    assert most.p_value == pytest.approx(min(1.0, len(found) * welch.pvalue), rel=1e-6)
    assert most.p_value < 1


@pytest.mark.parametrize(
    ("before", "parameter", "says"),
    [
        (4.0, "inertia", "I rose by 25.0 % ± 5.0 % (z = 5.0)"),
        # Quantities that may be negative have no percentage.
        (4.0, "tilt", "I rose by 1 ± 0.2 mm (z = 5.0)"),
        (0.0, "inertia", "I rose by 1 ± 0.2 mm (z = 5.0)"),
        (-4.0, "inertia", "I rose by 1 ± 0.2 mm (z = 5.0)"),
    ],
)
def test_a_change_is_a_percentage_only_for_positive_quantities(before, parameter, says):
    quantity = MainQuantity("I", "I", "mm", parameter, 0, ".4g", lambda _: before)
    change = Change(quantity, before, before + 1.0, 0.2, 5.0, 0.001)
    assert change.verdict == says


@pytest.mark.slow
def test_a_propeller_that_lost_a_tenth_is_named(fits):
    motor = TRUTH.vehicle.propeller_names[2]
    found = drift(fits[0], fits[2])
    assert found.verdicts[0].startswith(f"thrust of {motor} at")
    full = next(c for c in found.changes if c.quantity.label == f"F(1) {motor}")
    assert full.moved
    assert f"thrust of {motor} at full speed fell by" in full.verdict
    assert abs(full.after / full.before - 0.9) < 4 * full.standard_error / full.before
    others = {w for c in found.changes if c.moved and motor not in (w := c.quantity.words)}
    assert not others


@pytest.mark.slow
def test_two_flights_of_one_craft_show_no_difference(fits):
    (sentence,) = drift(fits[0], fits[1]).verdicts
    assert sentence.startswith("nothing moved: of 17 quantities")


@pytest.mark.slow
def test_models_without_errors_or_of_different_craft_are_rejected(fits):
    with pytest.raises(InputError, match="known errors"):
        drift(published_model("M3"), fits[0])


@pytest.mark.slow
def test_shared_data_and_other_terms_are_noted(fits):
    other = replace(fits[0], name="M2").with_delay(0.03)
    assert other.uncertainty
    known = replace(other.uncertainty, estimate=other.parameters.to_vector())
    other = replace(other, uncertainty=known)
    notes = " ".join(drift(fits[0], other).notes)
    assert "same files" in notes
    assert "different terms" in notes
    assert "30.0 ms" in notes


def timed(lag: float, delay: float):
    """The truth with this lag and delay [s], learned and known to 0.1 ms; a lag of zero is held."""
    free = TRUTH.free | TRUTH.parameters.mask(frozenset({"transport_delay"}))
    parameters = replace(TRUTH.parameters, motor_time_constant=lag, transport_delay=delay)
    vector = parameters.to_vector()
    spread = np.where(free, 0.02 * np.abs(vector), 0.0)
    for name in ("motor_time_constant", "transport_delay"):
        spread[parameters.mask(frozenset({name}))] = 1e-4
    spread[parameters.mask(frozenset({"motor_time_constant"}))] *= lag > 0
    covariance = np.diag(spread**2)
    # As after a fit: the errors of lag and delay are opposite.
    (one,), (other,) = (
        np.flatnonzero(parameters.mask(frozenset({name})))
        for name in ("motor_time_constant", "transport_delay")
    )
    covariance[one, other] = covariance[other, one] = -0.96 * spread[one] * spread[other]
    return believed(replace(TRUTH, parameters=parameters, free=free), covariance, clusters=40)


@pytest.mark.slow
def test_a_delay_that_absorbed_a_fixed_lag_is_not_reported():
    found = drift(timed(0.0, 0.040), timed(0.030, 0.015))
    change = next(c for c in found.changes if c.quantity.label == "d")
    # By hand: 25 ms, known to √2 · 0.1 ms.
    assert change.z == pytest.approx(-25 / (0.1 * np.sqrt(2)), rel=1e-3)
    assert change.held and not change.moved
    assert found.verdicts[0].startswith("nothing moved: of 16 quantities")
    (note,) = found.notes
    assert "not judged: transport delay (z = -176.8)" in note
    # If no constraint fixes it, the same difference counts as a change.
    assert "transport delay" in drift(timed(0.030, 0.040), timed(0.030, 0.015)).verdicts[0]


def test_a_curve_held_by_its_constraint_is_not_reported():
    flat = np.array(TRUTH.parameters.thrust)
    flat[2] = [1e-6, 0.3, 0.3]
    later = replace(TRUTH, parameters=replace(TRUTH.parameters, thrust=flat))
    found = drift(timed(0.03, 0.015), believed(later, 1e-4 * TRUTH.free, clusters=40))
    motor = TRUTH.vehicle.propeller_names[2]
    held = [change.quantity.words for change in found.changes if change.held]
    assert held == [f"thrust of {motor} at φ = 0.5", f"thrust of {motor} at full speed"]
    assert not any(words in sentence for words in held for sentence in found.verdicts)


def of_effect(name: str, at_bound: bool, inertia: float, correlation: float):
    """The truth that learned inertia, to 1 %, and the first entry of an effect, or its bound."""
    value = np.ravel(EFFECTS[name].start) + 0.5
    value[0] = EFFECTS[name].bounds[0] if at_bound else 0.5
    effect = value if len(value) > 1 else float(value[0])
    parameters = replace(TRUTH.parameters, inertia=inertia, **{name: effect})
    vector = parameters.to_vector()
    learned = [np.flatnonzero(parameters.mask(frozenset({n})))[0] for n in ("inertia", name)]
    spread = np.array([0.01 * inertia, 0.0 if at_bound else 0.01])
    covariance = np.zeros((len(vector), len(vector)))
    shape = np.array([[1.0, correlation], [correlation, 1.0]])
    covariance[np.ix_(learned, learned)] = shape * np.outer(spread, spread)
    free = np.isin(np.arange(len(vector)), learned)
    return believed(replace(TRUTH, parameters=parameters, free=free), covariance, clusters=40)


@pytest.mark.parametrize("name", ["drag", "inflow", "pair_interaction", "voltage_sag", "idle_lag"])
@pytest.mark.parametrize("correlation", [-0.9, 0.9, 0.1])
def test_a_quantity_correlated_with_a_bounded_effect_is_not_reported(name, correlation):
    """√(1 − 0.9²): beside a held effect the error of inertia is too small by more than half."""
    held, found = of_effect(name, True, 3e-4, 0.0), of_effect(name, False, 4e-4, correlation)
    for models in ((held, found), (found, held)):
        (change,) = (c for c in drift(*models).changes if c.quantity.label == "I")
        assert change.differs
        assert change.held == (abs(correlation) > 0.5)
    # Held in both: they are compared under the same condition.
    (change,) = drift(held, of_effect(name, True, 4e-4, 0.0)).changes
    assert change.moved
