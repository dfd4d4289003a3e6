"""Healthy starts do not favour the model that finds the faults."""

import numpy as np
import pytest

from airpuck.craft.vehicle import default_vehicle
from airpuck.data.trajectory import Span
from airpuck.evaluation.evaluate import evaluate
from airpuck.faults.find import find_faults
from airpuck.judgement.healthy import reference_faults
from airpuck.model.model_file import published_model
from airpuck.recording.torch_archive import read_authors_experiment

from ..apparatus.noisy_flights import TRUTH, noisy
from ..apparatus.public_recordings import VALIDATION


@pytest.mark.data
@pytest.mark.slow
def test_the_order_of_models_does_not_depend_on_the_model_that_finds_the_faults(experiments):
    flight = read_authors_experiment(experiments / VALIDATION / "data.pt")
    models = [published_model(name) for name in ("M0", "M2", "M3", "M4")]
    evaluations = [evaluate(model, flight) for model in models]
    published = reference_faults(flight, default_vehicle())
    assert published == find_faults(flight, models[2])
    errors = [
        np.array([one.healthy(faults).rmse for one in evaluations])
        for faults in (published, find_faults(flight, models[3]), find_faults(flight, models[1]))
    ]
    for other in errors[1:]:
        np.testing.assert_allclose(other, errors[0], rtol=0.08)
        clear = np.abs(np.diff(np.log(errors[0]), axis=0)) > 0.05
        same = np.sign(np.diff(other, axis=0)) == np.sign(np.diff(errors[0], axis=0))
        assert same[clear].all()


def test_a_start_is_healthy_unless_its_window_touches_a_fault_or_the_recovery():
    found = evaluate(TRUTH, noisy(TRUTH, 4.0))
    start, period = found.every_start.start, found.sample_period
    fault = Span(2.0, 2.3, "radio out")
    healthy = found.healthy([fault])
    touched = (start + 48 * period > 2.0) & (start - 20 * period < 2.3 + 0.08)
    np.testing.assert_array_equal(healthy.start, start[~touched])
    np.testing.assert_array_equal(healthy.errors, found.every_start.errors[:, ~touched])
