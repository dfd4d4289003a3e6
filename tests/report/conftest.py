"""Studies to draw: of two made-up craft, and the paper's."""

import pytest

from airpuck.data.trajectory import Span
from airpuck.evaluation.evaluate import compare
from airpuck.report.evaluation_report import JudgedModels
from airpuck.report.fit_report import FitStudy
from airpuck.report.reproduce import Reproduction, reproduce

from ..apparatus.models import VEHICLES, fit_of, model_of
from ..apparatus.once import once
from ..apparatus.synthetic_flights import fly

RUNGS = ("M0", "M1", "M2", "M3", "M4")


@once
def study_of(name: str) -> FitStudy:
    vehicle = VEHICLES[name]()
    training = fly(model_of(vehicle, "M3"), 8.0, seed=1)
    models = [model_of(vehicle, rung, 1.02 + 0.01 * k) for k, rung in enumerate(RUNGS)]
    reference = {rung: model_of(vehicle, rung, 0.99) for rung in RUNGS}
    fits = tuple(fit_of(model, training) for model in models)
    return FitStudy(training, fits, reference)


@once
def judged_of(name: str) -> JudgedModels:
    study = study_of(name)
    validation = fly(model_of(study.models[0].vehicle, "M3"), 8.0, seed=2)
    return JudgedModels(
        validation,
        tuple(compare(study.models, validation)),
        tuple(compare(list(study.reference.values()), validation)),
        faults=(Span(1.0, 1.5, "made up"), Span(1.9, 2.0, "made up too")),
    )


@pytest.fixture(params=["six", "four"])
def craft(request) -> str:
    return request.param


@pytest.fixture
def study(craft) -> FitStudy:
    return study_of(craft)


@pytest.fixture
def judged(craft) -> JudgedModels:
    """The models of the study on another flight."""
    return judged_of(craft)


@pytest.fixture(scope="session")
def reproduction(data, tmp_path_factory) -> Reproduction:
    """The paper's study on the real recordings, with placeholders for pictures."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("airpuck.report.page.drawn", lambda figure, suffix: b"drawn")
        return reproduce(data, tmp_path_factory.mktemp("reproduction"))
