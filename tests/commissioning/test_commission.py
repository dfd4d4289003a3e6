"""From the box to a trusted flight, on the twin and over the graph."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from airpuck import Twin, TwinSettings, Vehicle, commission, read_model, read_vehicle
from airpuck.commissioning import excitations
from airpuck.commissioning.commission import STEPS
from airpuck.commissioning.excitations import Excitations
from airpuck.commissioning.session import Work
from airpuck.craft.vehicle import default_vehicle
from airpuck.evaluation.presentation import largest_acceleration
from airpuck.model.model_file import nominal_model, published_model
from airpuck.report.commissioning_report import commissioning_report
from airpuck.twin.settings import Weakness

from ..apparatus.changes import changed

pytestmark = pytest.mark.slow

TRUTH = replace(published_model("M3"), frame="body", indexing="start")
QUIET = TwinSettings().without_on_board()


def rough() -> Vehicle:
    """The craft with wrong numbers, two motors in each other's places, and one turned round."""
    content = default_vehicle().model_dump(mode="json")
    content["pairs"] = []
    content["mass_kg"] *= 1.25
    nominal, propellers = content["nominal"], content["propellers"]
    nominal["thrust_N"] = [0.6 * coefficient for coefficient in nominal["thrust_N"]]
    nominal["inertia_kg_m2"] *= 0.75
    nominal["motor_time_constant_s"], nominal["transport_delay_s"] = 0.08, 0.0
    for key in ("position_m", "direction_deg"):
        propellers[0][key], propellers[3][key] = propellers[3][key], propellers[0][key]
    propellers[1]["direction_deg"] = (propellers[1]["direction_deg"] + 180) % 360
    return Vehicle.model_validate(content)


def test_a_craft_with_an_inaccurate_file_gets_a_trusted_model(tmp_path):
    twin, said = Twin(TRUTH, QUIET, seed=4), list[str]()
    given = rough()
    found = commission(twin, given, tmp_path, tell=said.append)
    assert found.trusted, found.findings
    assert not twin.contacts
    excitations = [one for one in found.flights if one.name.endswith("excitation")]
    assert len(excitations) >= 2
    # The recorded model is the one that was judged, on a flight that it has not seen.
    model = read_model(tmp_path / "model.toml")
    assert np.array_equal(largest_acceleration(model), largest_acceleration(found.model))
    assert found.study.validation is not None
    true = largest_acceleration(TRUTH)
    assert largest_acceleration(model) == pytest.approx(true, rel=0.15)
    response = model.parameters.motor_time_constant + model.transport_delay
    actual = TRUTH.parameters.motor_time_constant + TRUTH.transport_delay
    assert response == pytest.approx(actual, abs=0.008)
    # The corrected file states the true layout; the given one is untouched.
    corrected = read_vehicle(tmp_path / "vehicle.toml")
    assert [one.direction_deg for one in corrected.propellers] == pytest.approx(
        [one.direction_deg for one in default_vehicle().propellers]
    )
    assert found.given == given == rough()
    assert sum("continuing with a corrected vehicle file" in line for line in said) == 1
    page = commissioning_report(found, tmp_path / "page").read_text("utf-8")
    assert "Shrinking intervals" in page
    assert "airpuck fly" in page and "airpuck race" in page


def test_a_dead_motor_ends_the_run_before_any_excitation(monkeypatch):
    dead = {"motor": "motor_b_1", "start_s": 0.0, "stop_s": 1e4, "share": 0.0}
    twin = Twin(TRUTH, changed(QUIET, motors={"weak": (Weakness(**dead),)}), seed=1)
    monkeypatch.setattr(excitations, "prepare", lambda *_: None)  # compiles for a study
    found = commission(twin, default_vehicle())
    assert found.outcome == "actuator"
    assert found.findings[0].cause == "motor_b_1 gives little or no thrust"
    assert not twin.contacts
    names = [flight.name[3:] for flight in found.flights]
    assert names.count("pulses") == 3 and "excitation" not in names


def on_a_slope(tilt: float, x: float) -> Twin:
    """A twin on a table that slopes along x; one motor does not start for three seconds."""
    late = {"motor": "motor_b_1", "start_s": 0.0, "stop_s": 3.0, "share": 0.0}
    motors, effects = {"weak": (Weakness(**late),)}, {"tilt_rad": (tilt, 0.0)}
    settings = changed(QUIET, motors=motors, effects=effects)
    return Twin(TRUTH, settings, seed=1, pose=(x, 0.0, 0.0))


def test_a_motor_that_failed_to_start_is_retried_after_the_craft_is_back():
    twin = on_a_slope(0.02, 0.35)
    found = commission(twin, default_vehicle(), steps=STEPS[1:3])
    assert [step.step for step in found.steps] == ["rest", "pulses"]
    names = [flight.name[3:] for flight in found.flights]
    assert "return" in names
    again = found.flights[-1].recording["command"].values[:, 2]  # motor_b_1
    assert names[-1] == "pulses" and again.max() > default_vehicle().command_min
    assert not twin.craft.contacts


def test_a_motor_not_tried_because_of_a_slope_is_not_called_dead():
    found = commission(on_a_slope(0.03, 0.5), default_vehicle(), steps=STEPS[1:3])
    assert found.outcome == "table"
    assert found.findings[0].cause == "The table slopes by 31 mrad"
    assert "before motor_a_2 was tried often enough" in found.findings[0].evidence


def test_a_camera_failure_in_flight_ends_the_run_and_keeps_all_data(tmp_path):
    twin = Twin(TRUTH, changed(QUIET, motion_capture={"gaps_s": ((5.9, 1e4),)}), seed=2)
    found = commission(twin, default_vehicle(), tmp_path, steps=STEPS[1:4])
    assert found.outcome == "poses"
    kept = sorted(path.name for path in (tmp_path / "flights").iterdir())
    assert kept == ["01_rest", "02_pulses", "03_hover"]


def test_on_a_slope_the_craft_is_brought_back_between_pulses():
    twin = Twin(TRUTH, changed(QUIET, effects={"tilt_rad": (0.0, 0.02)}), seed=5)
    found = commission(twin, default_vehicle(), steps=STEPS[1:4])
    assert "return" in [flight.name[3:] for flight in found.flights]
    assert [step.step for step in found.steps] == ["rest", "pulses", "hover"]
    assert max((speed for _, speed in twin.craft.contacts), default=0.0) < 0.3


def eight_propellers() -> Vehicle:
    """Propellers along a circle, blowing clockwise and counter-clockwise in turn."""
    content = default_vehicle().model_dump(mode="json")
    one, curve = content["propellers"][0], content["nominal"]["thrust_N"][0]
    angles = 45.0 * np.arange(8)
    content["pairs"], content["nominal"]["thrust_N"] = [], [curve] * 8
    content["propellers"] = [
        one
        | {"name": f"m{k}", "direction_deg": (angle + 90 * (-1) ** k) % 360}
        | {"position_m": [0.06 * np.cos(np.radians(angle)), 0.06 * np.sin(np.radians(angle))]}
        for k, angle in enumerate(angles)
    ]
    return Vehicle.model_validate(content)


def test_an_untried_motor_idles_while_the_others_bring_the_craft_back():
    tilt = TwinSettings(effects={"tilt_rad": (0.0, 0.015)}).effects
    settings, truth = QUIET.model_copy(update={"effects": tilt}), nominal_model(eight_propellers())
    twin = Twin(truth, settings, seed=5, pose=(0.0, -0.2, 0.0))
    found = commission(twin, truth.vehicle, steps=STEPS[1:3])
    ran = {
        flight.name: (flight.recording["command"].values > truth.vehicle.command_min).any(axis=0)
        for flight in found.flights
    }
    assert not ran["02_pulses"].all()
    assert not (ran["03_return"] & ~ran["02_pulses"]).any()
    assert found.steps[-1].step == "pulses"


def test_a_pulse_cut_off_by_a_rail_does_not_count():
    # The first pulse of m1 is complete, the second is not; then the craft is at a rail.
    late = {"motor": "m1", "start_s": 0.0, "stop_s": 2.0, "share": 0.0}
    settings = TwinSettings(motors={"weak": [late]}, effects={"tilt_rad": (0.0, 0.02)})
    truth = nominal_model(eight_propellers())
    found = commission(Twin(truth, settings, seed=3), truth.vehicle, steps=STEPS[1:3])
    assert found.outcome == "table"
    assert found.findings[0].cause == "The table slopes by 20 mrad"


class TooLittle(Work):
    """Studies to which every flight tells too little."""

    said = SimpleNamespace(
        outcome="not_enough_excitation",
        trusted=False,
        response_error=None,
        acceleration_errors=None,
        sentences=("Too little.",),
    )

    def start(self, now, function, *arguments): ...

    def done(self, now):
        return True

    def result(self):
        return SimpleNamespace(model=TRUTH, verdict=self.said, findings=())


def test_excitations_grow_longer_until_they_suffice():
    steps = [Excitations(duration_s=1.0, most=4)]
    found = commission(Twin(TRUTH, QUIET), default_vehicle(), steps=steps, work=TooLittle())
    assert found.outcome == "excitation"
    first, second, third, fourth = (np.ptp(flight.span) for flight in found.flights)
    # Two are needed for the first study.
    assert second == pytest.approx(first, abs=0.02)
    assert third / second == pytest.approx(1.5, rel=0.02)
    assert fourth / third == pytest.approx(1.5, rel=0.02)
