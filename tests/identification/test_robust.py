"""A fit that a few bad windows do not move."""

from dataclasses import replace

import numpy as np
import pytest

from airpuck.boundary.errors import InputError
from airpuck.data.windows import make_windows
from airpuck.estimate.encoder import PaperEncoder
from airpuck.evaluation.evaluate import evaluate
from airpuck.identification.adam import Adam
from airpuck.identification.fit import identify
from airpuck.identification.method import window_weights
from airpuck.identification.objective import PredictionLoss
from airpuck.identification.problem import Loss, Preparation
from airpuck.model.model_file import published_model
from airpuck.recording.torch_archive import read_authors_experiment

from ..conftest import TRAINING, VALIDATION
from ..synthetic import fly

ROBUST, KEEP_FAULTS = Loss(robust=True), Preparation(faults="keep")
MODEL = replace(published_model("M3"), indexing="start")


@pytest.fixture(scope="module")
def clean():
    flight = fly(MODEL, duration=12.0)
    rng = np.random.default_rng(0)
    noise = rng.normal(size=flight.state.shape) * [1e-5, 1e-5, 1e-4, 1e-3, 1e-3, 1e-2]
    return replace(flight, state=flight.state + noise)


@pytest.fixture(scope="module")
def faulty(clean):
    """For a second nobody hears the commands that are logged, three times."""
    command = clean.command.copy()
    rng = np.random.default_rng(1)
    for begin in (2.0, 6.0, 9.5):
        lost = (clean.command_time >= begin) & (clean.command_time < begin + 0.5)
        command[lost] = rng.uniform(0, 1, (1, 6))
    return replace(clean, command=command)


def off(fit):
    """Relative error of inertia, lag and thrust at half speed."""
    found, true = fit.model.parameters, MODEL.parameters
    half = [0.5, 0.25, 0.125]
    return np.abs(
        [
            found.inertia / true.inertia - 1,
            found.motor_time_constant / true.motor_time_constant - 1,
            *(found.thrust @ half / (true.thrust @ half) - 1),
        ]
    ).max()


def test_unmarked_faults_hardly_move_the_estimate(faulty):
    plain = identify(faulty, "M3", preparation=KEEP_FAULTS)
    robust = identify(faulty, "M3", loss=ROBUST, preparation=KEEP_FAULTS)
    assert off(plain) > 0.05
    assert off(robust) < 0.1 * off(plain)
    assert robust.converged
    assert robust.model.fit["robust"] is True
    # The loss that is told is the plain one, which no other parameters have lower.
    assert robust.loss > plain.loss


def test_without_faults_nothing_is_lost(clean):
    plain, robust = identify(clean, "M3"), identify(clean, "M3", loss=ROBUST)
    assert off(robust) < 1.5 * off(plain) + 2e-3


def test_a_window_counts_as_student_says(faulty):
    """Against the formula, with errors from `evaluate` on the same windows."""
    loss = PredictionLoss(make_windows(faulty, 20, 50, 70), MODEL.vehicle, PaperEncoder())
    weight = window_weights(loss, MODEL.parameters)
    errors = evaluate(replace(MODEL, frame="body"), faulty).errors
    square = np.mean((errors * np.array([1, 1, 0.1])[:, None]) ** 2, axis=(0, 1))
    np.testing.assert_allclose(weight, 2 / (1 + square / np.median(square)), rtol=1e-9)
    assert weight.min() < 0.05 < 1 < weight.max()


def test_iterations_are_counted_on(faulty):
    seen = []
    fit = identify(faulty, "M0", loss=ROBUST, preparation=KEEP_FAULTS, progress=seen.append)
    numbers = [step.number for step in fit.history]
    assert numbers == list(range(len(numbers)))
    assert max(step.number for step in seen) == fit.iterations


def test_adam_is_not_robust(clean):
    with pytest.raises(InputError, match="robust"):
        identify(clean, "M3", method=Adam(epochs=1), loss=ROBUST)


@pytest.mark.data
def test_medians_on_the_paper_s_experiments(experiments):
    training, validation = (
        read_authors_experiment(experiments / name / "data.pt") for name in (TRAINING, VALIDATION)
    )
    model = identify(training, "M3", loss=ROBUST, preparation=KEEP_FAULTS).model
    assert (evaluate(model, validation).median_abs <= [0.0028, 0.0028, 0.11]).all()
