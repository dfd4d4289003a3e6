"""Learning the puck: against pucks and rails that differ from the table file."""

import numpy as np
import pytest

from airpuck.craft.table import AirHockey, Contact, Puck
from airpuck.physics.puck import PuckState
from airpuck.physics.puck_on_table import PuckOnTable
from airpuck_hockey.puck.puck_filter import PuckFilter, PuckNoise


def learned(true: Puck, bounces: int = 4, learns: bool = True) -> PuckFilter:
    """Show a filter with the default table some flights between the side rails."""
    puck, random = PuckOnTable(AirHockey(puck=true), PuckState(0.0, 0.0)), np.random.default_rng(0)
    found, noise = PuckFilter(AirHockey(), learns=learns), PuckNoise()
    deviations = np.array([noise.position_m, noise.position_m, noise.yaw_rad])
    start = 0.0
    for k in range(bounces):
        puck.run(start)
        puck.place(PuckState(-0.3, 0.0, 0.0, 1.0, (-1) ** k * 2.0, 0.0))
        for time in start + np.arange(1, 130) / 240:
            puck.run(float(time))
            found.pose(float(time), np.array(puck.state[:3]) + random.normal(0.0, deviations))
        start = float(puck.time) + 1.0
    return found


@pytest.mark.parametrize(("restitution", "drag"), [(0.65, 0.1), (0.9, 0.3)])
def test_other_rails_and_drag_are_learned(restitution, drag):
    true = Puck(rail=Contact(restitution=restitution), drag_1_s=drag)
    puck = learned(true).model.equipment.puck
    # The table file counts like one bounce.
    expected = (0.79 + 4 * restitution) / 5
    assert puck.rail.restitution == pytest.approx(expected, abs=0.01)
    assert abs(puck.drag_1_s - drag) < 0.02
    assert puck.standard_error["rail.restitution"] < 0.08
    assert puck.standard_error["drag_1_s"] < 0.02


def test_nothing_is_learned_on_request():
    puck = learned(Puck(rail=Contact(restitution=0.65)), learns=False).model.equipment.puck
    assert puck == Puck()
