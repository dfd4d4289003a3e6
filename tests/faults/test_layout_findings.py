"""What a check of the layout says, and the signs of axes that it finds."""

import math
from dataclasses import replace

import numpy as np
import pytest

from airpuck.faults.layout_findings import AxisSigns, LayoutCheck, find_axis_signs, layout_findings
from airpuck.model.model_file import published_model
from airpuck.physics.rigid_body import to_body

from ..apparatus.synthetic_flights import fly


def check(rotation: float = 0.0, signs: AxisSigns | None = None, **given) -> LayoutCheck:
    return LayoutCheck((), 0.9, 1e-9, 0.02, rotation, signs or AxisSigns(), **given)


def test_a_layout_rotated_by_half_a_turn_may_instead_have_two_flipped_axes():
    turned, flipped = layout_findings(check(math.pi - 0.1))
    assert turned.kind == "axes" and "turned by 174 degrees" in turned.cause
    assert flipped.kind == "signs"
    assert flipped.cause == "Or the x axis and the y axis are flipped: count the wrong way"
    assert flipped.remedy.endswith('axes = ["-x", "-y", "z"]')
    assert [one.kind for one in layout_findings(check(2.0))] == ["axes"]


def test_a_flipped_axis_is_named_with_the_line_to_write():
    (found,) = layout_findings(check(signs=AxisSigns(y=-1), axes=("x", "-y", "z")))
    assert found.cause == "The y axis is flipped: counts the wrong way"
    assert found.remedy.endswith('axes = ["x", "y", "z"]')


@pytest.fixture(scope="module")
def motion():
    """A flight, and the body accelerations that explain it; moments are small numbers."""
    flight = fly(published_model("M3"), duration=4.0)
    scale = np.array([1.0, 1.0, 1e-3])
    flight = replace(flight, acceleration=flight.acceleration * scale)
    return flight, to_body(flight.acceleration, flight.state[:, 2]).T


@pytest.mark.parametrize(
    "signs",
    [AxisSigns(), AxisSigns(x=-1), AxisSigns(y=-1), AxisSigns(yaw=-1), AxisSigns(x=-1, yaw=-1)],
)
def test_flipped_axes_are_detected(motion, signs):
    """x and y flipped together look like a rigid body turned by half: not tested here."""
    flight, modelled = motion
    assert find_axis_signs(signs.undone(flight), modelled, 0.0) == signs


def test_one_flipped_axis_on_a_rotated_body_is_not_two_others(motion):
    flight, modelled = motion
    angle = math.pi - 1.0
    turned = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    forces = np.concatenate([turned @ modelled[:2], modelled[2:]])
    assert find_axis_signs(AxisSigns(y=-1).undone(flight), forces, 0.0) == AxisSigns(y=-1)


def test_axes_are_kept_if_flips_explain_little_more(motion):
    flight, _ = motion
    noise = np.random.default_rng(0).normal(size=(3, len(flight)))
    assert find_axis_signs(flight, noise, 0.0) == AxisSigns()
