"""Reversible propellers, and reaction wheels: vehicle file, drives and speed limit."""

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from airpuck import InputError, named_rung, read_vehicle
from airpuck.craft.vehicle import default_vehicle
from airpuck.craft.wheel import Spinning, Wheel
from airpuck.model.model_file import nominal_model

from ..apparatus.two_way_craft import triangle


def test_each_direction_of_an_actuator_is_a_propeller_of_the_model(tmp_path: Path) -> None:
    vehicle = triangle(tmp_path)
    assert vehicle.columns == ("a", "b", "c", "wheel")
    assert vehicle.propeller_names == (
        "a", "b", "c", "wheel", "a_reverse", "b_reverse", "wheel_reverse",
    )  # fmt: skip
    effects = np.asarray(nominal_model(vehicle).dynamics.configuration)
    np.testing.assert_allclose(effects[:, [4, 5, 6]], -effects[:, [0, 1, 3]], atol=1e-12)
    # A positive command turns the wheel counter-clockwise and the craft against it.
    np.testing.assert_allclose(effects[:, 3], [0, 0, -1 / 0.022])
    full = vehicle.nominal_thrust.sum(axis=1)
    np.testing.assert_allclose(full, [0.4, 0.4, 0.4, 0.02, 0.2, 0.2, 0.02])
    vehicle.save(tmp_path / "again.toml")
    assert read_vehicle(tmp_path / "again.toml") == vehicle


def test_craft_without_reverse_have_no_additional_columns(tmp_path: Path) -> None:
    vehicle = default_vehicle()
    assert vehicle.columns == vehicle.propeller_names
    vehicle.save(tmp_path / "holohover.toml")
    text = (tmp_path / "holohover.toml").read_text()
    assert "reverse" not in text
    assert "wheels" not in text
    drive = np.random.default_rng(0).uniform(size=(5, 6))
    assert vehicle.actuation.split(drive) is vehicle.actuation.joined(drive) is drive


def test_negative_commands_reverse_the_actuator(tmp_path: Path) -> None:
    actuation = triangle(tmp_path).actuation
    command = np.array([[0.5, -0.4, 0.3, -0.2], [-1.0, 1.0, 0.0, 1.0]])
    times, drives = actuation.drive(np.array([0.0, 1.0]), command)
    assert times.tolist() == [0.0, 1.0, pytest.approx(1.0 + 3 * (1 + 0.2 / 3))]
    np.testing.assert_allclose(drives[0], [0.5, 0, 0.3, 0, 0, 0.4, 0.2])
    np.testing.assert_allclose(drives[1], [0, 1, 0, 1, 1, 0, 0])
    np.testing.assert_allclose(drives[2], [0, 1, 0, 0, 1, 0, 0])
    np.testing.assert_allclose(actuation.joined(drives)[:2], command)


@pytest.mark.parametrize("commanded", ["torque", "speed"])
def test_a_wheel_stops_accelerating_at_its_speed_limit(commanded: str) -> None:
    wheel = Wheel(
        name="w", torque_Nm=0.02, inertia_kg_m2=1e-4, max_speed_rad_s=600.0, commanded=commanded
    )
    spinning, rng = Spinning(wheel), np.random.default_rng(1)
    now = speed = drive = 0.0
    for command in rng.uniform(-1, 1, size=300) ** 3:
        step = rng.uniform(0.01, 4.0)
        end = now + step
        changes = [*spinning.changes(now, command), (end, 0.0)]
        for (begin, drive), (stop, _) in pairwise(changes):
            speed += drive * (min(stop, end) - min(begin, end)) * 0.02 / 1e-4 / 600
        assert abs(speed) <= 1 + 1e-9
        if commanded == "speed" and len(changes) > 1 and changes[-2][0] < end:
            assert speed == pytest.approx(command, abs=1e-9)
        now = end


def test_a_fit_learns_one_number_per_direction_of_a_wheel(tmp_path: Path) -> None:
    vehicle = triangle(tmp_path)
    rung = named_rung("M3")
    start = rung.initial(vehicle)
    free = dict(zip(start.labels(vehicle.propeller_names), rung.mask(start, vehicle), strict=True))
    assert free["thrust wheel φ^1"]
    assert not free["thrust wheel φ^2"]
    # No propeller has a lever arm: the wheel's torque and the inertia cannot be separated.
    assert not free["inertia"]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("reverse = 0.5", "reverse = 0.0", "propellers.0.reverse"),
        ('name = "wheel"', 'name = "a"', "same name"),
        ("max_speed_rad_s = 600.0", 'commanded = "angle"', "wheels.0"),
        ("[nominal]", '[actuators]\nkind = "on_off"\n[nominal]', "no reverse"),
        ("propellers = [", 'pairs = [["a", "b"]]\npropellers = [', "needs no partner"),
    ],
)
def test_errors_name_the_field(old: str, new: str, message: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=message):
        triangle(tmp_path, **{old: new})


def test_a_vehicle_lists_its_kinds_of_actuators(tmp_path: Path) -> None:
    assert default_vehicle().actuation.kinds == ("propeller",)
    kinds = triangle(tmp_path).actuation.kinds
    assert kinds == ("propeller", "reversible propeller", "reaction wheel")
