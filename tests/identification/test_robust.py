"""Robust fits: a few bad windows barely change them."""

from dataclasses import replace

import numpy as np
import pytest
from studies.adam import Adam

from airpuck.boundary.errors import InputError
from airpuck.data.windows import make_windows
from airpuck.estimate.encoder import PaperEncoder
from airpuck.evaluation.evaluate import evaluate
from airpuck.identification.fit import identify
from airpuck.identification.method import (
    LevenbergMarquardt,
    information_of_weights,
    reweighted,
    student_weights,
    window_weights,
)
from airpuck.identification.objective import PredictionLoss, Quadratic
from airpuck.identification.problem import prediction_loss
from airpuck.identification.settings import Loss, Preparation
from airpuck.identification.uncertainty import grown, information_growth, sandwich, subspace
from airpuck.model.rungs import named_rung
from airpuck.recording.torch_archive import read_authors_experiment

from ..apparatus.public_recordings import TRAINING, VALIDATION
from ..apparatus.robust_fits import MODEL, off

ROBUST, KEEP_FAULTS = Loss(robust=True), Preparation(faults="keep")


@pytest.fixture(scope="module")
def faulty(clean):
    """Three times, the logged commands are not received for a second."""
    command = clean.command.copy()
    rng = np.random.default_rng(1)
    for begin in (2.0, 6.0, 9.5):
        lost = (clean.command_time >= begin) & (clean.command_time < begin + 0.5)
        command[lost] = rng.uniform(0, 1, (1, 6))
    return replace(clean, command=command)


@pytest.mark.slow
def test_unmarked_faults_barely_affect_the_estimate(faulty):
    plain = identify(faulty, "M3", preparation=KEEP_FAULTS)
    robust = identify(faulty, "M3", loss=ROBUST, preparation=KEEP_FAULTS)
    assert off(plain) > 0.05
    assert off(robust) < 0.1 * off(plain)
    assert robust.converged
    assert robust.model.fit["robust"] is True
    # The reported loss is the unweighted one; no other parameters give a lower one.
    assert robust.loss > plain.loss


@pytest.mark.slow
def test_robustness_costs_nothing_without_faults(clean):
    plain, robust = identify(clean, "M3"), identify(clean, "M3", loss=ROBUST)
    assert off(robust) < 1.5 * off(plain) + 2e-3


@pytest.mark.slow
def test_windows_are_weighted_by_students_distribution(faulty):
    """Against the formula, with errors from `evaluate` on the same windows."""
    loss = PredictionLoss(make_windows(faulty, 20, 50, 70), MODEL.vehicle, PaperEncoder())
    weight = window_weights(loss, MODEL.parameters)
    errors = evaluate(replace(MODEL, frame="body"), faulty).errors
    square = np.mean((errors * np.array([1, 1, 0.1])[:, None]) ** 2, axis=(0, 1))
    np.testing.assert_allclose(weight, 2 / (1 + square / np.median(square)), rtol=1e-9)
    assert weight.min() < 0.05 < 1 < weight.max()


@pytest.mark.slow
def test_iterations_are_numbered_consecutively(faulty):
    seen = []
    fit = identify(faulty, "M0", loss=ROBUST, preparation=KEEP_FAULTS, progress=seen.append)
    numbers = [step.number for step in fit.history]
    assert numbers == list(range(len(numbers)))
    assert max(step.number for step in seen) == fit.iterations


@pytest.mark.slow
def test_other_optimisers_are_not_robust(clean):
    with pytest.raises(InputError, match="robust"):
        identify(clean, "M3", method=Adam(epochs=1), loss=ROBUST)


@pytest.mark.slow
def test_a_window_drawn_twice_counts_twice(faulty):
    """Resampled fits recompute the weights for the windows that were drawn."""
    loss = replace(prediction_loss(ROBUST, [faulty], MODEL.vehicle), clusters=None)
    rung, windows, method = named_rung("M0"), loss.windows, LevenbergMarquardt()
    start = rung.initial(MODEL.vehicle)
    times = np.random.default_rng(0).integers(0, 3, len(windows))
    repeated = replace(windows, starts=np.repeat(windows.starts, times))
    found = []
    for drawn in (replace(loss, multiplicity=times.astype(float)), replace(loss, windows=repeated)):
        first = method.minimize(drawn, start, rung.mask(start))
        _, outcome = reweighted(method, drawn, first, rung.mask(start))
        found.append(outcome.parameters.to_vector())
    np.testing.assert_allclose(found[0], found[1], rtol=1e-4)
    assert not np.allclose(found[0], first.parameters.to_vector(), rtol=1e-3)


class Decay:
    """A nonlinear regression in windows: y = a e^{-bt}, with a separate error for each window."""

    a, b, time = 1.0, 0.7, np.linspace(0, 4, 960).reshape(120, 8)

    def sampled(self, rng):
        """Errors of windows have heavy tails; errors of samples do not."""
        off = 0.05 * rng.standard_t(2.0, size=(len(self.time), 1))
        white = 0.01 * rng.normal(size=self.time.shape)
        return self.a * np.exp(-self.b * self.time) + off + white

    def at(self, theta, measured):
        """Residuals, and their derivatives."""
        decay = np.exp(-theta[1] * self.time)
        jacobian = np.stack([decay, -theta[0] * self.time * decay], axis=-1)
        return theta[0] * decay - measured, jacobian

    def weighed(self, theta, measured):
        """Squares of windows, their gradients, and what a window adds to the information."""
        residual, jacobian = self.at(theta, measured)
        gradient = 2 * np.einsum("wk,wkp->wp", residual, jacobian) / residual.shape[1]
        information = 2 * np.einsum("wkp,wkq->wpq", jacobian, jacobian) / residual.shape[1]
        return np.mean(residual**2, axis=1), gradient, information

    def fitted(self, measured):
        theta = np.array([self.a, self.b])
        for _ in range(100):
            square, gradient, information = self.weighed(theta, measured)
            weight = student_weights(square)
            step = np.linalg.solve(np.einsum("w,wpq->pq", weight, information), weight @ gradient)
            theta = theta - step
            if np.abs(step).max() < 1e-10:
                break
        return theta

    def errors(self, theta, measured):
        """Standard errors, with weights as given and with weights that follow the parameters."""
        parameters = MODEL.parameters
        free = parameters.mask(frozenset({"center_of_mass"}))
        square, gradient, information = self.weighed(theta, measured)
        weight = student_weights(square)
        weight /= weight.sum()
        scores = np.zeros((len(square), len(free)))
        scores[:, free] = weight[:, None] * gradient
        parts = np.zeros((len(square), len(free), len(free)))
        parts[np.ix_(np.arange(len(square)), free, free)] = weight[:, None, None] * information
        quadratic = Quadratic(weight * square, scores, parts)
        space = subspace(quadratic.hessian, free, np.zeros((0, len(free))))
        given = sandwich(quadratic, parameters, space)
        wide = np.zeros((len(square), len(free)))
        wide[:, free] = gradient
        added = information_of_weights(square, wide)
        factor = information_growth(quadratic.hessian, added, space.basis)
        return [u.standard_errors[free] for u in (given, grown(given, factor))]


@pytest.mark.slow
def test_standard_errors_account_for_the_weights():
    """The spread of 300 estimates; with weights as given errors are too small by a third."""
    regression, rng = Decay(), np.random.default_rng(0)
    estimates, errors = [], []
    for _ in range(300):
        measured = regression.sampled(rng)
        estimates.append(regression.fitted(measured))
        errors.append(regression.errors(estimates[-1], measured))
    given, ours = np.mean(errors, axis=0)
    spread = np.std(estimates, axis=0)
    np.testing.assert_allclose(ours, spread, rtol=0.1)
    assert (given < 0.7 * spread).all()


def test_the_information_is_the_derivative_of_the_weighted_scores():
    """Against differences; a median that follows a few windows needs many of them."""
    regression, rng = Decay(), np.random.default_rng(1)
    regression.time = np.linspace(0, 4, 320000).reshape(40000, 8)
    measured = regression.sampled(rng)
    theta = regression.fitted(measured) + np.array([0.02, -0.02])

    def score(theta):
        square, gradient, _ = regression.weighed(theta, measured)
        return student_weights(square) @ gradient

    square, gradient, information = regression.weighed(theta, measured)
    weight = student_weights(square)
    steps = 5e-3 * np.eye(2)
    slope = np.array([(score(theta + h) - score(theta - h)) / 1e-2 for h in steps]).T
    ours = np.einsum("w,wpq->pq", weight, information)
    ours += weight.sum() * information_of_weights(square, gradient)
    # The Gauss-Newton approximation omits second derivatives of the model.
    residual, time = regression.at(theta, measured)[0], regression.time
    bent = -2 * np.mean(residual * time * np.exp(-theta[1] * time), axis=1) @ weight
    curved = 2 * np.mean(residual * theta[0] * time**2 * np.exp(-theta[1] * time), axis=1) @ weight
    ours += [[0, bent], [bent, curved]]
    np.testing.assert_allclose(ours, slope, atol=0.02 * np.abs(slope).max())


@pytest.mark.study
@pytest.mark.data
def test_median_errors_on_the_papers_experiments_are_small(experiments):
    training, validation = (
        read_authors_experiment(experiments / name / "data.pt") for name in (TRAINING, VALIDATION)
    )
    model = identify(training, "M3", loss=ROBUST, preparation=KEEP_FAULTS).model
    assert (evaluate(model, validation).median_abs <= [0.0028, 0.0028, 0.11]).all()
