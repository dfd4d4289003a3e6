"""A puck among rails, goals and discs: closed forms, conservation, and random games."""

import itertools
import math

import numpy as np
import pymunk
import pytest
from hypothesis import given
from hypothesis import strategies as st

from airpuck.craft.table import AirHockey, Contact, Puck, Table
from airpuck.physics.puck import PuckState
from airpuck.physics.puck_on_table import MOST, RESTING, Moving, PuckOnTable

from ..apparatus.examples import examples
from ..apparatus.studies import study

CLOSED = Table(length_m=2.0, width_m=1.0, goal_width_m=1e-9)
ELASTIC = Contact(restitution=1.0, grip=0.0)
FREE = Puck(drag_1_s=0.0, spin_drag_1_s=0.0, rail=ELASTIC, mallet=ELASTIC, craft=ELASTIC)
#: Not checked: no puck fits through its goals.
BILLIARD = AirHockey.model_construct(table=CLOSED, puck=FREE)
PLAY = AirHockey()
R = FREE.radius_m


def craft(x, y, vx=0.0, vy=0.0, duration=1.0, **more):
    to = {"to_x": x + vx * duration, "to_y": y + vy * duration}
    return Moving(x, y, vx, vy, 0.0, 0.07, 0.14, 3e-4, kind="craft", **to, **more)


def mallet(x, y, vx=0.0, vy=0.0, duration=1.0):
    return Moving(
        x, y, vx, vy, radius=0.05, to_x=x + vx * duration, to_y=y + vy * duration, kind="mallet"
    )


def kinetic(puck, state):
    speed = state.vx**2 + state.vy**2
    return puck.mass_kg / 2 * speed + puck.inertia / 2 * state.spin**2


def folded(way, reach):
    """Fold a straight path into ±reach, by mirrors at both ends."""
    phase = (way + reach) % (4 * reach)
    return min(phase, 4 * reach - phase) - reach


@pytest.mark.parametrize("velocity", [(3.0, 2.0), (-97.0, 41.0), (0.3, -8.0)])
def test_between_mirrors_a_puck_follows_the_unfolded_path(velocity):
    vx, vy = velocity
    puck = PuckOnTable(BILLIARD, PuckState(0.1, -0.2, 0.0, vx, vy, 3.0))
    for k in range(1, 200):
        puck.run(0.05 * k)
        if puck.goal:
            break
        t, (x, y) = 0.05 * k, CLOSED.reach(R)
        assert puck.state.x == pytest.approx(folded(0.1 + vx * t, x), abs=1e-9)
        assert puck.state.y == pytest.approx(folded(-0.2 + vy * t, y), abs=1e-9)
        assert math.hypot(puck.state.vx, puck.state.vy) == pytest.approx(math.hypot(vx, vy))
    assert len(puck.touches) > 2


def test_with_drag_the_first_bounce_time_has_a_closed_form():
    puck = PuckOnTable(PLAY, PuckState(0.0, 0.3, 0.0, 1.5, 0.0))
    puck.run(2.0)
    x = PLAY.table.reach(PLAY.puck.radius_m)[0]
    assert puck.touches[0].time == pytest.approx(-math.log(1 - 0.2 * x / 1.5) / 0.2, rel=1e-12)
    # From there it returns with 0.79 of its speed v exp(-k t) = v - k x.
    assert puck.state.vx == pytest.approx(
        -0.79 * (1.5 - 0.2 * x) * math.exp(-0.2 * (2.0 - puck.touches[0].time)), rel=1e-9
    )


@pytest.mark.parametrize("steps", [1, 7, 1000])
def test_the_flight_of_a_puck_does_not_depend_on_the_step(steps):
    puck = PuckOnTable(PLAY, PuckState(0.1, 0.2, 0.0, 3.0, 2.0, 20.0))
    whole = PuckOnTable(PLAY, PuckState(0.1, 0.2, 0.0, 3.0, 2.0, 20.0))
    for k in range(steps):
        puck.run(3.0 * (k + 1) / steps)
    whole.run(3.0)
    assert [t.met for t in puck.touches] == [t.met for t in whole.touches]
    np.testing.assert_allclose(puck.state, whole.state, atol=1e-9)


def test_a_puck_in_a_goal_stays_there_until_it_is_placed():
    puck = PuckOnTable(PLAY, PuckState(0.0, 0.05, 0.0, -4.0, 0.0))
    puck.run(3.0)
    assert puck.goal == -1
    assert puck.touches[-1].met == "goal"
    assert puck.state.x == pytest.approx(-PLAY.table.length_m / 2 - PLAY.puck.radius_m)
    there = puck.state
    puck.run(4.0)
    assert (puck.time, puck.state) == (4.0, there)
    puck.place(PuckState(0.0, 0.0))
    assert puck.goal == 0


def test_a_disc_too_large_for_the_goal_is_stopped_by_the_posts():
    # At every distance from the long axis: it enters within the opening minus a radius.
    half, radius = PLAY.table.goal_width_m / 2, PLAY.puck.radius_m
    for beside in np.linspace(0.001, 0.4, 81):
        puck = PuckOnTable(PLAY, PuckState(0.8, float(beside), 0.0, 5.0, 0.0))
        puck.run(0.1)
        met = puck.touches[0].met
        inside = beside < half - radius
        assert met == ("goal" if inside else "post" if beside < half else "rail")


@pytest.mark.parametrize("speed", [1.0, 10.0, 1000.0])
@pytest.mark.parametrize("give_way", [True, False])
def test_no_puck_tunnels_through_a_disc_at_any_speed(speed, give_way):
    puck = PuckOnTable(BILLIARD, PuckState(0.0, 0.0, 0.0, speed, 0.0))
    disc = craft(0.5, 0.0) if give_way else mallet(0.5, 0.0)
    hit = puck.run(0.45 / speed, [disc])
    gap = 0.5 - R - disc.radius
    assert puck.touches[0].time == pytest.approx(gap / speed, rel=1e-12)
    if give_way:
        assert hit is disc
        # Momentum and energy: v' = (m - M) / (m + M) v and 2 m / (m + M) v.
        assert puck.state.vx == pytest.approx(speed * (0.01 - 0.14) / 0.15)
        assert disc.vx == pytest.approx(speed * 0.02 / 0.15)
    else:
        assert hit is None
        assert puck.state.vx == pytest.approx(-speed)


def test_a_moving_mallet_is_hit_at_the_exact_time():
    # They approach at 7 m/s; the puck leaves at 2 · 4 + 3.
    puck = PuckOnTable(BILLIARD, PuckState(-0.5, 0.0, 0.0, 3.0, 0.0))
    puck.run(0.1, [mallet(0.1, 0.0, vx=-4.0, duration=0.1)])
    assert puck.touches[0].time == pytest.approx((0.6 - R - 0.05) / 7)
    assert puck.state.vx == pytest.approx(-11.0)


def test_contacts_name_the_disc_and_the_motion_before_them():
    # Between two mallets, finally nearer to the first: right, left, right.
    puck = PuckOnTable(BILLIARD, PuckState(0.0, 0.0, 0.0, 4.0, 0.0))
    puck.run(0.16, [mallet(-0.2, 0.0), mallet(0.2, 0.0)])
    assert [touch.disc for touch in puck.touches] == [1, 0, 1]
    assert [touch.before.vx for touch in puck.touches] == pytest.approx([4.0, -4.0, 4.0])
    gap = 0.2 - R - 0.05
    assert [touch.before.x for touch in puck.touches] == pytest.approx([gap, -gap, gap])
    puck.run(1.0, [])
    assert puck.touches[-1].disc is None


def test_a_pushing_craft_carries_the_puck_along():
    # 8 m/s² of thrust for half a second in steps of a millisecond: both move as one body.
    play = AirHockey.model_construct(table=CLOSED, puck=Puck(drag_1_s=0.0))
    puck, x, v, h = PuckOnTable(play, PuckState(-0.5 + R + 0.07, 0.0)), -0.5, 0.0, 1e-3
    for k in range(500):
        end, a = (k + 1) * h, 8.0
        while puck.time < end:
            left = end - puck.time
            way = craft(x, 0.0, v, ax=a)
            way.to_x = x + v * left + a * left**2 / 2
            puck.run(end, [way])
            x, v = way.x, way.vx
    # Impulses correspond to the mass m + M.
    assert v == pytest.approx(8.0 * 0.5 * 0.14 / 0.15, rel=0.01)
    assert puck.state.vx == pytest.approx(v, abs=2 * RESTING)
    assert puck.state.x - x == pytest.approx(R + 0.07, abs=1e-4)


@pytest.mark.parametrize("give_way", [True, False])
def test_a_wedged_puck_stops_and_blocks_what_presses_on_it(give_way):
    reach = CLOSED.reach(R)[0]
    play = AirHockey.model_construct(table=CLOSED, puck=Puck())
    puck, x = PuckOnTable(play, PuckState(reach - 0.01, 0.2)), 0.6
    for k in range(300):
        # A hand, or a thrust, that keeps pushing.
        end, v = (k + 1) / 240, 1.0
        while puck.time < end:
            left = end - puck.time
            way = (craft if give_way else mallet)(x, 0.2, vx=v, duration=left)
            puck.run(end, [way])
            x, v = way.x, way.vx
    # A craft that accelerates for 4 ms bounces by a millimetre.
    near = 2e-3 if give_way else 1e-6
    assert x == pytest.approx(reach - R - way.radius, abs=near)
    assert puck.state.x == pytest.approx(reach, abs=near)
    # A few bounces per step, not the endless ones of a shrinking gap.
    assert len(puck.touches) <= 300 * MOST
    # Once released, it can be played again.
    puck.run(puck.time + 0.1)
    puck.run(puck.time + 0.05, [mallet(reach, 0.5, vy=-8.0, duration=0.05)])
    assert puck.state.vy < -6


@examples(60)
@given(
    st.tuples(*[st.floats(-1, 1)] * 5),
    st.floats(0, 1),
    st.floats(0, 1),
    st.floats(0, 1.5),
    st.floats(0, 1),
)
def test_a_free_puck_never_gains_energy(motion, restitution, grip, friction, drag):
    law = Contact(restitution=restitution, grip=grip, friction=friction)
    play = AirHockey(puck=Puck(rail=law, drag_1_s=drag, spin_drag_1_s=drag))
    x, y, vx, vy, spin = np.array(motion) * [1.0, 0.5, 20, 20, 200]
    puck = PuckOnTable(play, PuckState(float(x), float(y), 0.0, vx, vy, spin))
    before = kinetic(play.puck, puck.state)
    for k in range(60):
        puck.run((k + 1) * 0.05)
        after = kinetic(play.puck, puck.state)
        assert after <= before * (1 + 1e-12)
        before = after


@pytest.mark.slow
@pytest.mark.parametrize("hundred", range(2))
def test_random_games_obey_the_laws_of_physics(hundred):
    games = study("random_games")
    met = [games.game(seed, 1.0) for seed in range(100 * hundred, 100 * (hundred + 1))]
    for kind in ("rail", "post", "mallet", "craft", "goals"):
        assert sum(found.get(kind, 0) for found in met) > 10


@pytest.mark.parametrize("seed", range(1, 5))
def test_a_whole_flight_agrees_with_pymunk(seed):
    rng = np.random.default_rng(seed)
    law = Contact(restitution=0.85, grip=1.0, friction=0.2)
    puck = Puck(drag_1_s=0.0, spin_drag_1_s=0.0, rail=law)
    start = PuckState(*rng.uniform(-0.3, 0.3, 2), 0.0, *rng.normal(0, 3, 2), rng.normal(0, 30))
    ours = PuckOnTable(AirHockey.model_construct(table=CLOSED, puck=puck), start)
    space = pymunk.Space()
    space.collision_slop = 1e-6
    body = pymunk.Body(puck.mass_kg, puck.inertia)
    body.position, body.velocity, body.angular_velocity = start[:2], start[3:5], start[5]
    disc = pymunk.Circle(body, puck.radius_m)
    x, y, thick = CLOSED.length_m / 2, CLOSED.width_m / 2, 0.05
    corners = [(-x - thick, -y - thick), (x + thick, -y - thick), (x + thick, y + thick)]
    corners += [(-x - thick, y + thick), corners[0]]
    rails = [
        pymunk.Segment(space.static_body, *ends, thick) for ends in itertools.pairwise(corners)
    ]
    for shape in (disc, *rails):
        shape.elasticity, shape.friction = math.sqrt(law.restitution), math.sqrt(law.friction)
    space.add(body, disc, *rails)
    for _ in range(20_000):
        space.step(5e-5)
    ours.run(1.0)
    assert len(ours.touches) >= 2
    # Their step covers 0.3 mm, at each bounce.
    assert ours.state[:2] == pytest.approx(tuple(body.position), abs=3e-3)
    assert ours.state[3:5] == pytest.approx(tuple(body.velocity), abs=0.02)
    assert ours.state.spin == pytest.approx(body.angular_velocity, abs=0.5)
