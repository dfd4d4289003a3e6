"""What a model is judged by."""

from dataclasses import replace

import numpy as np
import pytest

from airpuck.craft.vehicle import default_vehicle
from airpuck.experiment_design.quantities_of_interest import (
    interests,
    relative_errors,
    scales_of,
    values_of,
)
from airpuck.model.model_file import Model, published_model
from airpuck.model.rungs import named_rung
from airpuck.model.uncertainty import Uncertainty


def known(model, covariance, undetermined=()):
    vector = model.parameters.to_vector()
    return Uncertainty(
        vector, covariance, np.sqrt(np.diag(covariance)),
        np.array(undetermined).reshape(-1, len(vector)), 30, 2.0,
    )  # fmt: skip


def at(model, name):
    return np.flatnonzero(model.parameters.mask(frozenset({name})))


def test_values_and_scales_of_the_published_m3_by_hand():
    model = published_model("M3")
    wanted = interests(model)
    value = dict(zip([one.label for one in wanted], values_of(model, wanted), strict=True))
    scale = dict(zip([one.label for one in wanted], scales_of(wanted), strict=True))
    a, b, c = model.parameters.thrust[2]
    assert value["F(1) motor_b_1"] == pytest.approx(a + b + c)
    assert value["F(0.5) motor_b_1"] == pytest.approx(a / 2 + b / 4 + c / 8)
    assert scale["F(0.5) motor_b_1"] == pytest.approx(a + b + c)
    assert value["I"] == scale["I"] == model.parameters.inertia
    assert value["τ"] == scale["τ"] == pytest.approx(28.06e-3, abs=1e-5)
    assert scale["α"] == 1.0
    assert scale["r x"] == pytest.approx(np.sqrt(0.2647e-3 / 0.1377), rel=1e-3)
    assert len(wanted) == 2 * 6 + 5


def test_what_is_not_learned_is_not_judged():
    labels = [one.label for one in interests(published_model("M0"))]
    assert "τ" not in labels
    assert not any(label.startswith("r ") for label in labels)


def test_a_factor_between_thrust_and_matrix_changes_nothing():
    model = published_model("M4")
    factor = np.linspace(0.5, 2, 6)
    p = model.parameters
    other = replace(
        model,
        parameters=replace(
            p,
            thrust=p.thrust * factor[:, None],
            configuration_matrix=p.configuration_matrix / factor,
        ),
    )
    wanted = interests(model)
    assert len(wanted) >= 24
    np.testing.assert_allclose(
        values_of(other, wanted), values_of(model, wanted), rtol=1e-12, atol=1e-15
    )


def test_errors_of_sums_by_hand():
    model = published_model("M3")
    rng = np.random.default_rng(0)
    root = rng.normal(size=(len(model.free), len(model.free))) * 1e-4
    covariance = root @ root.T
    wanted = interests(model)
    errors = relative_errors(replace(model, uncertainty=known(model, covariance)), wanted)
    first = at(model, "thrust")[:3]
    full = model.parameters.thrust[0].sum()
    expected = np.sqrt(covariance[np.ix_(first, first)].sum()) / full
    assert errors[1] == pytest.approx(expected, rel=1e-6)


def test_what_is_not_determined_has_an_infinite_error():
    model = published_model("M3")
    covariance, direction = np.eye(len(model.free)) * 1e-8, np.zeros(len(model.free))
    (inertia,) = at(model, "inertia")
    covariance[inertia], direction[inertia] = 0.0, 1.0
    errors = relative_errors(
        replace(model, uncertainty=known(model, covariance, [direction])), interests(model)
    )
    labels = [one.label for one in interests(model)]
    assert [label for label, error in zip(labels, errors, strict=True) if np.isinf(error)] == ["I"]
    assert np.isinf(relative_errors(model, interests(model))).all()


def test_what_has_no_size_of_its_own_is_told_but_not_judged():
    rung = named_rung("M3+inflow")
    parameters = rung.initial(default_vehicle())
    model = Model(rung.name, default_vehicle(), parameters, rung.mask(parameters))
    covariance = np.eye(len(model.free)) * 1e-8
    wanted = interests(model)
    errors = relative_errors(replace(model, uncertainty=known(model, covariance)), wanted)
    unknown = [one.label for one, error in zip(wanted, errors, strict=True) if np.isnan(error)]
    assert unknown == ["cᵢ"]  # it begins at zero
