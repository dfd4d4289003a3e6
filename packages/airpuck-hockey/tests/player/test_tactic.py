"""Constants of a game: sizes and positions."""

import numpy as np
import pytest

from apparatus.situations import MODEL, PITCH, PLAY


def test_a_place_is_inside_if_both_coordinates_are():
    (left, bottom), (right, top) = PITCH.fence
    x, y = (left + right) / 2, (bottom + top) / 2
    places = np.array([[x, y], [left - 1, y], [right + 1, y], [x, bottom - 1], [x, top + 1]])
    assert PITCH.inside(places).tolist() == [True, False, False, False, False]
    clipped = PITCH.clipped(places)
    np.testing.assert_allclose(clipped, [[x, y], [left, y], [right, y], [x, bottom], [x, top]])


def test_sizes_match_a_hand_calculation():
    puck = PLAY.puck
    assert PITCH.contact_distance == MODEL.vehicle.radius_m + puck.radius_m
    assert PITCH.goal_line == PLAY.table.length_m / 2
    # A puck of mass m with closing speed 1 and restitution e changes a free craft by this.
    mass = MODEL.vehicle.mass_kg
    impulse = (1 + puck.craft.restitution) / (1 / mass + 1 / puck.mass_kg)
    assert PITCH.recoil == pytest.approx(impulse / mass)
