"""The structure of a model: what the recordings show, and errors that say what it cannot."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import airpuck
from airpuck.identification import structure
from airpuck.identification.fit_result import Fit
from airpuck.identification.missing_terms import MissingTerm
from airpuck.identification.objective import PredictionLoss
from airpuck.model.model_file import published_model
from airpuck.model.uncertainty import Uncertainty

from ..apparatus.synthetic_flights import fly

VEHICLE = published_model("M3").vehicle
#: Commands at which thrusts are compared.
SPEEDS = np.array([0.25, 0.5, 0.75, 1.0])


def model_of(rung) -> airpuck.Model:
    """Return a model of a rung, whose errors are 1 % of what is free."""
    parameters = rung.initial(VEHICLE)
    vector, free = parameters.to_vector(), parameters.mask(rung.free)
    spread = 0.01 * free
    known = Uncertainty(vector, np.diag(spread**2), spread, np.zeros((0, len(vector))), 40, 2.0)
    return replace(
        published_model("M3"), name=rung.name, parameters=parameters, free=free, uncertainty=known
    )


@pytest.mark.parametrize(
    ("terms", "name", "degree"),
    [(("drag", "degree"), "M3+drag", 4), (("drag",), "M3+drag", 3), ((), "M3", 3)],
)
def test_missing_terms_join_the_rung_and_a_bend_raises_its_degree(monkeypatch, terms, name, degree):
    loss = object.__new__(PredictionLoss)
    rounds = [[*terms], []]

    def missing(model, _):
        direction = np.zeros(len(model.free))
        return [MissingTerm(t, 1e-9, 0.3, 0.3, (1.0,), direction) for t in rounds.pop(0)]

    fits = SimpleNamespace(
        solved=lambda _, rung, **__: SimpleNamespace(result=(loss, None, model_of(rung))),
        judge=lambda solution: Fit(
            solution.result[2], 1.0, (), True, "", 1, 0.0, (), objective=loss
        ),
    )
    monkeypatch.setattr(structure, "fitting", fits)
    monkeypatch.setattr(structure, "missing_terms", missing)
    monkeypatch.setattr(structure, "unseen_level", lambda model, _: np.zeros(len(model.free)))
    fit, found = structure.structured(fly(published_model("M3"), 1.0))
    assert (found.base, found.chosen, fit.model.name) == ("M3", name, name)
    assert np.shape(fit.model.parameters.thrust)[1] == degree
    # Curves of another shape may do anything at speeds that the data lack.
    assert fit.model.known is not None
    told = any("at the slowest commands" in note for note in fit.model.known.notes)
    assert told == ("degree" in terms)


@pytest.mark.slow
def test_thrust_errors_include_the_weakly_observable_common_offset():
    """Curves like square roots: all forces that balance each other are off by one constant."""
    truth = replace(published_model("M3"), frame="body", indexing="start")
    v, powers = np.linspace(0.0, 1.0, 201), np.arange(1, 10)
    shape = np.linalg.lstsq(v[:, None] ** powers, np.sqrt(v + 0.01) - 0.1, rcond=None)[0]
    curves = 0.6 * np.ones((6, 1)) * shape
    truth = replace(truth, parameters=replace(truth.parameters, thrust=curves))
    found = airpuck.study(fly(truth, duration=24.0)).model

    def thrusts(model: airpuck.Model) -> np.ndarray:
        coefficients = np.asarray(model.parameters.thrust)
        return coefficients @ SPEEDS ** np.arange(1, coefficients.shape[1] + 1)[:, None]

    off = thrusts(found) - thrusts(truth)
    error = np.array(
        [
            [float(found.standard_error(lambda m, i=i, k=k: thrusts(m)[i, k])) for k in range(4)]
            for i in range(6)
        ]
    )
    # Six to ten times as large as by chance.
    assert np.mean(off) < -0.01 and np.std(off) < 0.5 * abs(np.mean(off))
    assert np.all(np.abs(off) < 2.5 * error)
    assert np.median(error) < 0.06 * 0.6
