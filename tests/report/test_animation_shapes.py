"""Shapes of an animation: arrows along thrusts, propellers, names."""

import numpy as np
import pytest

from airpuck.craft.vehicle import Vehicle
from airpuck.report.animation_shapes import (
    arrow_shapes,
    propeller_size,
    round_thrust,
    short_names,
    thrust_arrows,
)

from .conftest import VEHICLES, four_propellers
from .flights import CRAFT


@pytest.mark.parametrize("yaw", [0.0, 0.7, -2.5, 9.0])
@pytest.mark.parametrize("name", VEHICLES)
def test_an_arrow_points_where_its_propeller_pushes(name, yaw):
    vehicle = VEHICLES[name]()
    for i, propeller in enumerate(vehicle.propellers):
        command = np.zeros((1, vehicle.n_propellers))
        command[0, i] = 0.8
        start, tip = thrust_arrows(vehicle, np.array([[0.3, -0.2, yaw]]), command)[0, i]
        angle = np.deg2rad(propeller.direction_deg) + yaw
        along = tip - start
        np.testing.assert_allclose(
            along / np.hypot(*along), [np.cos(angle), np.sin(angle)], atol=1e-12
        )
        x, y = propeller.position_m
        place = [
            0.3 + np.cos(yaw) * x - np.sin(yaw) * y,
            -0.2 + np.sin(yaw) * x + np.cos(yaw) * y,
        ]
        np.testing.assert_allclose(start, place, atol=1e-12)
        others = np.delete(thrust_arrows(vehicle, np.zeros((1, 3)), command)[0], i, axis=0)
        np.testing.assert_array_equal(others[:, 0], others[:, 1])


def test_arrows_are_as_long_as_thrust_is_large():
    command = np.tile([[0.2], [0.4], [1.0]], 6)
    arrows = thrust_arrows(CRAFT, np.zeros((3, 3)), command)
    length = np.hypot(*(arrows[:, 0, 1] - arrows[:, 0, 0]).T)
    a, b, c = CRAFT.nominal_thrust[0]
    force = [a * u + b * u**2 + c * u**3 for u in (0.2, 0.4, 1.0)]
    np.testing.assert_allclose(length / length[2], np.array(force) / force[2])
    assert 0.1 < length[2] < 0.5  # visible, and on the table


def test_an_outline_ends_at_the_tip_whatever_the_length():
    arrows = np.array([[[0.0, 0.0], [0.3, 0.4]], [[1.0, 1.0], [1.0, 1.001]], [[2.0, 2.0]] * 2])
    shapes = arrow_shapes(arrows, 0.07)
    np.testing.assert_allclose(shapes[:, 3], arrows[:, 1], atol=1e-12)
    np.testing.assert_allclose((shapes[:, 0] + shapes[:, 6]) / 2, arrows[:, 0], atol=1e-12)
    assert np.isfinite(shapes).all()


def test_propellers_do_not_overlap_and_a_single_one_is_drawn():
    for vehicle in (CRAFT, four_propellers()):
        x, y = vehicle.positions.T
        apart = np.hypot(x[:, None] - x, y[:, None] - y)[np.triu_indices(len(x), 1)]
        assert 0 < 2 * propeller_size(vehicle) < apart.min()
    one = CRAFT.model_copy(update={"propellers": CRAFT.propellers[:1], "pairs": ()})
    assert 0 < propeller_size(one) < one.radius_m


def test_names_in_pictures_are_short():
    assert short_names(("motor_a_1", "motor_a_2", "motor_b_1")) == ["a 1", "a 2", "b 1"]
    assert short_names(("front", "left")) == ["front", "left"]
    assert short_names(("m_1",)) == ["m 1"]
    assert short_names(("m_a", "m")) == ["m a", "m"]


def test_the_thrust_of_the_key_is_round():
    assert round_thrust(CRAFT) == pytest.approx(0.2)  # 0.644 N at full command
    fields = CRAFT.model_dump()
    strong = Vehicle.model_validate(
        fields | {"nominal": fields["nominal"] | {"thrust_N": (110.0,)}}
    )
    assert round_thrust(strong) == pytest.approx(50)
