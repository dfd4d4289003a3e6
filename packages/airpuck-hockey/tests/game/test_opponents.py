"""Families of scripted opponents."""

from dataclasses import replace

import numpy as np
import pytest

from airpuck import InputError, PuckState
from airpuck.physics.puck_on_table import PuckOnTable
from airpuck_hockey.game.contestant import contestant
from airpuck_hockey.game.hand import HANDS, Dexterity, Keeper, Striker
from apparatus.hands import PLAY, played_alone
from tests.apparatus.studies import STUDIES, study

OPPONENTS = study("opponents")
Banker, Counter, Wild = OPPONENTS.Banker, OPPONENTS.Counter, OPPONENTS.Wild
WrongFoot = OPPONENTS.WrongFoot
EXACT = Dexterity(reaction_s=0.1, noise_m=0.0, aim_rad=0.0, speed_m_s=4.0)


def episode(hand, puck, duration, opponent=lambda time: (0.9, 0.0), skill=EXACT):
    """Let one hand play a puck alone; return the puck, whose touches are known."""
    player = hand(PLAY, skill, 0)
    return played_alone(player, puck, duration, (-0.95, 0.0), opponent)[1].puck


@pytest.mark.parametrize("name", HANDS)
@pytest.mark.parametrize("level", ["easy", "medium", "hard"])
def test_every_family_plays_at_every_level(name, level):
    kind, levels = HANDS[name]
    assert contestant(f"{name}:{level}").hand is not None
    skill = levels[level]
    # No opponent reacts within 0.15 s of seeing something, or moves faster than the mallet allows.
    assert skill.reaction_s >= 0.15
    assert skill.speed_m_s <= PLAY.mallet.speed_m_s
    x, y = kind(PLAY, skill, 1).target(0.0, (-0.9, 0.0), PuckState(-0.4, 0.1), (0.9, 0.0))
    assert -PLAY.table.length_m / 2 <= x <= 0.2
    assert abs(y) <= PLAY.table.width_m / 2


def test_a_hand_from_a_file_plays_and_its_errors_name_the_file(tmp_path):
    made = contestant(f"{STUDIES / 'opponents.py'}:Counter").hand
    assert isinstance(made(PLAY, 0).target(0.0, (-0.9, 0.0), None, (0.9, 0.0)), tuple)
    file = tmp_path / "mine.py"
    file.write_text(
        "from airpuck_hockey.game.hand import Keeper\n\n\n"
        "class Lost(Keeper):\n    def decided(self, time, own):\n        return 1 / 0\n"
    )
    lost = contestant(f"{file}:Lost").hand(PLAY, 0)
    with pytest.raises(InputError, match=r"mine.py:Lost.*line 6: target.*division by zero"):
        lost.target(0.0, (-0.9, 0.0), PuckState(-0.4, 0.1), (0.9, 0.0))


def test_a_counter_attacker_returns_what_a_striker_only_stops():
    returned = {}
    for hand in (Striker, Counter):
        puck = episode(hand, PuckState(0.8, 0.05, 0.0, -2.0, 0.0), 1.0)
        returned[hand] = max((t.impulse for t in puck.touches if t.met == "mallet"), default=0.0)
    # The mallet moves towards the puck, so the impulse is greater.
    assert returned[Counter] > 1.5 * returned[Striker]


@pytest.mark.parametrize("side", [-1, 1])
def test_a_bank_shooter_scores_over_the_rail_away_from_the_opponent(side):
    puck = episode(Banker, PuckState(-0.5, 0.0), 4.0, lambda time: (0.9, 0.1 * side))
    met = [touch for touch in puck.touches if touch.met in ("rail", "goal")]
    assert met[0].met == "rail"
    assert met[0].before.y * side < 0


@pytest.mark.parametrize("side", [-1, 1])
def test_a_wrong_footer_aims_at_the_corner_that_the_opponent_leaves(side):
    # The opponent crosses the goal from this side to the other.
    def crosses(time):
        return 0.9, side * (0.2 - 0.15 * time)

    puck = episode(WrongFoot, PuckState(-0.5, 0.0), 2.0, crosses)
    strike = next(touch for touch in puck.touches if touch.met == "mallet")
    assert crosses(strike.time)[1] * side > 0
    assert puck.touches[1].before.y * side > 0.1


def test_a_wild_hitter_hits_a_puck_that_a_striker_lets_pass():
    # Fast, and from side to side of its half.
    shot = PuckState(-0.7, 0.4, 0.0, 0.1, 1.5)
    assert [t.met for t in episode(Wild, shot, 1.5).touches].count("mallet") > 0
    waits = episode(Keeper, shot, 1.5)
    assert [t.met for t in waits.touches].count("mallet") == 0


def spread(skill, puck):
    """Return the standard deviation of where keepers expect a puck to pass."""
    found = [
        Keeper(PLAY, skill, seed).target(0.0, (-1.0, 0.0), puck, (0.9, 0.0))[1]
        for seed in range(200)
    ]
    return float(np.std(found))


def test_the_prediction_error_grows_with_distance():
    skill = replace(EXACT, heading_rad=0.02)
    line = -PLAY.table.length_m / 2 + 0.1
    for x in (-0.4, 0.2):
        # Within what a hand foresees, and without bounces.
        expected = 0.02 * (x - line)
        assert spread(skill, PuckState(x, 0.0, 0.0, -3.0, 0.0)) == pytest.approx(expected, rel=0.2)


def test_the_prediction_error_grows_with_every_bounce():
    skill = replace(EXACT, bounce_rad=0.03)
    straight = PuckState(0.0, 0.0, 0.0, -3.0, 0.0)
    assert spread(skill, straight) == 0.0
    # Over a rail, to the middle of the goal.
    shot = next(
        PuckState(0.0, 0.2, 0.0, -3.0, vy)
        for vy in np.linspace(0.5, 4.0, 200).tolist()
        if abs(passes(PuckState(0.0, 0.2, 0.0, -3.0, vy))) < 0.01
    )
    assert spread(skill, shot) > 0.01


def test_every_opponent_except_the_wall_misjudges_motion_and_bounces():
    for name, (_, levels) in HANDS.items():
        for skill in levels.values():
            errors = (skill.velocity_error, skill.heading_rad, skill.bounce_rad)
            assert (min(errors) > 0) == (name != "wall")
            assert skill.noise_m > 0


def passes(puck):
    """Return the y at which a puck arrives at the mallet's line."""
    table, line = PuckOnTable(PLAY, puck), -PLAY.table.length_m / 2 + 0.1
    while table.state.x > line:
        table.run(table.time + 0.002)
    return table.state.y
