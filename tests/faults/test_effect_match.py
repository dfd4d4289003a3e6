"""Orders, signs and turns of effects that were put in are found."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from airpuck.faults.layout_check import match_effects, rotation, turned
from airpuck.model.model_file import published_model
from airpuck.physics.rigid_body import acceleration_map

from ..apparatus.examples import examples

MODEL = published_model("M3")
EFFECTS = acceleration_map(np, MODEL.dynamics, 0.0, 0.0)[0] * np.array([[1], [1], [0.04]])


@examples(60)
@given(
    order=st.permutations(range(6)),
    signs=st.lists(st.sampled_from([1, -1]), min_size=6, max_size=6),
    seed=st.integers(0, 1000),
)
def test_any_order_and_sign_is_found_where_effects_differ(order, signs, seed):
    """Six effects no two of which are parallel: an octahedron's axes, turned, would be."""
    rng = np.random.default_rng(seed)
    fixed = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1], [1, -1, 0], [-1, 0.2, 1]]).T
    seen = np.array(signs) * fixed[:, list(order)] * rng.uniform(0.5, 2, 6)
    found = match_effects(seen, fixed, np.arange(6))
    assert {k: (m.acts_as, m.sign) for k, m in found.items()} == {
        k: (order[k], signs[k]) for k in range(6)
    }


def test_an_effect_like_none_is_said_to_be():
    seen = EFFECTS.copy()
    seen[:, 2] = turned(seen[:, 2:3], np.deg2rad(60))[:, 0]
    found = match_effects(seen, EFFECTS, np.arange(6))
    assert found[2].acts_as is None
    assert [found[k].acts_as for k in (0, 1, 3, 4, 5)] == [0, 1, 3, 4, 5]


@pytest.mark.parametrize("angle", [-2.5, 0.0, 1.0])
def test_a_rotation_is_found(angle):
    assert rotation(turned(EFFECTS, angle), EFFECTS) == pytest.approx(angle)
