"""The check of motor order and signs against a recording."""

from dataclasses import replace

import numpy as np
import pytest

from airpuck.craft.vehicle import Propeller, Vehicle, default_vehicle
from airpuck.faults.layout_check import check_layout
from airpuck.preprocessing.pipeline import preprocess

from ..conftest import BLUE
from ..synthetic import record


@pytest.fixture(scope="module")
def flight():
    return preprocess(record(duration=10.0, noise=5e-5))


def edited(edit) -> Vehicle:
    """The default vehicle with other propellers: `edit` maps (index, propeller) to a propeller."""
    vehicle = default_vehicle()
    propellers = tuple(edit(k, p) for k, p in enumerate(vehicle.propellers))
    return vehicle.model_copy(update={"propellers": propellers})


def moved(propeller: Propeller, angle: float, mirror: bool = False) -> Propeller:
    x, y = propeller.position_m
    direction = propeller.direction_deg
    if mirror:
        y, direction = -y, -direction
    cos, sin = np.cos(angle), np.sin(angle)
    return propeller.model_copy(
        update={
            "position_m": (cos * x - sin * y, sin * x + cos * y),
            "direction_deg": direction + np.rad2deg(angle),
        }
    )


def test_the_true_layout_agrees(flight):
    check = check_layout(flight, default_vehicle())
    assert check.agrees
    assert not check.remarks
    assert min(p.agreement for p in check.propellers) > 0.97
    # The published M3 is turned by -0.0375 rad against the nominal layout.
    assert check.rotation == pytest.approx(-0.0375, abs=0.01)


def test_a_wrong_sign_is_named(flight):
    def edit(k, propeller):
        turned = {"direction_deg": propeller.direction_deg + 180}
        return propeller.model_copy(update=turned) if k == 2 else propeller

    check = check_layout(flight, edited(edit))
    assert not check.agrees
    wrong = [p for p in check.propellers if p.verdict != "agrees"]
    assert [p.name for p in wrong] == ["motor_b_1"]
    assert wrong[0].agreement < -0.9
    assert "other way" in wrong[0].verdict


@pytest.mark.parametrize(("first", "second"), [(0, 3), (1, 5), (2, 4)])
def test_swapped_motors_are_named(flight, first, second):
    propellers = default_vehicle().propellers
    order = list(range(6))
    order[first], order[second] = second, first
    vehicle = edited(
        lambda k, p: propellers[order[k]].model_copy(update={"name": propellers[k].name})
    )
    check = check_layout(flight, vehicle)
    verdicts = {p.name: p for p in check.propellers if p.verdict != "agrees"}
    assert set(verdicts) == {propellers[first].name, propellers[second].name}
    assert verdicts[propellers[first].name].behaves_like == propellers[second].name


def test_a_turned_layout_is_remarked(flight):
    check = check_layout(flight, edited(lambda _, p: moved(p, np.pi / 2)))
    assert not check.agrees
    assert "turned by -92 degrees" in check.remarks[0]


def test_a_mirrored_layout_is_remarked(flight):
    check = check_layout(flight, edited(lambda _, p: moved(p, 0.0, mirror=True)))
    assert check.mirrored
    assert "mirrored" in check.remarks[0]


def test_mass_thrust_and_inertia_need_not_be_right(flight):
    vehicle = default_vehicle()
    nominal = vehicle.nominal.model_copy(
        update={"thrust_N": (0.0, 2.0), "inertia_kg_m2": 8e-4, "motor_time_constant_s": 0.06}
    )
    rough = vehicle.model_copy(update={"mass_kg": 0.3, "nominal": nominal})
    assert check_layout(flight, rough).agrees


def test_noise_is_not_conclusive(flight):
    rng = np.random.default_rng(0)
    noise = replace(flight, acceleration=rng.normal(size=flight.acceleration.shape))
    check = check_layout(noise, default_vehicle())
    assert not check.conclusive
    assert not check.agrees
    assert "too little" in check.remarks[0]


def test_the_delay_is_found(flight):
    # The one found by correlation need not be right for this check: it looks for its own.
    assert check_layout(flight, default_vehicle()).delay == pytest.approx(5 / 240, abs=1 / 240)


@pytest.mark.data
def test_the_real_craft_agrees_with_its_vehicle_file(experiments):
    from airpuck.recording.read import read_recording

    check = check_layout(preprocess(read_recording(experiments / BLUE / BLUE)), default_vehicle())
    assert check.agrees
    assert min(p.agreement for p in check.propellers) > 0.98
