"""Shots: against hand calculations, mirror images, the twin's puck, and random draws."""

import math
from dataclasses import replace

import numpy as np
import pytest

from airpuck.craft.table import AirHockey, Contact, Puck
from airpuck.model.model_file import read_model
from airpuck.physics.puck import Disc, PuckState, strike
from airpuck.physics.puck_on_table import PuckOnTable
from airpuck.twin.play import HandMallet, World
from airpuck_hockey.game.hand import HUMANS, ScriptedHand
from airpuck_hockey.player.player import pitch_of
from airpuck_hockey.player.rival import Rival
from airpuck_hockey.player.shot import ArrivalError, Contacts, chances, flown, struck, unit
from airpuck_hockey.puck.prediction import PuckModel

MODEL, PLAY = read_model("paper:M3"), AirHockey()
PITCH = pitch_of(MODEL, PLAY)
#: Rails are mirrors, and there is no drag.
MIRRORS = AirHockey(
    puck=Puck(
        drag_1_s=0.0,
        spin_drag_1_s=0.0,
        rail=Contact(restitution=1.0, grip=0.0, friction=0.0),
    )
)
RADIUS, HALF = PLAY.puck.radius_m, PLAY.table.goal_width_m / 2


def contact(place, puck, normal, speed):
    normal = np.atleast_1d(np.asarray(normal, dtype=float))
    count = len(normal)
    return Contacts(
        np.tile(np.asarray(place, dtype=float), (count, 1)),
        np.tile(np.asarray(puck, dtype=float), (count, 1)),
        normal,
        speed * unit(normal),
    )


def test_a_push_along_the_normal_matches_a_hand_calculation():
    # A free collision: the puck gets (1 + e) M / (M + m) of the craft's speed.
    after = struck(PITCH, contact((-0.4, 0.1), (0, 0, 0), [0.3, -1.0], 1.2))
    share = (1 + 0.8) * PITCH.craft_mass / (PITCH.craft_mass + PLAY.puck.mass_kg)
    np.testing.assert_allclose(after[:, :2], 1.2 * share * unit(np.array([0.3, -1.0])))
    np.testing.assert_allclose(after[:, 2], 0.0, atol=1e-12)


def test_batched_contacts_match_single_discs():
    rng = np.random.default_rng(0)
    normal, motion = rng.uniform(-1.4, 1.4, 50), rng.uniform([-2, -2, -20], [0, 2, 20], (50, 3))
    craft = rng.uniform(0.3, 1.5, (50, 1)) * unit(normal)
    after = struck(PITCH, Contacts(np.zeros((50, 2)), motion, normal, craft))
    for k in range(50):
        puck = Disc(0, 0, *motion[k].tolist(), RADIUS, PLAY.puck.mass_kg, PLAY.puck.inertia)
        vx, vy = craft[k].tolist()
        mallet = Disc(0, 0, vx, vy, 0.0, 0.07, PITCH.craft_mass, PITCH.craft_inertia)
        if (motion[k, :2] - craft[k]) @ unit(normal[k]) < 0:
            strike(puck, mallet, math.cos(normal[k]), math.sin(normal[k]), PLAY.puck.craft)
        np.testing.assert_allclose(after[k], [puck.vx, puck.vy, puck.spin], rtol=1e-9, atol=1e-12)


def test_a_straight_shot_scores_if_its_line_clears_the_posts():
    start = np.array([-0.3, 0.2])
    for post in (-HALF, HALF):
        # The line that touches the post, by the angles of a right triangle.
        to_post = np.array([PITCH.goal_line, post]) - start
        touching = math.atan2(to_post[1], to_post[0]) - math.copysign(
            math.asin(RADIUS / np.hypot(*to_post)), post
        )
        inside = math.copysign(1e-3, -post)
        angles = np.array([touching + inside, touching - inside])
        motion = np.hstack([2.0 * unit(angles), np.zeros((2, 1))])
        found = flown(MIRRORS, np.tile(start, (2, 1)), motion)
        assert found.scores.tolist() == [True, False]
        assert found.bounces[0] == 0


@pytest.mark.parametrize("bounces", [1, 2])
@pytest.mark.parametrize("side", [-1, 1])
def test_a_bank_shot_aims_at_the_mirror_image_of_the_goal(bounces, side):
    # Behind mirrors at ±h, images of the goal's middle are at 2h and 4h - 0.
    start, reach = np.array([-0.4, 0.12]), PLAY.table.width_m / 2 - RADIUS
    image = side * 2 * reach * bounces
    angle = math.atan2(image - start[1], PITCH.goal_line - start[0])
    off = 0.25 / (PITCH.goal_line - start[0])
    angles = np.array([angle, angle + off, angle - off])
    motion = np.hstack([1.5 * unit(angles), np.zeros((3, 1))])
    found = flown(MIRRORS, np.tile(start, (3, 1)), motion)
    assert found.scores[0] and found.bounces[0] == bounces
    assert not found.scores[1:].any() or bounces == 2


def test_shots_end_where_the_twins_puck_does():
    rng = np.random.default_rng(1)
    place = rng.uniform([-0.8, -0.4], [-0.1, 0.4], (400, 2))
    angle, spin = rng.uniform(-1.2, 1.2, 400), rng.normal(0, 10, 400)
    motion = np.column_stack([rng.uniform(0.6, 4, (400, 1)) * unit(angle), spin])
    found = flown(PLAY, place, motion)
    missed = 0
    for k in range(400):
        puck = PuckOnTable(PLAY, PuckState(*place[k].tolist(), 0.0, *motion[k].tolist()))
        # Until it comes back, or has bounced more often than flights are computed for.
        while not puck.goal and puck.state.vx > 0 and puck.time < 20:
            puck.run(puck.next_meeting + 1e-8)
        met = [touch.met for touch in puck.touches]
        plain = met.count("rail") <= 2 and "post" not in met
        # A predicted goal may still touch the side of the goal, behind the line.
        assert puck.goal > 0 or not found.scores[k]
        missed += puck.goal > 0 and plain and not found.scores[k]
    assert found.scores.sum() > 50
    assert missed <= 1


@pytest.mark.slow
def test_the_chance_is_the_share_of_sampled_shots_that_score():
    rng = np.random.default_rng(2)
    covariance = np.diag([2e-3, 2e-3, 1e-2, 0.05, 0.05, 1.0]) ** 2
    error, model = ArrivalError(0.005, 0.05), PuckModel(PLAY)
    for normal, speed in ((0.02, 1.0), (-0.1, 1.2), (0.95, 1.0)):
        place, motion = np.array([-0.45, 0.05]), np.array([-0.1, 0.05, 0.0])
        shot = contact(place, motion, normal, speed)
        chance, _ = chances(PITCH, model, shot, covariance[None], error, count=512)
        scored, count = 0, 1500
        for _ in range(count):
            e = rng.multivariate_normal(np.zeros(6), covariance)
            craft = place - PITCH.contact_distance * unit(normal) + rng.normal(0, error.place, 2)
            ahead = place + e[:2] - craft
            direction = math.atan2(ahead[1], ahead[0])
            varied = AirHockey(
                puck=Puck(
                    rail=Contact(
                        restitution=float(np.clip(rng.normal(0.79, 0.03), 0, 1)),
                        grip=float(np.clip(rng.normal(0.48, 0.1), 0, 1)),
                    )
                )
            )
            puck = Disc(
                0, 0, *(motion + e[3:]).tolist(), RADIUS, PLAY.puck.mass_kg, PLAY.puck.inertia
            )
            velocity = speed * unit(normal) + rng.normal(0, error.speed, 2)
            mallet = Disc(
                0, 0, *velocity.tolist(), 0.0, 0.07, PITCH.craft_mass, PITCH.craft_inertia
            )
            law = Contact(
                restitution=float(np.clip(rng.normal(0.8, 0.03), 0, 1)),
                grip=float(np.clip(rng.normal(0.48, 0.1), 0, 1)),
            )
            strike(puck, mallet, math.cos(direction), math.sin(direction), law)
            state = PuckState(*(place + e[:2]).tolist(), 0.0, puck.vx, puck.vy, puck.spin)
            body = PuckOnTable(varied, state)
            while not body.goal and body.state.vx > 0 and body.time < 20:
                body.run(body.next_meeting + 1e-8)
            met = [touch.met for touch in body.touches]
            scored += body.goal > 0 and met.count("rail") <= 2 and "post" not in met
        assert chance[0] == pytest.approx(scored / count, abs=0.05)


def test_an_opponent_lowers_the_chance_only_where_it_can_arrive():
    start, motion = np.array([[-0.3, 0.0]]), np.array([[3.0, 0.0, 0.0]])

    def passes(x, y):
        return float(flown(PLAY, start, motion, (np.array([x, y]), 0.048, Rival())).passes[0])

    assert passes(0.9, 0.0) < 0.1
    assert passes(0.0, 0.4) > 0.95
    assert passes(0.9, 0.2) < passes(0.3, 0.2)  # later, so that the defender has time to arrive


class Person:
    """A scripted human on the right side of a world."""

    def __init__(self, seed: int) -> None:
        self.hand = ScriptedHand(PLAY, HUMANS["medium"], seed)
        self.mallet = HandMallet(PLAY.mallet, PLAY.table, 0.85, 0.0)
        self.world = World(PLAY, PuckState(0.0, 0.0), logs=False)
        self.world.bodies.append(self.mallet)
        self.world.observers.append(self)
        assert self.world.puck is not None
        self.puck, self.due = self.world.puck, 0.0

    def observe(self, time: float) -> None:
        x, y, _, vx, vy, spin = self.puck.state
        seen = PuckState(-x, -y, 0.0, -vx, -vy, spin)
        own = -self.mallet.x, -self.mallet.y
        wanted_x, wanted_y = self.hand.target(time, own, seen, (0.0, 0.0))
        self.mallet.target = -wanted_x, -wanted_y
        self.due = time + 0.01


def shot_at_a_person(rng: np.random.Generator, seed: int) -> tuple[float, bool] | None:
    """Shoot at a scripted human; return the chance of getting past, and whether it was a goal.

    None: the shot would miss the goal anyway.
    """
    place = rng.uniform([-0.8, -0.35], [-0.15, 0.35])
    motion = np.array([*rng.uniform(2.0, 5.0) * unit(rng.uniform(-1.2, 1.2)), 0.0])
    if not flown(PLAY, place[None], motion[None]).scores[0]:
        return None
    person = Person(seed)
    person.puck.place(PuckState(*place.tolist()))
    person.world.run(0.4)
    at = np.array([person.mallet.x, person.mallet.y])
    # What is learned of it: it decides every 30 ms.
    limits = Rival(HUMANS["medium"].reaction_s + 0.015, HUMANS["medium"].speed_m_s)
    opponent = at, person.mallet.radius, limits
    chance = flown(PLAY, place[None], motion[None], opponent).passes[0]
    person.puck.place(PuckState(*place.tolist(), 0.0, *motion.tolist()))
    person.world.run(1.9)
    return float(chance), person.puck.goal > 0


@pytest.mark.slow
def test_predicted_chances_match_shots_at_a_scripted_human():
    rng = np.random.default_rng(0)
    drawn = (shot_at_a_person(rng, seed) for seed in range(400))
    chance, goal = np.array([shot for shot in drawn if shot is not None], float).T
    assert len(chance) > 80
    assert chance.mean() == pytest.approx(goal.mean(), abs=0.1)
    # The chances distinguish a good shot from a poor one.
    good = chance > np.median(chance)
    assert goal[good].mean() > 3 * goal[~good].mean()


@pytest.mark.parametrize("x", [0.0, 0.4, 0.9])
@pytest.mark.parametrize("aside", [0.15, 0.3, 0.45])
def test_the_probability_to_pass_matches_a_hand_calculation(x, aside):
    # Without drag the puck passes a defender at a known time, and does not meet a rail before.
    start, speed, size = np.array([[-0.3, 0.0]]), 3.0, 0.048
    opponent = np.array([x, aside]), size, Rival(reaction=0.1, speed=2.0)
    found = flown(MIRRORS, start, np.array([[speed, 0.0, 0.0]]), opponent).passes[0]
    time = (x + 0.3) / speed
    # It begins after 0.1 s, and is at full speed 50 ms later: half of that is lost.
    reaches = 2.0 * (time - 0.125) if time > 0.15 else 40.0 * max(time - 0.1, 0.0) ** 2 / 2
    room = aside - size - RADIUS - reaches
    assert found == pytest.approx(0.5 * (1 + math.erf(room / 0.04 / math.sqrt(2))), abs=1e-9)


def test_a_two_rail_shot_is_anticipated_half_of_the_time():
    # A defender in the mouth of the goal reads a path over two rails half of the time.
    start, reach = np.array([-0.4, 0.1]), PLAY.table.width_m / 2 - RADIUS
    for bounces, low, high in ((1, 0.0, 0.25), (2, 0.5, 0.65)):
        angle = math.atan2(2 * reach * bounces - start[1], PITCH.goal_line - start[0])
        motion = np.array([[*(6.0 * unit(angle)), 0.0]])
        before_the_goal = np.array([PITCH.goal_line - 0.06, 0.0]), 0.048, Rival()
        found = flown(MIRRORS, start[None], motion, before_the_goal)
        assert found.bounces[0] == bounces
        assert low < found.passes[0] < high


def test_a_shot_that_touches_a_post_never_scores():
    # At 45° the path must pass the post by r √2 along the line; after a bounce it would be less.
    room = HALF - RADIUS * math.sqrt(2)
    places = np.array([[0.8, room - 0.3 + off] for off in (-0.0005, 0.0005)])
    found = flown(PLAY, places, np.tile([2.0, 2.0, 0.0], (2, 1)))
    assert found.scores.tolist() == [True, False]
    assert found.bounces.tolist() == [0, 0]


def test_uncertain_contact_laws_lower_the_chance_as_sampling_predicts():
    # The law of contact alone is uncertain; a bank shot depends on restitution and grip.
    known = AirHockey(
        puck=Puck(
            standard_error=dict.fromkeys(
                ("drag_1_s", "spin_drag_1_s", "rail.restitution", "rail.grip"), 1e-9
            )
        )
    )
    rng, place, motion = np.random.default_rng(3), (-0.45, 0.05), (-0.6, 0.9, -40.0)
    for normal in (0.2, 0.35, 0.6):
        chance, _ = chances(
            PITCH,
            PuckModel(known),
            contact(place, motion, normal, 1.3),
            np.zeros((1, 6, 6)),
            ArrivalError(0.0, 0.0),
            count=512,
        )
        many = contact(place, motion, np.full(4000, normal), 1.3)
        restitution, grip = (
            np.clip(rng.normal(mean, sd, 4000), 0, 1) for mean, sd in ((0.8, 0.03), (0.48, 0.1))
        )
        law = known.puck.craft.model_copy(update={"restitution": restitution, "grip": grip})
        puck = known.puck.model_copy(update={"craft": law})
        drawn_laws = replace(PITCH, equipment=known.model_copy(update={"puck": puck}))
        drawn = flown(known, many.place, struck(drawn_laws, many))
        assert 0.1 < drawn.scores.mean() < 0.9
        assert chance[0] == pytest.approx(drawn.scores.mean(), abs=0.03)


def test_a_few_evenly_spread_samples_suffice_for_the_chance():
    rng = np.random.default_rng(0)
    place, motion = rng.uniform([-0.7, -0.3], [-0.2, 0.3], (100, 2)), np.zeros((100, 3))
    normal = rng.uniform(-1.2, 1.2, 100)
    shots = Contacts(place, motion, normal, 1.3 * unit(normal))
    covariance = np.tile(np.diag([1e-4, 1e-4, 1e-2, 5e-3, 5e-3, 0.5]) ** 2, (100, 1, 1))
    few, many = (
        chances(PITCH, PuckModel(PLAY), shots, covariance, ArrivalError(), count=count)[0]
        for count in (64, 2048)
    )
    likely = many > 0.03
    assert likely.sum() > 20
    # 64 independent errors would miss by up to 0.06.
    assert np.sqrt(np.mean((few - many)[likely] ** 2)) < 0.04
