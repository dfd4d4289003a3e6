"""Effects are found again in flights of a craft that has them."""

from dataclasses import replace

import numpy as np
import pytest

from airpuck.identification.fit import identify
from airpuck.model_file import published_model, read_model
from airpuck.preprocessing.pipeline import preprocess
from airpuck.twin.experiments import excite
from airpuck.twin.settings import Effects, Radio, default_twin_settings
from airpuck.twin.twin import build_plant

from ..synthetic import fly

TRUTH = replace(published_model("M3"), frame="body", indexing="start")
SAG = {"voltage_sag": 0.3}
REST = {
    "drag": np.array([0.3, 0.2, 0.5, 0.02]),
    "inflow": 0.2,
    "pair_interaction": 6.0,
    "tilt": np.array([0.006, -0.004]),
}


@pytest.mark.parametrize(("name", "effects"), [("M3+sag", SAG), ("M3+drag+inflow+pair+tilt", REST)])
def test_exact_flights_give_the_effects_back(tmp_path, name, effects):
    truth = replace(TRUTH, parameters=replace(TRUTH.parameters, **effects))
    fit = identify(fly(truth, 8.0), name, stride=11)
    for key, value in effects.items():
        # The motors' first speeds are a guess, of which the encoder leaves a little.
        np.testing.assert_allclose(getattr(fit.model.parameters, key), value, rtol=0.05, atol=2e-3)
    fit.model.save(tmp_path / "model.toml")
    read = read_model(tmp_path / "model.toml")
    np.testing.assert_array_equal(read.parameters.to_vector(), fit.model.parameters.to_vector())
    np.testing.assert_array_equal(read.free, fit.model.free)
    assert read.parameters.effects == fit.model.parameters.effects
    for ours, theirs in zip(read.dynamics.effects, fit.model.dynamics.effects, strict=True):
        assert type(ours) is type(theirs)


def test_a_flight_of_the_twin_gives_its_effects_back_within_their_errors():
    effects = Effects(
        drag_linear_1_s=0.3,
        spin_drag_linear_1_s=0.5,
        inflow_s_m=0.3,
        pair_interaction_1_N=10.0,
        voltage_sag_1_N=0.3,
        tilt_rad=(0.01, -0.006),
    )
    # Without jitter, which biases what the motors' transients tell.
    settings = default_twin_settings().model_copy(
        update={"effects": effects, "radio": Radio(delay_s=5 / 240)}
    )
    plant = build_plant(TRUTH, settings)
    flight = preprocess(excite(TRUTH, 40.0, 3, settings=settings, plant=plant))
    fit = identify(flight, "M3+drag+inflow+pair+sag+tilt")
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
    }
    for label, value in expected.items():
        entry = labels.index(label)
        error = known.standard_errors[entry]
        print(label, found.to_vector()[entry], value, error)
        assert abs(found.to_vector()[entry] - value) < 4 * error, label
