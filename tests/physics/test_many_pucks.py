"""Many pucks at once move like each of them on a table alone."""

import numpy as np
import pytest

from airpuck.craft.table import AirHockey, Contact, Puck, Table
from airpuck.physics.puck import PuckState
from airpuck.physics.puck_on_table import PuckOnTable, puck_paths

PLAY = AirHockey()


def own(play):
    puck = play.puck
    return np.array([puck.drag_1_s, puck.spin_drag_1_s, puck.rail.restitution, puck.rail.grip])


def with_numbers(play, drag, spin_drag, restitution, grip):
    rail = play.puck.rail.model_copy(update={"restitution": restitution, "grip": grip})
    changed = {"drag_1_s": drag, "spin_drag_1_s": spin_drag, "rail": rail}
    return play.model_copy(update={"puck": play.puck.model_copy(update=changed)})


def states_of(random, play, count, fastest=5.0):
    """Draw pucks all over the table: some meet posts and goals."""
    half = play.table.length_m / 2, play.table.width_m / 2
    place = random.uniform(-1, 1, (count, 2)) * half
    speed = random.uniform(-fastest, fastest, (count, 2))
    return np.column_stack([place, np.zeros(count), speed, random.uniform(-30, 30, count)])


@pytest.mark.parametrize(
    "play",
    [
        PLAY,
        AirHockey(puck=Puck(drag_1_s=0.0, spin_drag_1_s=0.0)),
        AirHockey(table=Table(length_m=1.0, width_m=0.6, goal_width_m=0.3)),
    ],
    ids=["default", "no drag", "small"],
)
def test_many_pucks_move_like_single_ones(play):
    random, after = np.random.default_rng(4), np.linspace(0.1, 1.6, 7)
    states = states_of(random, play, 60)
    numbers = np.clip(own(play) * random.uniform(0.7, 1.2, (60, 4)), 0.0, 1.0)
    found, goals, posts = puck_paths(play, states, numbers, after), 0, 0
    for state, given, path in zip(states, numbers, found, strict=True):
        puck = PuckOnTable(with_numbers(play, *given.tolist()), PuckState(*state))
        for time, row in zip(after.tolist(), path, strict=True):
            puck.run(time)
            np.testing.assert_allclose(row, puck.state, atol=1e-6)
        goals += puck.goal != 0
        posts += any(touch.met == "post" for touch in puck.touches)
    assert goals > 2
    assert posts > 2


def test_a_resting_puck_stays_and_no_times_give_no_states():
    state, numbers = np.array([[0.1, 0.2, 0.3, 0.0, 0.0, 0.0]]), own(PLAY)[None]
    np.testing.assert_allclose(
        puck_paths(PLAY, state, numbers, np.array([0.0, 9.0]))[0], [state[0]] * 2
    )
    assert puck_paths(PLAY, state, numbers, np.zeros(0)).shape == (1, 0, 6)


def test_a_wedged_puck_stops_soon():
    # Perfectly elastic posts that leave a gap barely wider than the puck.
    puck = Puck(drag_1_s=0.0, spin_drag_1_s=0.0, rail=Contact(restitution=1.0, grip=0.0))
    table = Table(goal_width_m=2 * puck.radius_m + 1e-6)
    play = AirHockey.model_construct(table=table, puck=puck)
    state = np.array([[table.length_m / 2, 0.0, 0.0, 0.0, 5.0, 0.0]])
    path = puck_paths(play, state, own(play)[None], np.array([1.0]))
    assert path[0, 0, 4] == 0.0
