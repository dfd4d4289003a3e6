"""Score tests of terms that a model lacks."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from airpuck.craft.vehicle import read_vehicle
from airpuck.identification.fit import identify
from airpuck.identification.missing_terms import (
    MissingTerm,
    missing_terms,
    unseen_level,
    with_shifts,
)
from airpuck.identification.objective import PredictionLoss, Quadratic
from airpuck.model.model_file import nominal_model, published_model
from airpuck.model.rungs import named_rung

from ..apparatus.beliefs import believed
from ..apparatus.synthetic_flights import fly


@pytest.mark.slow
@pytest.mark.parametrize("interaction", [None, 1.0])
def test_pair_interaction_is_detected_although_both_motors_lose_equally(interaction):
    truth = replace(published_model("M3"), frame="body")
    truth = replace(truth, parameters=replace(truth.parameters, pair_interaction=interaction))
    fit = identify(fly(truth, duration=20.0))
    found = {one.term: one for one in missing_terms(fit.model, fit.objective)}
    assert ("pair" in found) == (interaction is not None)
    if interaction is not None:
        assert found["pair"].value[0] == pytest.approx(interaction, rel=0.5)


@pytest.mark.slow
def test_a_few_seconds_reveal_a_missing_term():
    """The usual blocks of time would be too few to tell."""
    truth = replace(published_model("M3"), frame="body")
    braked = replace(truth.parameters, drag=np.array([0.5, 0.0, 0.5, 0.0]))
    for parameters, terms in ((braked, {"drag"}), (truth.parameters, set())):
        flight = fly(replace(truth, parameters=parameters), duration=7.0)
        fit = identify(flight, "M3")
        found = {one.term for one in missing_terms(fit.model, fit.objective) if one.worthwhile}
        assert found == terms


MODEL = replace(published_model("M3"), frame="body", indexing="start")
OWN = MODEL.parameters.labels(MODEL.vehicle.propeller_names)


class LinearLoss(PredictionLoss):
    """Noise that is linear in all parameters, in blocks of time, at the optimum of the model's own.

    `missing` are coefficients of other parameters, by label; `like` makes one column resemble
    another; `only` is the one block in which anything is missing.
    """

    clusters = np.arange(40)
    model = MODEL
    windows = cast(Any, SimpleNamespace(trajectories=[None, None]))
    __setattr__ = object.__setattr__

    def __init__(
        self,
        missing: dict[str, float],
        seed: int = 0,
        like: tuple[str, str] | None = None,
        only: int | None = None,
    ) -> None:
        self.missing, self.like, self.only = missing, like, only
        self.rng = np.random.default_rng(seed)

    def quadratic(self, parameters: Any, **_: Any) -> Quadratic:
        """Draw design and data."""
        blocks, rows = 40, 30
        names, free = self.model.vehicle.propeller_names, self.model.free
        self.labels = parameters.labels(names)
        design = self.rng.normal(size=(blocks, rows, len(self.labels)))
        at = self.labels.index
        if self.like is not None:
            design[..., at(self.like[0])] *= 0.3
            design[..., at(self.like[0])] += design[..., at(self.like[1])]
        values = self.rng.normal(size=(blocks, rows))
        for label, value in self.missing.items():
            if label not in self.labels:
                continue
            where = slice(None) if self.only is None else self.only
            values[where] += value * design[where][..., at(label)]
        self.design, own = (
            design.reshape(-1, len(self.labels)),
            map(at, self.model.parameters.labels(names)),
        )
        self.own = [k for k, learned in zip(own, free, strict=True) if learned]
        self.values = values.ravel() - self.fitted(self.own, values.ravel())[1]
        left, scale = self.values.reshape(blocks, rows), 2 / self.values.size
        return Quadratic(
            np.sum(left**2, axis=1) * scale / 2,
            -scale * np.einsum("grq,gr->gq", design, left),
            scale * np.einsum("grq,grp->gqp", design, design),
        )

    def fitted(self, columns: list[int], values: Any) -> tuple[Any, Any]:
        """Fit columns by least squares; return coefficients and fitted values."""
        found = np.linalg.lstsq(self.design[:, columns], values, rcond=None)[0]
        return found, self.design[:, columns] @ found

    def with_term(self, labels: list[str]) -> tuple[Any, Any, float]:
        """Fit with more columns: their coefficients, those of the model, and the relative gain."""
        columns = [*self.own, *map(self.labels.index, labels)]
        found, fitted = self.fitted(columns, self.values)
        left = np.sum((self.values - fitted) ** 2) / np.sum(self.values**2)
        return found[len(self.own) :], found[: len(self.own)], 1 - left


def told(loss: LinearLoss) -> dict[str, MissingTerm]:
    return {one.term: one for one in missing_terms(loss.model, cast(Any, loss))}


def test_a_missing_terms_value_is_predicted_as_least_squares_would_find_it():
    labels = ["tilt x", "tilt y"]
    loss = LinearLoss({"tilt x": 0.3, "tilt y": -0.2})
    (found,) = told(loss).values()
    value, own, gain = loss.with_term(labels)
    assert found.term == "tilt" and found.worthwhile
    np.testing.assert_allclose(found.value, value, rtol=1e-8)
    np.testing.assert_allclose(found.direction[MODEL.free], own, atol=1e-10)
    assert found.gain == pytest.approx(gain, rel=1e-8)
    assert 0.7 * gain < found.held_out < gain


def test_a_term_already_in_the_model_is_not_missing():
    drag = replace(MODEL.parameters, drag=np.array([0.5, 0.0, 0.5, 0.0]))
    loss = LinearLoss({"tilt x": 0.3})
    loss.model = replace(MODEL, parameters=drag, free=drag.mask(named_rung("M3+drag").free))
    assert list(told(loss)) == ["tilt"]


def test_on_off_thrusters_have_no_curve_to_bend():
    file = Path(__file__).parents[2] / "examples" / "free_flyers" / "atmos.toml"
    model = nominal_model(read_vehicle(file))
    model = replace(model, free=model.parameters.mask(frozenset({"thrust", "inertia"})))
    labels = model.parameters.labels(model.vehicle.propeller_names)
    loss = LinearLoss({one.replace("φ^1", "φ^2"): 0.5 for one in labels if "φ^1" in one})
    loss.model = model
    assert "degree" not in told(loss)


@pytest.mark.slow
def test_chance_is_rarely_reported_as_a_missing_term():
    """Eleven terms in forty flights: 0.2 false ones are expected."""
    assert sum(len(told(LinearLoss({}, seed))) for seed in range(40)) <= 2


def test_an_effect_in_one_block_of_time_is_not_a_missing_term():
    assert "inflow" in told(LinearLoss({"inflow": 0.4}))
    assert "inflow" not in told(LinearLoss({"inflow": 4.0}, only=7))


@pytest.mark.parametrize("seed", range(3))
def test_a_term_that_resembles_the_missing_one_is_not_reported(seed):
    loss = LinearLoss({"inflow": 0.4}, seed, like=("tilt x", "inflow"))
    assert list(told(loss)) == ["inflow"]


def test_an_impossible_coefficient_stays_at_zero():
    """Friction cannot push."""
    first, second = labels = [one for one in friction_labels() if "friction" in one]
    found = told(LinearLoss({first: -0.5, second: 0.4}))["friction"]
    assert len(labels) == 2 and len(found.value) == 1
    assert found.value[0] == pytest.approx(0.4, abs=0.1)
    assert "friction" not in told(LinearLoss({first: -0.5, second: -0.4}))


def friction_labels() -> list[str]:
    loss = LinearLoss({})
    told(loss)
    return loss.labels


@pytest.mark.parametrize(
    ("term", "held_out", "expected"),
    [("drag", 0.3, True), ("drag", 0.0, False), ("change of inertia", 0.3, False)],
)
def test_a_term_is_added_if_it_predicts_better_and_is_not_a_change(term, held_out, expected):
    found = MissingTerm(term, 1e-9, 0.3, held_out, (1.0,), np.zeros(len(OWN)))
    assert found.worthwhile == expected


@pytest.mark.parametrize("size", [1e-4, 1e9])
def test_shifts_stay_linear_however_far_a_term_moves_a_parameter(size):
    direction = size * MODEL.parameters.mask(frozenset({"motor_time_constant"}))
    term = MissingTerm("drag", 1e-9, 0.1, 0.1, (1.0,), -direction)
    (found,) = with_shifts(MODEL, [term])
    assert found.shift["τ"] == pytest.approx(-1e3 * size, rel=1e-6)  # stated in ms
    assert found.shift["I"] == 0


def test_the_quantity_that_a_term_shifts_most_is_named_if_errors_are_known():
    vector, mask = MODEL.parameters.to_vector(), MODEL.parameters.mask
    spread = 0.01 * np.abs(vector) * MODEL.free
    # Two standard errors of the lag, one of the inertia.
    direction = spread * (
        2.0 * mask(frozenset({"motor_time_constant"})) + mask(frozenset({"inertia"}))
    )
    term = MissingTerm("drag", 1e-9, 0.1, 0.1, (1.0,), direction)
    (found,) = with_shifts(believed(MODEL, spread), [term])
    assert (found.largest, found.unit) == ("τ", "ms")
    assert found.standard_errors == pytest.approx(2.0)
    (unknown,) = with_shifts(MODEL, [term])
    assert (unknown.largest, unknown.unit) == ("", "")


def test_an_unobservable_thrust_offset_produces_no_force_or_moment():
    slowest = np.array([0.1, 0.2, 0.3, 0.4, 0.5, 0.6])
    loss = LinearLoss({})
    # A tenth of the samples is slower.
    loss.windows = cast(Any, SimpleNamespace(input=np.linspace(slowest, 1.0, 1000)))
    found = unseen_level(MODEL, loss)
    curves = found[MODEL.parameters.mask(frozenset({"thrust"}))].reshape(6, 3)
    assert np.count_nonzero(found) == np.count_nonzero(curves) == 18
    speeds = np.linspace(0.0, 1.0, 101)
    added = curves @ speeds ** np.array([[1], [2], [3]])
    felt = np.asarray(MODEL.dynamics.configuration) @ added
    assert np.abs(felt).max() < 1e-9 * np.abs(added).max()
    # It is a level from the slowest speed of any motor on.
    level = added[:, speeds > 0.2]
    assert (np.ptp(level, axis=1) < 0.3 * np.abs(level).max(axis=1)).all()


def test_a_higher_degree_is_absorbed_by_the_closest_lower_curve():
    """The shift is that of the thrusts, not of coefficients that cancel each other."""
    labels = [one.replace("φ^3", "φ^4") for one in OWN if "φ^3" in one]
    loss = LinearLoss(dict.fromkeys(labels, 0.3))
    predicted = told(loss)["degree"].direction
    value, own, _ = loss.with_term(labels)
    fitted, speeds = np.zeros(len(OWN)), np.linspace(0.0, 1.0, 11)
    fitted[MODEL.free] = own
    for label, added in zip(labels, value, strict=True):
        rows = [OWN.index(label.replace("φ^4", f"φ^{power}")) for power in (1, 2, 3)]
        powers = speeds[:, None] ** np.array([1, 2, 3])
        whole = powers @ fitted[rows] + added * speeds**4
        np.testing.assert_allclose(powers @ predicted[rows], whole, atol=0.02 * abs(added))


def test_a_bend_common_to_all_curves_is_detected_more_often_than_mixed_bends():
    labels = [one.replace("φ^3", "φ^4") for one in OWN if "φ^3" in one]
    full = np.sum(np.asarray(MODEL.parameters.thrust), axis=1)
    alike = 0.06 * full / full.mean()
    mixed = alike * np.tile([1.0, -1.0], 3)

    def told_of(seed: int, bends: Any) -> bool:
        return "degree" in told(LinearLoss(dict(zip(labels, bends, strict=True)), seed))

    # As strong, but half of the curves bend the other way.
    found = [sum(told_of(seed, bends) for seed in range(12)) for bends in (alike, mixed)]
    assert found[0] >= found[1] + 4
