"""Recordings that share some parameters of a craft and have others for themselves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from airpuck.boundary.errors import InputError
from airpuck.identification import shared as shared_fits
from airpuck.identification.fit import identify
from airpuck.identification.shared import combined, with_each
from airpuck.identification.structure import identify as identify_all
from airpuck.model.model_file import published_model, read_model
from airpuck.model.rungs import named_rung
from airpuck.model.sections import OfRecording
from airpuck.preprocessing.pipeline import preprocess
from airpuck.twin.experiments import excite
from airpuck.twin.settings import Effects, default_twin_settings

from ..apparatus.beliefs import believed
from ..apparatus.synthetic_flights import fly

MODEL = replace(published_model("M3"), frame="body")
DELAYS, TILTS = (0.015, 0.028, 0.021), ((0.004, -0.002), (-0.003, 0.0), (0.0, 0.005))


def estimated(vector, covariance):
    """Return a model with these parameters and their covariance."""
    return believed(replace(MODEL, parameters=MODEL.parameters.with_vector(vector)), covariance)


def precision(model):
    """Return the Hessian that belongs to the covariance of a model."""
    covariance = model.uncertainty.covariance
    used = np.flatnonzero(np.diag(covariance))
    found = np.zeros_like(covariance)
    found[np.ix_(used, used)] = np.linalg.inv(covariance[np.ix_(used, used)])
    return found


def test_combined_fits_equal_the_least_squares_solution_of_their_estimates():
    rng = np.random.default_rng(0)
    truth = MODEL.parameters.to_vector()
    size = len(truth)
    own = MODEL.parameters.mask(frozenset({"transport_delay"}))
    shared = MODEL.free & ~own
    used = np.flatnonzero(shared | own)
    scale = 0.01 * np.abs(truth[used]) + 1e-5
    models, rows, aim = [], [], []
    for number in range(3):
        root = scale[:, None] * rng.normal(size=(len(used), len(used) + 3))
        covariance, vector = np.zeros((size, size)), truth.copy()
        covariance[np.ix_(used, used)] = root @ root.T
        vector[used] += root @ rng.normal(size=root.shape[1])
        models.append(estimated(vector, covariance))
        # Each estimate picks the shared values, and its own delay, out of the unknowns.
        pick = np.zeros((len(used), len(used) - 1 + 3))
        pick[:-1, : len(used) - 1] = np.eye(len(used) - 1)
        pick[-1, len(used) - 1 + number] = 1.0
        whitening = np.linalg.inv(np.linalg.cholesky(root @ root.T))
        rows.append(whitening @ pick)
        aim.append(whitening @ vector[used])
    stacked = np.concatenate(rows)
    expected = np.linalg.lstsq(stacked, np.concatenate(aim), rcond=None)[0]
    spread = np.sqrt(np.diag(np.linalg.inv(stacked.T @ stacked)))
    found = combined(models, [precision(model) for model in models], shared, own)
    pairs = zip(found.vectors, found.covariances, strict=True)
    for number, (vector, covariance) in enumerate(pairs):
        at = [*range(len(used) - 1), len(used) - 1 + number]
        np.testing.assert_allclose(vector[used], expected[at], rtol=1e-6)
        np.testing.assert_allclose(np.sqrt(np.diag(covariance))[used], spread[at], rtol=1e-6)
    # Chance alone separates some of 66 values by two to three standard errors.
    assert 1.5 < found.apart < 4.0


def test_recordings_that_disagree_about_a_shared_value_are_reported():
    truth = MODEL.parameters.to_vector()
    own = MODEL.parameters.mask(frozenset({"transport_delay"}))
    covariance = np.diag((0.01 * np.abs(truth) * (MODEL.free | own)) ** 2)
    other = truth * np.where(MODEL.parameters.mask(frozenset({"inertia"})), 1.2, 1.0)
    for one, apart in ((truth, 0.0), (other, 20 / np.sqrt(2))):
        models = [estimated(truth, covariance), estimated(one, covariance)]
        found = combined(models, [precision(model) for model in models], MODEL.free & ~own, own)
        # Half the difference, whose standard error is 1 % / sqrt(2).
        assert found.apart == pytest.approx(apart)
    labels = MODEL.parameters.labels(MODEL.vehicle.propeller_names)
    assert labels[found.entry] == "inertia"


def test_a_fixed_parameter_keeps_its_value_of_each_fit():
    truth = MODEL.parameters.to_vector()
    own = MODEL.parameters.mask(frozenset({"transport_delay"}))
    covariance = np.diag((0.01 * np.abs(truth) * (MODEL.free & ~own)) ** 2)
    moved = truth + 0.01 * own
    models = [estimated(truth, covariance), estimated(moved, covariance)]
    found = combined(models, [precision(model) for model in models], MODEL.free & ~own, own)
    assert found.vectors[0][own] == truth[own]
    assert found.vectors[1][own] == moved[own]


def test_terms_particular_to_each_recording_are_added():
    rung, own = with_each(named_rung("M3+tilt"), ("delay", "tilt", "sag"))
    assert rung.name == "M3+tilt+sag"
    assert own == {"transport_delay", "tilt", "voltage_sag"}
    with pytest.raises(InputError, match="delay"):
        with_each(named_rung("M3"), ("dealy",))


def test_a_single_recording_is_rejected():
    with pytest.raises(InputError, match="needs several recordings"):
        identify_all(fly(MODEL, 2.0), "M3", each=("delay",))


def test_a_model_file_keeps_the_values_per_recording(tmp_path):
    delays = (0.01, 0.02)
    found = tuple(
        OfRecording(f"day{n}", replace(MODEL.parameters, transport_delay=delay), None)
        for n, delay in enumerate(delays, start=1)
    )
    model = replace(MODEL, parameters=found[-1].parameters, recordings=found)
    model.save(tmp_path / "model.toml")
    name = str(tmp_path / "model.toml")
    assert read_model(name).transport_delay == delays[-1]
    for number, delay in enumerate(delays, start=1):
        read = read_model(f"{name}#{number}")
        assert read.transport_delay == delay
    assert read_model(f"{name}#1").source == "day1"
    with pytest.raises(InputError, match="from 1 to 2, not 3"):
        read_model(f"{name}#3")
    published_model("M3").save(tmp_path / "shared.toml")
    with pytest.raises(InputError, match="--each"):
        read_model(f"{tmp_path / 'shared.toml'}#1")


@pytest.fixture(scope="module")
def flights():
    """Three flights on three days: same craft, other radios and floors."""
    usual = default_twin_settings().without_on_board()
    found = []
    for seed, (delay, tilt) in enumerate(zip(DELAYS, TILTS, strict=True)):
        settings = usual.model_copy(update={"effects": Effects.model_validate({"tilt_rad": tilt})})
        recording = excite(MODEL.with_delay(delay), 15.0, seed, settings=settings)
        found.append(preprocess(recording, MODEL.vehicle))
    return found


@pytest.mark.slow
def test_each_flight_gets_its_own_delay_and_tilt_and_shares_the_rest(flights, monkeypatch):
    alone = []

    def watched(*given, **options):
        alone.append(identify(*given, **options))
        return alone[-1]

    monkeypatch.setattr(shared_fits, "identify", watched)
    fit = identify_all(flights, "M3", each=("delay", "tilt"))
    assert fit.model.name == "M3+tilt"
    assert not any("do not agree" in warning for warning in fit.warnings)
    own = fit.model.parameters.mask(frozenset({"transport_delay", "tilt"}))
    for here, delay, tilt in zip(fit.model.recordings, DELAYS, TILTS, strict=True):
        assert here.uncertainty is not None
        # Of nine intervals of 95 %, all at this seed; entries are tilt x, tilt y, delay.
        low, high = here.uncertainty.intervals[own].T
        assert (low <= [*tilt, delay]).all()
        assert (high >= [*tilt, delay]).all()
    alone = [one.model for one in alone]
    shared = fit.model.free & ~own
    assert fit.model.known is not None
    errors = fit.model.known.standard_errors[shared]
    single = np.array([one.uncertainty.standard_errors[shared] for one in alone])
    # In a fit of its own, a thrust curve near its bound has a small standard error, or none.
    usual = np.nanmedian(single, axis=0)
    assert np.mean(errors < usual) > 0.8
    # Three equal recordings would give 1/sqrt(3).
    assert 0.4 < np.median(errors / usual) < 0.8
    # The shared values are right, too.
    truth = MODEL.parameters.to_vector()
    vector = fit.model.parameters.to_vector()
    free = MODEL.free & ~MODEL.parameters.mask(frozenset({"transport_delay"}))
    assert len(truth[free]) == shared.sum()
    apart = (vector[shared] - truth[free]) / errors
    assert np.median(np.abs(apart)) < 1.2
