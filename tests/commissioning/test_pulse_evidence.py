"""A vehicle file set right by effects that are computed from the true layout."""

import numpy as np
import pytest

from airpuck.commissioning.pulse_evidence import corrected, layout_findings, matched, measured
from airpuck.craft.vehicle import Vehicle, default_vehicle
from airpuck.model.model_file import nominal_model
from airpuck.physics.rigid_body import acceleration_map, turned

from ..apparatus.changes import with_propellers
from ..apparatus.models import VEHICLES


def effects(vehicle: Vehicle) -> np.ndarray:
    """Accelerations per newton of each propeller."""
    return np.asarray(acceleration_map(np, nominal_model(vehicle).dynamics, 0.0, 0.0)[0])


def stated(vehicle: Vehicle, order: list[int], turned: int | None = None) -> Vehicle:
    """A file that states the propellers' places in another order, and one the wrong way round."""

    def place(k: int, _) -> dict:
        there = vehicle.propellers[order[k]]
        direction = (there.direction_deg + 180 * (k == turned)) % 360
        return there.model_dump(exclude={"name"}) | {"direction_deg": direction}

    return with_propellers(vehicle, place).model_copy(update={"pairs": ()})


@pytest.mark.parametrize("name", VEHICLES)
def test_swapped_and_reversed_motors_are_identified(name):
    true = VEHICLES[name]()
    n = len(true.propellers)
    wrong = stated(true, [2, 1, 0, *range(3, n)], turned=1)
    matches = matched(nominal_model(wrong), effects(true))
    right = corrected(wrong, matches)
    assert effects(right) == pytest.approx(effects(true), abs=1e-9)
    causes = [finding.cause for finding in layout_findings(wrong, matches)]
    assert len(causes) == 3
    if name == "four":  # of the paper's craft, a turned motor acts exactly like its partner
        assert causes == [
            "front acts like back",
            "left pushes the other way",
            "back acts like front",
        ]


#: Channels of four propellers that push both ways: forwards, then backwards.
ALL, EACH_ONCE, BACKWARDS = range(8), (0, 5, 6, 3), (4, 5, 6, 7)


@pytest.mark.parametrize("tried", [ALL, EACH_ONCE, BACKWARDS])
def test_two_way_propellers_are_identified(tried):
    one_way = VEHICLES["four"]().model_copy(update={"pairs": ()})
    true = with_propellers(one_way, lambda k, _: {"reverse": 0.5 + 0.1 * k})
    wrong = stated(true, [1, 0, 2, 3], turned=2)
    seen = np.full((3, 8), np.nan)
    seen[:, tried] = effects(true)[:, tried]
    matches = matched(nominal_model(wrong), seen)
    right = corrected(wrong, matches)
    assert effects(right) == pytest.approx(effects(true), abs=1e-9)
    assert [one.reverse for one in right.propellers] == [0.5, 0.6, 0.7, 0.8]
    causes = sorted(finding.cause for finding in layout_findings(wrong, matches))
    swapped = "front acts like left", "left acts like front"
    assert causes == ["back pushes the other way", *swapped]


EXCHANGED, CIRCLE = [3, 1, 2, 0, 4, 5], [2, 1, 4, 3, 0, 5]


@pytest.mark.parametrize(
    ("order", "tried"),
    [*((EXCHANGED, t) for t in ((0,), (0, 1), (1, 3), (0, 1, 3, 4, 5))), (CIRCLE, (0, 1, 4, 5))],
)
def test_an_untried_motor_is_identified_by_elimination(order, tried):
    true = default_vehicle()
    wrong = stated(true, order)
    seen = np.full((3, 6), np.nan)
    seen[:, tried] = effects(true)[:, tried]
    right = corrected(wrong, matched(nominal_model(wrong), seen))
    assert effects(right) == pytest.approx(effects(true), abs=1e-9)


def test_pairs_follow_their_motors():
    wrong = default_vehicle()
    # The true craft has the sockets of the first two pairs' first motors exchanged.
    true = stated(wrong, [2, 1, 0, 3, 4, 5])
    right = corrected(wrong, matched(nominal_model(wrong), effects(true)))
    a1, a2, b1, b2, *_ = wrong.propeller_names
    assert right.pairs[:2] == ((b1, a2), (a1, b2))
    for one, other in right.pair_indices:
        pushes = effects(true)[:, [one, other]]
        assert pushes[:2, 0] == pytest.approx(-pushes[:2, 1], abs=1e-6)


@pytest.mark.parametrize("name", VEHICLES)
@pytest.mark.parametrize("inertia", [0.4, 2.4])
def test_a_wrong_inertia_does_not_prevent_identifying_motors(name, inertia):
    vehicle = VEHICLES[name]()
    model, seen = nominal_model(vehicle), effects(vehicle)
    # As noise of a pulse might turn a push, on top.
    seen[:2] = turned(np, seen[:2].T, 0.35).T
    seen[2] /= inertia
    assert all(match.acts_as == k for k, match in matched(model, seen).items())


def test_a_correct_file_is_unchanged():
    vehicle = default_vehicle()
    assert corrected(vehicle, matched(nominal_model(vehicle), effects(vehicle))) == vehicle


def test_pulses_determine_thrusts_and_inertia_relative_to_the_mass():
    rough, thrusts = default_vehicle(), np.array([0.6, 1.8, 1.1, 0.9, 1.4, 0.7])
    seen = effects(rough) * thrusts
    seen[2] /= 1.3
    found = measured(nominal_model(rough), seen, 0.05)
    assert found.nominal_thrust == pytest.approx(thrusts[:, None] * rough.nominal_thrust)
    assert found.nominal.inertia_kg_m2 == pytest.approx(1.3 * rough.nominal.inertia_kg_m2)
    assert found.nominal.transport_delay_s == 0.05


def test_reverse_pulses_estimate_a_forward_thrust_that_was_not_tried():
    one_way = VEHICLES["four"]().model_copy(update={"pairs": ()})
    rough = with_propellers(one_way, lambda *_: {"reverse": 0.6})
    seen = effects(rough) * [0.5, np.nan, 1.0, 1.2, 0.7, 0.4, 1.1, np.nan]
    found = measured(nominal_model(rough), seen, 0.05)
    strength = np.array([0.5, 0.4, 1.0, 1.2])[:, None]
    assert found.nominal_thrust[:4] == pytest.approx(strength * rough.nominal_thrust[:4])
