"""One study: whoever asks gets the same model, verdict and findings."""

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import airpuck
from airpuck.boundary.errors import InputError
from airpuck.campaigns.items import Fitting
from airpuck.craft.vehicle import default_vehicle
from airpuck.data.trajectory import Span
from airpuck.evaluation.evaluate import evaluate
from airpuck.faults.find import find_faults
from airpuck.identification.missing_terms import MissingTerm
from airpuck.judgement.study import judged_on, reference_faults
from airpuck.model.model_file import nominal_model, published_model, read_model
from airpuck.recording.torch_archive import read_authors_experiment
from airpuck.twin.settings import default_twin_settings

from ..apparatus.commands import airpuck as command
from ..apparatus.noisy_flights import TRUTH, noisy
from ..apparatus.public_recordings import VALIDATION
from ..apparatus.synthetic_flights import fly

FILE = {
    "name": "square",
    "mass_kg": 0.21,
    "command_min": 0.05,
    "propellers": [
        {"name": f"m{k}", "position_m": place, "direction_deg": angle}
        for k, (place, angle) in enumerate(
            [((0.05, 0.05), 315), ((0.05, -0.05), 45), ((-0.05, 0.05), 225), ((-0.05, -0.05), 135)]
        )
    ],
    "nominal": {"thrust_N": [0.0, 0.6], "inertia_kg_m2": 5e-4, "transport_delay_s": 0.02},
}
OTHER = nominal_model(airpuck.Vehicle.model_validate(FILE))
TWINS = {
    "healthy": {},
    "tilt": {"effects": {"tilt_rad": (0.03, 0.02)}},
    "drag": {"effects": {"drag_linear_1_s": 0.5}},
    "weak motor": {
        "motors": {"weak": [{"motor": "motor_b_1", "start_s": 0.0, "stop_s": 1e6, "share": 0.7}]}
    },
    "dish": {"effects": {"dish_rad_m": (0.06, 0.04, 0.0)}},
    "other craft": {},
}
TERMS = {"healthy": [], "tilt": ["tilt"], "drag": ["drag"], "weak motor": []}


def recorded(name, duration=10.0, seed=1):
    content = default_twin_settings().model_dump()
    content["on_board"]["rate_hz"] = 0.0
    for section, values in TWINS[name].items():
        content[section].update(values)
    settings = airpuck.TwinSettings.model_validate(content)
    return airpuck.excite(
        OTHER if name == "other craft" else TRUTH, duration, seed, settings=settings
    )


@pytest.mark.slow
@pytest.mark.parametrize("name", TERMS)
def test_a_study_finds_the_terms_of_the_twin(name):
    study = airpuck.study(recorded(name), TRUTH.vehicle)
    assert study.model.name.split("+")[1:] == TERMS[name]
    assert study.selection.missing == ()
    motors = [cause for cause in (one.cause for one in study.findings) if "motor_b_1" in cause]
    assert bool(motors) == (name == "weak motor")


@pytest.mark.slow
@pytest.mark.parametrize("name", ["dish", "other craft"])
def test_python_command_line_and_campaign_give_the_same_model(name, tmp_path):
    bag, file, craft = tmp_path / "bag", tmp_path / "model.toml", tmp_path / "craft.toml"
    airpuck.write_bag(recorded(name, 8.0), bag)
    vehicle = (OTHER if name == "other craft" else TRUTH).vehicle
    vehicle.save(craft)
    study = airpuck.study(bag, vehicle)
    fit = airpuck.identify(airpuck.load_trajectory(bag, vehicle))
    options = ("--model", "auto", "--vehicle", craft, "-o", file, "--json", "-", "-q")
    figures = json.loads(command("identify", bag, *options).stdout)
    (row,) = Fitting(recordings=(str(bag),), model="auto", vehicle=str(craft)).run()
    found, own = read_model(file), study.model
    assert found.name == own.name == fit.model.name
    for other in (found, fit.model):
        vectors = [one.parameters.to_vector() for one in (other, own)]
        np.testing.assert_allclose(*vectors, rtol=1e-6)
    assert row["inertia"] == pytest.approx(study.model.parameters.inertia, rel=1e-6)
    assert row["suspect_recording"] == 0 and row["trusted"] == study.verdict.trusted
    assert figures["verdict"]["outcome"] == study.verdict.outcome
    for key in ("findings", "parameters", "controller"):
        assert figures[key] == study.to_json()[key]


@pytest.mark.slow
def test_a_requested_model_that_lacks_drag_is_reported():
    trajectory = airpuck.preprocess(recorded("drag"), TRUTH.vehicle)
    study = airpuck.study(trajectory, model="M3")
    assert study.model.name == "M3"
    (missing,) = study.selection.missing
    assert missing.term == "drag" and missing.value[0] == pytest.approx(0.5, rel=0.3)
    assert "The model lacks the term drag" in [one.cause for one in study.findings]
    assert study.verdict.parameters.right is False
    # The errors include what is missing.
    assert "drag" in (study.fit.uncertainty or pytest.fail()).notes[-1]


@pytest.mark.slow
def test_a_mirrored_recording_ends_with_its_cause_and_all_files(tmp_path):
    recording = recorded("healthy")
    pose = recording["pose"]
    mirrored = replace(pose, values=pose.values * [1.0, -1.0, 1.0])
    bag, model = tmp_path / "bag", tmp_path / "model.toml"
    airpuck.write_bag(replace(recording, streams={**recording.streams, "pose": mirrored}), bag)
    done = command("identify", bag, "-o", model, "--json", tmp_path / "fit.json")
    assert done.returncode == 2 and model.exists()
    figures = json.loads((tmp_path / "fit.json").read_text())
    assert figures["verdict"]["outcome"] == "suspect_recording"
    assert figures["findings"][0]["kind"] == "signs"
    assert "y axis is flipped" in done.stderr.splitlines()[-1]
    study = airpuck.study(bag)
    with pytest.raises(InputError, match="y axis is flipped"):
        study.verdict.check_recording(bag)


@pytest.mark.slow
def test_thrust_lost_by_a_battery_is_a_change_during_the_recording():
    content = default_twin_settings().model_dump()
    content["effects"]["battery_sag_1_s"] = 0.15 / 20.0
    settings = airpuck.TwinSettings.model_validate(content)
    recording = airpuck.excite(TRUTH, 20.0, 3, settings=settings)
    study = airpuck.study(recording, TRUTH.vehicle, model="M3")
    (change,) = [one for one in study.selection.missing if one.term.startswith("change")]
    # The twin loses 15 % from the beginning to the end.
    assert change.term == "change of all" and change.value[0] == pytest.approx(-0.15, abs=0.04)
    assert "less thrust at the end" in next(one.cause for one in study.findings)


@pytest.mark.parametrize(
    ("term", "value", "told"),
    [
        ("change of delay", 0.004, "commands act 4.0 ms later than at its beginning"),
        ("change of delay", -0.004, "commands act 4.0 ms earlier than at its beginning"),
        ("change of all", -0.1, "All propellers give 10 % less thrust"),
        ("change of motor_a_1", 0.1, "motor_a_1 gives 10 % more thrust"),
    ],
)
def test_a_change_in_flight_is_reported_with_its_sign(term, value, told, monkeypatch):
    flight = fly(TRUTH, 4.0, seed=1)
    lacks = MissingTerm(term, 1e-6, 0.1, 0.1, (value,), np.zeros(1))
    monkeypatch.setattr("airpuck.judgement.study.lacking_on", lambda *_: (lacks,))
    found = judged_on(TRUTH, flight, airpuck.evaluate(TRUTH, flight))
    assert any(told in one.cause for one in found.findings), found.findings


@pytest.mark.parametrize(("span", "share"), [(None, 1.0), ((0.25, 0.75), 0.5)])
def test_a_study_learns_from_the_requested_span(span, share, monkeypatch):
    seen = []

    def structured(training, *_, **__):
        seen.extend(training)
        raise InputError("enough")

    monkeypatch.setattr("airpuck.judgement.study.structured", structured)
    flight = fly(TRUTH, 4.0, seed=1)
    with pytest.raises(InputError, match="enough"):
        airpuck.study(flight, span=span)
    assert seen[0].duration == pytest.approx(share * flight.duration, rel=0.02)


def test_the_first_hour_of_a_long_recording_is_studied_and_reported(monkeypatch):
    seen = []

    def structured(training, *_, **__):
        seen.extend(training)
        return airpuck.identify(training, "M0"), None

    monkeypatch.setattr("airpuck.judgement.study.structured", structured)
    monkeypatch.setattr("airpuck.judgement.study.judged", lambda fit, *_, **__: fit)
    flight = replace(fly(TRUTH, 4.0, seed=1), source="long")
    for hour, told in ((3.0, "long: only the first hour of its poses was used"), (4.0, None)):
        monkeypatch.setattr("airpuck.judgement.study._LONGEST", hour)
        fit: Any = airpuck.study(flight)
        part = seen.pop()
        assert part.duration == pytest.approx(hour, abs=0.03)
        # What is known of a whole recording stays known.
        assert (part is flight) == (told is None)
        assert [one for one in fit.warnings if "hour" in one][:1] == [
            f"{told}; a span selects another part"
        ] * (told is not None)


@pytest.mark.slow
def test_an_angle_error_common_to_all_propellers_is_named_with_its_size():
    turned = [
        one.model_copy(update={"direction_deg": one.direction_deg + 4.0})
        for one in TRUTH.vehicle.propellers
    ]
    vehicle = TRUTH.vehicle.model_copy(update={"propellers": tuple(turned)})
    recording = airpuck.excite(replace(TRUTH, vehicle=vehicle), 20.0, 4)
    study = airpuck.study(recording, TRUTH.vehicle, model="M3")
    (missing,) = [one for one in study.selection.missing if one.term == "direction"]
    assert np.degrees(missing.value[0]) == pytest.approx(4.0, abs=1.2)
    assert "All thrusts point" in next(one.cause for one in study.findings if one.kind == "layout")


@pytest.mark.data
@pytest.mark.slow
def test_the_order_of_models_does_not_depend_on_which_one_finds_the_faults(experiments):
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


def test_a_start_is_healthy_unless_its_window_overlaps_fault_or_recovery():
    found = evaluate(TRUTH, noisy(TRUTH, 4.0))
    start, period = found.every_start.start, found.sample_period
    fault = Span(2.0, 2.3, "radio out")
    healthy = found.healthy([fault])
    touched = (start + 48 * period > 2.0) & (start - 20 * period < 2.3 + 0.08)
    np.testing.assert_array_equal(healthy.start, start[~touched])
    np.testing.assert_array_equal(healthy.errors, found.every_start.errors[:, ~touched])
