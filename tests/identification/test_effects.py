"""Fits recover the effects from flights of a craft that has them."""

from dataclasses import replace

import numpy as np
import pytest

from airpuck.identification.fit import identify
from airpuck.identification.settings import Preparation
from airpuck.model.model_file import published_model, read_model
from airpuck.preprocessing.pipeline import preprocess
from airpuck.twin.experiments import excite
from airpuck.twin.plant import build_plant
from airpuck.twin.settings import Effects, Radio, TwinSettings, default_twin_settings

pytestmark = pytest.mark.slow

TRUTH = replace(published_model("M3"), frame="body", indexing="start")


def test_the_effects_of_a_twin_are_recovered_within_their_errors(tmp_path):
    effects = Effects(
        drag_linear_1_s=0.3,
        spin_drag_linear_1_s=0.5,
        inflow_s_m=0.3,
        pair_interaction_1_N=10.0,
        voltage_sag_1_N=0.3,
        tilt_rad=(0.01, -0.006),
        idle_lag=2.0,
    )
    # Without jitter, which biases the information in the motors' transients.
    settings = default_twin_settings().model_copy(
        update={"effects": effects, "radio": Radio(delay_s=5 / 240, jitter_s=0.0)}
    )
    plant = build_plant(TRUTH, settings)
    flight = preprocess(excite(TRUTH, 14.0, 3, settings=settings, plant=plant))
    keep = Preparation(faults="keep")  # this flight has no faults
    fit = identify(flight, "M3+drag+inflow+pair+sag+tilt+idle", preparation=keep)
    found, known = fit.model.parameters, fit.uncertainty
    labels = found.labels(TRUTH.vehicle.propeller_names)
    expected = {
        "drag linear": 0.3,
        "drag spin linear": 0.5,
        "inflow": 0.3,
        "pair_interaction": 10.0,
        "voltage_sag": 0.3,
        "tilt x": 0.01,
        "tilt y": -0.006,
        "idle_lag": 2.0,
        "motor_time_constant": TRUTH.parameters.motor_time_constant,
    }
    for label, value in expected.items():
        entry = labels.index(label)
        error = known.standard_errors[entry]
        # The interaction shows while motors change their speeds. The hold of commands by whole
        # samples and the smoothing blur these moments, which the standard error does not include.
        reach = 0.3 * value if label == "pair_interaction" else 4 * error
        assert abs(found.to_vector()[entry] - value) < reach, label
        assert error < 0.15 * abs(value) or label.startswith("drag"), label
    fit.model.save(tmp_path / "model.toml")
    read = read_model(tmp_path / "model.toml")
    np.testing.assert_array_equal(read.parameters.to_vector(), found.to_vector())
    np.testing.assert_array_equal(read.free, fit.model.free)
    np.testing.assert_array_equal(read.uncertainty.standard_errors, known.standard_errors)
    assert read.parameters.effects == found.effects
    # The lag of idling motors is distinguished from lag and delay.
    assert abs(found.idle_lag - 2.0) < 0.3
    assert abs(found.transport_delay - 5 / 240) < 0.5e-3


def test_a_hull_of_a_twin_is_recovered_within_its_errors():
    hull = {
        "hull_added_mass": 0.6,
        "hull_linear_along_1_s": 0.2,
        "hull_linear_across_1_s": 0.5,
        "hull_linear_spin_1_s": 0.3,
        "hull_quadratic_along_1_m": 0.3,
        "hull_quadratic_across_1_m": 1.0,
        "hull_quadratic_spin_1_rad": 0.05,
    }
    settings = TwinSettings(effects=hull, radio=Radio(delay_s=5 / 240, jitter_s=0.0))
    plant = build_plant(TRUTH, settings)
    flight = preprocess(excite(TRUTH, 20.0, 3, settings=settings, plant=plant))
    fit = identify(flight, "M3+hull", preparation=Preparation(faults="keep"))
    errors = fit.uncertainty.standard_errors[-8:-1]
    assert (np.abs(fit.model.parameters.hull - [*hull.values()]) < 4 * errors).all()
    assert (errors[:1] < 0.01).all()
    assert (errors < 0.06).all()
