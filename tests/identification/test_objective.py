"""The loss and its Gauss-Newton approximation, against plain implementations."""

from dataclasses import dataclass, field, replace
from typing import Literal
from unittest import mock

import numpy as np
import pytest

from airpuck.boundary.errors import InputError
from airpuck.craft.vehicle import default_vehicle
from airpuck.data.windows import Windows, make_windows
from airpuck.estimate.encoder import PaperEncoder
from airpuck.identification.objective import PredictionLoss
from airpuck.model.model_file import published_model
from airpuck.model.quantities import EFFECTS
from airpuck.model.rungs import TERMS, named_rung
from airpuck.physics.effects import Effect

from ..apparatus.plain_loss import differences, plain_residuals
from ..apparatus.synthetic_flights import fly

VEHICLE = default_vehicle()
WEIGHTS = (1.0, 2.0, 0.1)
#: All terms of the physics.
ALL_TERMS = "+".join(["M3", *(term for term in TERMS if term != "residual")])


@pytest.fixture(scope="module")
def windows() -> Windows:
    flight = fly(published_model("M3"), duration=3.0)
    noise = np.random.default_rng(1).normal(size=flight.state.shape)
    # The cost of a plain rollout is proportional to its steps.
    return make_windows(replace(flight, state=flight.state + 0.01 * noise), 20, 20, stride=11)


def residuals(parameters, windows, encoder, frame="body"):
    return plain_residuals(
        np, parameters.dynamics(np, VEHICLE, frame), windows, encoder, weights=WEIGHTS
    )


def moved(name):
    """Parameters off the initial values, so that no derivative vanishes by symmetry."""
    parameters = named_rung(name).initial(VEHICLE)
    vector = parameters.to_vector()
    rng = np.random.default_rng(2)
    vector = vector * (1 + 0.05 * rng.normal(size=len(vector))) + 1e-3
    vector[parameters.mask(frozenset(EFFECTS))] += 0.3
    return parameters.with_vector(vector)


def analytic_abs(values):
    """|x| as complex steps need it: its derivative is the sign."""
    return np.where(np.real(values) < 0, -values, values)


def plain_jacobian(parameters, windows, encoder, frame):
    """Derivatives of the plain residuals, shape (M, P), by complex steps: nothing is compiled."""
    vector, step = parameters.to_vector(), 1e-30
    columns = []
    with mock.patch.object(np, "abs", analytic_abs):
        for unit in np.eye(len(vector)):
            moved = parameters.with_vector(vector + 1j * step * unit)
            errors = residuals(moved, windows, encoder, frame)
            columns.append(np.imag(errors).ravel() / step)
    return np.stack(columns, axis=1)


@pytest.mark.parametrize(
    ("name", "frame"),
    [
        ("M3", "body"),
        ("M3", "world"),
        pytest.param("quadratic", "body", marks=pytest.mark.slow),
        pytest.param(ALL_TERMS, "body", marks=pytest.mark.slow),
        # M4's own columns, and terms that take a thrust in newtons.
        pytest.param("M4+inflow+pair+sag", "body", marks=pytest.mark.slow),
        # An inertia that depends on the motion, beside columns that are learned.
        pytest.param("M4+hull", "body", marks=pytest.mark.slow),
    ],
)
def test_gradient_and_hessian_match_the_plain_jacobian(windows, name, frame):
    parameters, encoder = moved(name), PaperEncoder()
    result = PredictionLoss(windows, VEHICLE, encoder, WEIGHTS, frame).quadratic(parameters)
    residual = residuals(parameters, windows, encoder, frame).ravel()
    jacobian = plain_jacobian(parameters, windows, encoder, frame)
    count = len(residual)
    assert result.loss == pytest.approx(residual @ residual / count, rel=1e-12)
    scale = np.abs(result.hessian).max()
    np.testing.assert_allclose(
        result.gradient, 2 * jacobian.T @ residual / count, rtol=1e-9, atol=1e-12 * scale
    )
    np.testing.assert_allclose(
        result.hessian, 2 * jacobian.T @ jacobian / count, rtol=1e-9, atol=1e-12 * scale
    )


@pytest.mark.parametrize(
    ("name", "indexing"),
    [("M0", "start"), ("M0", "end"), ("M2", "start"), ("M2", "end"), (ALL_TERMS, "start")],
)
def test_the_gradient_matches_finite_differences(windows, name, indexing):
    parameters, encoder = moved(name), PaperEncoder(indexing=indexing)
    if name in ("M0", "M2"):
        parameters = named_rung(name).initial(VEHICLE)
    loss = PredictionLoss(windows, VEHICLE, encoder, WEIGHTS)
    gradient = loss.quadratic(parameters).gradient
    vector = parameters.to_vector()

    def plain(vector):
        residual = residuals(parameters.with_vector(vector), windows, encoder)
        return np.mean(residual**2)

    entries = np.flatnonzero(named_rung(name).mask(parameters))
    slopes = differences(plain, vector, entries)
    np.testing.assert_allclose(gradient[entries], slopes, rtol=1e-5, atol=1e-9)


def test_clusters_sum_to_the_total(windows):
    parameters = moved("M3")
    plain = PredictionLoss(windows, VEHICLE, PaperEncoder(), WEIGHTS)
    clusters = np.arange(len(windows)) // 20
    result = replace(plain, clusters=clusters).quadratic(parameters)
    expected = plain.quadratic(parameters)
    assert result.cluster_losses.shape == (clusters.max() + 1,)
    assert result.loss == pytest.approx(expected.loss, rel=1e-12)
    np.testing.assert_allclose(result.gradient, expected.gradient, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(result.hessian, expected.hessian, rtol=1e-9, atol=1e-12)


def test_many_windows_are_thinned(windows):
    loss = PredictionLoss(windows, VEHICLE, PaperEncoder())
    assert loss.thinned is loss
    starts = np.resize(windows.starts, 1001)
    many = replace(
        loss,
        windows=replace(windows, starts=starts),
        multiplicity=np.arange(1001.0),
        clusters=np.zeros(1001, dtype=int),
    ).thinned
    np.testing.assert_array_equal(many.windows.starts, starts[::4])
    np.testing.assert_array_equal(many.multiplicity, np.arange(0.0, 1001.0, 4))
    assert many.clusters is None


@pytest.mark.slow
@pytest.mark.parametrize("count", [1, 257])
def test_padding_of_batches_does_not_count(windows, count):
    starts = np.resize(windows.starts, count)
    some = replace(windows, starts=starts)
    parameters = moved("M3")
    result = PredictionLoss(some, VEHICLE, PaperEncoder(), WEIGHTS).quadratic(parameters)
    expected = residuals(parameters, some, PaperEncoder())
    assert result.loss == pytest.approx(np.mean(expected**2), rel=1e-12)


@pytest.mark.slow
def test_one_window_can_cover_the_whole_flight():
    windows = make_windows(fly(published_model("M3"), duration=3.0), 20, None)
    parameters = moved("M3")
    result = PredictionLoss(windows, VEHICLE, PaperEncoder(), WEIGHTS).quadratic(parameters)
    expected = residuals(parameters, windows, PaperEncoder())
    assert result.loss == pytest.approx(np.mean(expected**2), rel=1e-9)


def test_only_lost_frames_are_ignored():
    flight, parameters = fly(published_model("M3"), duration=0.5), moved("M3")
    flight = replace(flight, lost=flight.time[[30]])

    def loss(sample, shift):
        state = flight.state.copy()
        state[sample, :3] += shift
        windows = make_windows(replace(flight, state=state), 20, 20, stride=1000)
        assert windows.starts.tolist() == [0]
        return PredictionLoss(windows, VEHICLE, PaperEncoder(), WEIGHTS).quadratic(parameters).loss

    assert loss(30, 1.0) == loss(30, 0.0)
    for neighbour in (29, 31):
        assert loss(neighbour, 1.0) > 2 * loss(neighbour, 0.0)


@dataclass(frozen=True, eq=False)
class PlainNumpy(Effect):
    """Written without the array namespace, so that nothing can differentiate it."""

    rate: float = 0.1

    def acceleration(self, xp, motion):
        return -self.rate * np.tanh(motion.forward), 0.0, 0.0


def test_a_user_effect_that_cannot_be_differentiated_ends_in_one_line(windows):
    parameters = named_rung("M3").with_effect(PlainNumpy).initial(VEHICLE)
    loss = PredictionLoss(windows, VEHICLE, PaperEncoder(), WEIGHTS)
    with pytest.raises(InputError, match=r"PlainNumpy: model: cannot be differentiated: use xp"):
        loss.quadratic(parameters)


@dataclass(frozen=True, eq=False, slots=True)
class PowerDrag(Effect):
    """Drag by a power of the speed along an axis of the body."""

    power: int = 3
    axis: Literal["forward", "left"] = "forward"
    scales: tuple[float, ...] = (0.5, 2.0)
    rate: float = 1
    most: float | None = None
    kept: float = field(init=False, default=0.0)

    def acceleration(self, xp, motion):
        speed = getattr(motion, self.axis)
        return -self.rate * self.scales[0] * self.scales[1] * speed**self.power, 0.0, 0.0


def test_only_float_fields_of_an_effect_are_fitted(windows):
    rung = named_rung("M3").with_effect(PowerDrag)
    parameters, encoder = rung.initial(VEHICLE), PaperEncoder()
    assert parameters.power_drag.tolist() == [1.0]
    result = PredictionLoss(windows, VEHICLE, encoder, WEIGHTS).quadratic(parameters)
    residual = residuals(parameters, windows, encoder).ravel()
    jacobian = plain_jacobian(parameters, windows, encoder, "body")
    expected = 2 * jacobian.T @ residual / len(residual)
    np.testing.assert_allclose(result.gradient, expected, rtol=1e-9, atol=1e-12)
    assert expected[parameters.mask(frozenset({"power_drag"}))] != 0
