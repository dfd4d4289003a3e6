"""Vehicle files."""

import numpy as np
import pytest

from airpuck import InputError, Vehicle
from airpuck.craft.vehicle import default_vehicle, match_columns, read_vehicle, unnamed_columns

from ..apparatus.changes import with_propellers

QUAD = """
name = "quad"
mass_kg = 0.2
pairs = [["left", "right"]]

[[propellers]]
name = "left"
position_m = [0.0, 0.05]
direction_deg = 0.0

[[propellers]]
name = "right"
position_m = [0.0, -0.05]
direction_deg = 180.0

[nominal]
thrust_N = [[0.1, 0.5], [0.2, 0.6]]
inertia_kg_m2 = 4e-4
"""


@pytest.fixture
def quad(tmp_path):
    path = tmp_path / "quad.toml"
    path.write_text(QUAD)
    return path


def test_the_default_is_the_papers_hovercraft():
    vehicle = default_vehicle()
    # Geometry of the paper: 46.5 mm from the centre, 18.8 degrees beside 0, 120, 240 degrees.
    radius = np.linalg.norm(vehicle.positions, axis=1)
    np.testing.assert_allclose(radius, 0.046532, rtol=1e-9)
    azimuth = np.rad2deg(np.arctan2(vehicle.positions[:, 1], vehicle.positions[:, 0])) % 360
    expected = [-18.8, 18.8, 101.2, 138.8, 221.2, 258.8]
    np.testing.assert_allclose(azimuth, np.mod(expected, 360), atol=0.01)
    # The two of a pair push in opposite directions, across the radius of the pair.
    first, second = vehicle.directions[::2], vehicle.directions[1::2]
    np.testing.assert_allclose(first, -second, atol=1e-12)
    middle = vehicle.positions[::2] + vehicle.positions[1::2]
    np.testing.assert_allclose(np.sum(middle * first, axis=1), 0, atol=1e-9)


def test_any_number_of_propellers_is_accepted(quad):
    vehicle = read_vehicle(quad)
    assert vehicle.n_propellers == 2
    assert vehicle.pair_indices == ((0, 1),)
    np.testing.assert_array_equal(vehicle.nominal_thrust, [[0.1, 0.5], [0.2, 0.6]])


def test_a_vehicle_file_round_trips(quad, tmp_path):
    vehicle = read_vehicle(quad)
    vehicle.save(tmp_path / "copy.toml")
    assert read_vehicle(tmp_path / "copy.toml") == vehicle


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("mass_kg = 0.2", "mass_kg = -0.2", "mass_kg"),
        ("mass_kg = 0.2", "mass_g = 200.0", "mass_kg|mass_g"),
        ('name = "right"', 'name = "left"', "same name, 'left'"),
        ('["left", "right"]', '["left", "left"]', "pairs: 'left' can be in one pair only"),
        ('["left", "right"]', '["left", "middle"]', "unknown propeller 'middle'"),
        ("[0.1, 0.5], [0.2, 0.6]", "[0.1, 0.5], [0.2]", "equal numbers of coefficients"),
        ("[0.1, 0.5], [0.2, 0.6]", "[0.1, 0.5]", "1 curves for 2 propellers"),
        ("position_m = [0.0, 0.05]", "position_m = [0.0]", "position_m"),
        ("direction_deg = 0.0", "direction_deg = inf", "direction_deg"),
        ("[0.0, 0.05]", "[0.0, 50.0]", r"propellers.0.position_m = .*: millimetres\?"),
        ("[0.0, 0.05]", "[0.0, 5.0]", r"propellers.0.position_m = .*: centimetres\?"),
        ("mass_kg = 0.2", "mass_kg = 200.0", r"mass_kg = 200 .*: grams\?"),
        ("mass_kg = 0.2", "mass_kg = 0.2\nradius_m = 70.0", r"radius_m = 70 .*: millimetres\?"),
        ("= 4e-4", "= 4e3", r"inertia_kg_m2 = 4000 .*: g cm²\?"),
        ("= 4e-4", "= 400.0", r"inertia_kg_m2 = 400 .*: kg mm²\?"),
        ("= 4e-4", "= 4.0", r"inertia_kg_m2 = 4 .*: kg cm²\?"),
        ("[0.1, 0.5], [0.2, 0.6]", "[0.0, 60.0], [0.0, 60.0]", r"60 at full .*: gram-force\?"),
        ("[[0.1, 0.5], [0.2, 0.6]]", "0.6", r"nominal.thrust_N: must be a list in brackets"),
        ("[nominal]", "[nominal]\ntransport_delay_s = 20", r"_delay_s = 20 .*: milliseconds\?"),
        ("[nominal]", "[nominal]\nmotor_time_constant_s = 30", r"_s = 30 .*: milliseconds\?"),
    ],
)
def test_invalid_fields_are_named(quad, old, new, message):
    assert old in QUAD
    quad.write_text(QUAD.replace(old, new, 1))
    with pytest.raises(InputError, match=message) as error:
        read_vehicle(quad)
    assert str(quad) in str(error.value)


def test_columns_are_matched_by_name():
    vehicle = default_vehicle()
    assert match_columns(vehicle, vehicle.propeller_names[::-1], source="x") == [5, 4, 3, 2, 1, 0]


@pytest.mark.parametrize("columns", [("motor_a_1",), ("a", "b", "c", "d", "e", "f")])
def test_unknown_motors_are_rejected(columns):
    with pytest.raises(InputError, match="motor_a_1"):
        match_columns(default_vehicle(), columns, source="bag")


def test_vehicles_are_comparable_and_hashable():
    assert default_vehicle() == default_vehicle()
    assert isinstance(hash(default_vehicle()), int)
    assert Vehicle.model_validate(default_vehicle().model_dump()) == default_vehicle()
    used = default_vehicle()
    assert used.directions.shape == used.positions.shape == (6, 2)
    assert used == default_vehicle()
    assert used != used.model_copy(update={"mass_kg": 0.2})
    assert hash(used) == hash(default_vehicle())


def test_unnamed_columns_follow_the_order_of_the_vehicle():
    vehicle = default_vehicle()
    assert match_columns(vehicle, unnamed_columns(6), source="x") == [0, 1, 2, 3, 4, 5]
    renamed = with_propellers(vehicle, lambda k, _: {"name": unnamed_columns(6)[5 - k]})
    assert match_columns(renamed, unnamed_columns(6), source="x") == [5, 4, 3, 2, 1, 0]
    with pytest.raises(InputError, match=r"has 4 motors.*--vehicle"):
        match_columns(vehicle, unnamed_columns(4), source="x")


def test_copies_have_their_own_propeller_positions():
    vehicle = default_vehicle()
    positions, directions = vehicle.positions, vehicle.directions
    turned = vehicle.model_copy(update={"propellers": vehicle.propellers[::-1]})
    np.testing.assert_array_equal(turned.positions, positions[::-1])
    np.testing.assert_array_equal(turned.directions, directions[::-1])
    assert vehicle.positions is positions


def test_a_layout_in_millimetres_is_recognised(quad):
    text = QUAD.replace("mass_kg = 0.2", "mass_kg = 0.2\nradius_m = 80.0")
    quad.write_text(text.replace("0.05]", "50.0]"))
    with pytest.raises(InputError, match=r"radius_m = 80 .*: millimetres\?"):
        read_vehicle(quad)
