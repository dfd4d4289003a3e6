"""Intervals by resampling."""

from dataclasses import replace

import numpy as np
import pytest
from studies.adam import Adam

from airpuck.boundary.errors import InputError
from airpuck.deviation.packet_delays import PacketDelays
from airpuck.identification.bootstrap import bootstrap, resampled_estimates
from airpuck.identification.fit import identify
from airpuck.identification.settings import Preparation
from airpuck.model.model_file import read_model
from airpuck.model.uncertainty import DelayJitter

from ..apparatus.disturbed_flights import noisy

pytestmark = pytest.mark.slow


def test_too_few_blocks_cause_a_warning():
    flight = noisy(duration=7.0)
    short = identify(flight)
    assert any("blocks of time" in warning for warning in short.warnings)
    with pytest.raises(InputError, match="blocks"):
        bootstrap(short, 10)


def test_bootstrap_agrees_with_the_sandwich(tmp_path, fit):
    found = bootstrap(fit, 30, seed=1)
    again = found.uncertainty.bootstrap
    assert again.replicates == 30
    spread = (again.upper - again.lower) / np.diff(found.uncertainty.intervals, axis=1)[:, 0]
    # So few blocks differ less in a resample; the sandwich allows for that.
    assert 0.4 < np.nanmedian(spread) < 1.6
    found.model.save(tmp_path / "model.toml")
    read = read_model(tmp_path / "model.toml").uncertainty.bootstrap
    np.testing.assert_array_equal(read.lower, again.lower)
    np.testing.assert_array_equal(read.upper, again.upper)
    figures = found.to_json()["values"]["inertia"]
    low, high = figures["interval_95"]
    assert low < figures["value"] < high
    assert figures["bootstrap_95"][0] < figures["value"] < figures["bootstrap_95"][1]


def test_a_fit_by_another_optimiser_has_standard_errors_but_no_bootstrap():
    fit = identify(noisy(duration=8.0), "M2", method=Adam(epochs=1))
    assert np.isfinite(fit.uncertainty.standard_errors[fit.model.free]).any()
    with pytest.raises(InputError, match="bootstrap"):
        bootstrap(fit, 10)


def test_a_seed_reproduces_the_estimates(fit):
    seen = []
    estimates = resampled_estimates(fit, 3, seed=4, progress=seen.append)
    assert seen == [1, 2, 3]
    assert estimates.shape == (3, len(fit.model.free))
    np.testing.assert_allclose(resampled_estimates(fit, 3, seed=4), estimates, rtol=1e-9)
    assert not np.allclose(resampled_estimates(fit, 3, seed=5), estimates, rtol=1e-9)


def test_sampled_packets_widen_the_interval_of_the_delay():
    """By the variance of their mean, about the middle of the interval."""
    fit = identify(noisy(), preparation=Preparation(delay="fit", retimings=0))
    jitter, packets = 6e-3, PacketDelays(np.arange(90), np.zeros(90), np.full(90, 1e-4))
    delay = fit.model.parameters.mask(frozenset({"transport_delay"}))
    assert np.isfinite(fit.uncertainty.standard_errors[delay]).all()
    plain = replace(fit, model=replace(fit.model, delay_jitter=None))
    known = replace(
        fit.model,
        delay_jitter=DelayJitter(standard_deviation_s=jitter, standard_error_s=1e-4, packets=90),
    )
    wide = bootstrap(replace(fit, model=known, packet_delays=(packets,)), 5).uncertainty.bootstrap
    narrow = bootstrap(plain, 5).uncertainty.bootstrap
    np.testing.assert_allclose((wide.lower + wide.upper), (narrow.lower + narrow.upper), rtol=1e-6)
    half, before = (wide.upper - wide.lower) / 2, (narrow.upper - narrow.lower) / 2
    added = np.where(delay, 1.959964 * jitter / np.sqrt(90), 0.0)
    np.testing.assert_allclose(half, np.hypot(before, added), rtol=1e-3)
