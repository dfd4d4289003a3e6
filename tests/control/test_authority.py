"""The motions that propellers can produce together, against hand calculations."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import nnls

from airpuck.control.authority import MOTIONS, control_authority, weakest_effort
from airpuck.craft.vehicle import Vehicle, default_vehicle
from airpuck.model.model_file import nominal_model


def craft(*propellers, lowest=0.0) -> Vehicle:
    """A craft of 0.2 kg and 4e-4 kg m² with propellers (x [m], y [m], degrees) of 1 N."""
    return Vehicle.model_validate(
        {
            "name": "craft",
            "mass_kg": 0.2,
            "radius_m": 0.08,
            "command_min": lowest,
            "propellers": [
                {"name": f"p{k}", "position_m": (x, y), "direction_deg": angle}
                for k, (x, y, angle) in enumerate(propellers)
            ],
            "nominal": {"thrust_N": (0.0, 1.0), "inertia_kg_m2": 4e-4},
        }
    )


CORNERS = ((0.05, 0.05, 315), (0.05, -0.05, 45), (-0.05, 0.05, 225), (-0.05, -0.05, 135))


def test_a_square_craft_matches_a_hand_calculation():
    # The lowest command, 0.1, gives 0.01 N. Forward the two in front push at 45°, the two behind
    # push back as little as they can; turning, two push at an arm of 0.05 √2 m, two against them.
    found = control_authority(nominal_model(craft(*CORNERS, lowest=0.1)))
    push = 2 * (1 - 0.01) * np.sqrt(0.5) / 0.2
    turn = 2 * (1 - 0.01) * 0.05 * np.sqrt(2) / 4e-4
    expected = dict.fromkeys(MOTIONS, push) | {"turn left": turn, "turn right": turn}
    assert found.alone == pytest.approx(expected)
    assert found.together == pytest.approx(expected)
    assert not found.missing
    assert not found.sentences


def test_a_push_to_the_right_does_not_count_as_one_to_the_left():
    found = control_authority(nominal_model(craft((0, 0.05, 270), (0, -0.05, 270))))
    assert found.alone["right"] == pytest.approx(2 / 0.2)
    assert found.together["left"] == 0


@pytest.mark.parametrize("seed", range(6))
def test_the_weakest_direction_is_the_minimum_over_many_directions(seed):
    rng = np.random.default_rng(seed)
    # Most pushes point one way, so that opposite directions differ.
    angles = rng.normal(60 * seed, 90, 6)
    places = rng.uniform(-0.06, 0.06, (6, 2))
    model = nominal_model(craft(*np.column_stack([places, angles]).tolist()))
    each = model.propeller_effects * model.dynamics.thrust.sum(axis=1)
    directions = rng.standard_normal((100_000, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    least = np.maximum(directions @ each, 0).sum(axis=1).min()
    strongest = np.linalg.norm(each, axis=0).max()
    assert -1e-9 <= least - weakest_effort(model) < 0.03 * strongest


def test_propellers_that_all_turn_one_way_are_reported():
    found = control_authority(
        nominal_model(craft((0.05, 0, 90), (0, 0.05, 180), (-0.05, 0, 270), (0, -0.05, 0)))
    )
    assert found.alone["turn left"] == pytest.approx(4 * 0.05 / 4e-4)
    assert found.missing == ("forward", "back", "left", "right", "turn right")
    assert found.sentences == (
        "no propeller turns it right (clockwise)",
        "not without another motion: forward, back, left, right",
    )


def test_two_opposed_propellers_push_along_one_line_only():
    found = control_authority(nominal_model(craft((0.05, 0, 180), (-0.05, 0, 0))))
    assert found.alone["forward"] == pytest.approx(1 / 0.2)
    assert found.alone["back"] == pytest.approx(1 / 0.2)
    assert found.missing == ("left", "right", "turn left", "turn right")
    assert "no propeller pushes it to the left" in found.sentences


def test_idle_thrusts_that_cannot_cancel_are_reported():
    found = control_authority(nominal_model(craft((0.05, 0, 0), (-0.05, 0, 0), lowest=0.1)))
    assert found.alone["forward"] == pytest.approx(2 / 0.2)
    assert "no propeller pushes it back" in found.sentences


@pytest.mark.parametrize("seed", range(20))
def test_missing_motions_are_those_outside_the_positive_span(seed):
    """Without a lowest command: whether nonnegative least squares reaches a motion."""
    rng = np.random.default_rng(seed)
    places = [(*rng.uniform(-0.07, 0.07, 2), rng.uniform(0, 360)) for _ in range(3 + seed % 4)]
    model = nominal_model(craft(*places))
    rows = np.array([1.0, 1.0, 0.03])[:, None]
    missing = []
    for name, (row, sign, _) in MOTIONS.items():
        wanted = sign * np.eye(3)[row]
        if nnls(rows * np.asarray(model.dynamics.configuration), wanted)[1] > 1e-6:
            missing.append(name)
    assert control_authority(model).missing == tuple(missing)


def test_the_papers_craft_is_equally_strong_to_both_sides():
    found = control_authority(nominal_model(default_vehicle()))
    assert not found.missing
    for one, other in (("left", "right"), ("turn left", "turn right")):
        assert found.alone[one] == pytest.approx(found.alone[other], rel=1e-6)
    # Twice the mass, half the accelerations.
    model = nominal_model(default_vehicle())
    heavy = replace(model, vehicle=model.vehicle.model_copy(update={"mass_kg": 2 * 0.1377}))
    assert control_authority(heavy).alone["left"] == pytest.approx(found.alone["left"] / 2)
