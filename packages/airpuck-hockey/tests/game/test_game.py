"""Games between two sides."""

import math
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from airpuck import InputError, Pilot, PuckState, Step
from airpuck.model.model_file import read_model
from airpuck.recording.bag import write_bag
from airpuck.recording.read import read_recording
from airpuck.twin.settings import default_twin_settings
from airpuck_hockey import Game, Rules
from airpuck_hockey.game.contestant import Contestant, contestant
from airpuck_hockey.game.game import serve
from tests.apparatus.changes import changed

HARD, EASY = contestant("human:hard"), contestant("human:easy")


def played(seed: int, left=HARD, right=EASY, rules=None) -> Game:
    game = Game(left, right, rules=rules, seed=seed)
    game.play()
    return game


@pytest.mark.slow
def test_events_add_up_to_the_score_and_the_better_hand_wins():
    games = [played(seed, rules=Rules(goals=3)) for seed in range(3)]
    for game in games:
        scored = Counter(event.side for event in game.events if event.kind == "goal")
        assert (scored[-1], scored[1]) == game.score
        assert game.events[-1].kind == "over"
        assert max(game.score) == 3 or game.time == pytest.approx(300.0)
    assert sum(game.score[0] > game.score[1] for game in games) >= 2


@pytest.mark.slow
def test_a_seed_determines_the_game():
    first, second = (played(5, rules=Rules(limit_s=10.0)) for _ in range(2))
    assert first.events == second.events
    assert first.recording()["puck"] == second.recording()["puck"]
    assert first.events != played(6, rules=Rules(limit_s=10.0)).events


class Script:
    """A hand whose target depends on time only."""

    def __init__(self, target):
        self._target = target

    def target(self, time, own, puck, opponent):
        return self._target(time)


def test_a_non_finite_target_of_a_hand_is_named():
    nobody = Contestant("lost", hand=lambda play, seed: Script(lambda time: (math.nan, 0.0)))
    with pytest.raises(InputError, match="hand lost: target"):
        Game(nobody, HARD).step()


class Pusher(Pilot):
    """A craft whose commands depend on time only."""

    watches = ("mallet",)

    def __init__(self, seen):
        self.seen = seen

    def measured(self, measurement):
        if measurement.kind == "mallet":
            self.seen.append(measurement.values)

    def step(self, time):
        return Step(0.15 * (1 + np.sin(3.0 * time + np.arange(6.0))))


def pusher(seen=None) -> Contestant:
    def make(model, play, side, seed, opponent):
        return Pusher([] if seen is None else seen)

    return Contestant("pusher", player=make)


def exact():
    """Settings without noise and random losses."""
    nothing = {"position_noise_m": 0.0, "yaw_noise_rad": 0.0, "latency_jitter_s": 0.0}
    radio = {"jitter_s": 0.0, "loss": 0.0}
    return changed(default_twin_settings(), motion_capture=nothing, radio=radio)


def test_a_game_rotated_by_half_a_turn_is_the_same_game():
    # The paper's offset of the centre of mass stays in the world's frame, whatever the yaw.
    model = replace(read_model("paper:M3"), frame="body")
    tracks = []
    for turn, players in ((1, (pusher(), HARD)), (-1, (HARD, pusher()))):
        game = Game(*players, settings=exact(), model=model, seed=4)
        hand = game.sides[turn > 0]
        hand.hand = HARD.hand(game.settings, 7)
        game.world.puck.place(PuckState(turn * 0.3, turn * 0.11, 0.0, turn * 2.0, turn * -0.7, 3.0))
        track = []
        for _ in range(120):
            game.step()
            craft = game.sides[turn < 0]
            assert game.puck is not None
            places = [*craft.state[:2], *hand.state[:2], *game.puck[:2], *game.puck[3:5]]
            track.append([*(turn * np.array(places)), game.puck.spin])
        tracks.append(np.array(track))
    # Rounding grows at every contact.
    np.testing.assert_allclose(tracks[0], tracks[1], atol=1e-6)
    assert np.ptp(tracks[0], axis=0)[[0, 1, 3, 4, 5]].min() > 0.02


def test_a_game_of_two_craft_is_recorded_as_a_bag(tmp_path):
    seen = []
    game = Game(pusher(seen), pusher(), seed=2, rules=Rules(limit_s=2.0))
    game.world.puck.place(PuckState(0.6, 0.12, 0.0, 4.0, 0.0))
    game.play()
    write_bag(game.recording(), tmp_path / "game")
    back = read_recording(tmp_path / "game")
    left, right = game.sides
    np.testing.assert_allclose(back["pose"].values[-1], left.body.pose(), atol=2e-3)
    turned = back["mallet"].values[-1] - right.body.pose()
    turned[2] = math.remainder(turned[2], 2 * math.pi)
    np.testing.assert_allclose(turned, 0.0, atol=4e-3)
    np.testing.assert_allclose(seen[-1][:2], right.body.pose()[:2], atol=0.03)
    assert len(back["command"]) == len(back["opponent_command"]) == 200
    assert len(back["puck"]) < 480
    assert not {"imu", "mouse"} & set(back.streams)  # nobody reads them
    events = back["game"].values
    assert events[-1, :2].tolist() == list(game.score) == [1.0, 0.0]
    assert len(events) == len(game.events)


def test_a_game_between_hands_is_recorded_too():
    game = Game(HARD, EASY, seed=2, rules=Rules(limit_s=1.0))
    game.play()
    recording = game.recording()
    assert {"pose", "puck", "mallet", "game"} == set(recording.streams)
    left, right = game.sides
    for name, side in (("pose", left), ("mallet", right)):
        np.testing.assert_allclose(recording[name].values[-1, :2], side.state[:2], atol=0.03)


def served_puck(y: float, vx: float, vy: float = 0.0) -> Game:
    """Release a puck that a passive hand may or may not meet."""
    away = Contestant("away", hand=lambda play, seed: Script(lambda time: (-1.0, 0.45)))
    game = Game(away, away, seed=1)
    for _ in range(40):
        game.step()
    assert game.world.puck is not None
    game.world.puck.place(PuckState(-0.6, y, 0.0, vx, vy))
    return game


def test_a_goal_without_help_of_the_mallet_is_not_an_own_goal():
    game = served_puck(0.0, -3.0)
    while game.phase == "play":
        game.step()
    assert [e.kind for e in game.events if "goal" in e.kind] == ["goal"]
    assert game.score == (0, 1)


def test_pushing_the_puck_into_ones_own_goal_is_an_own_goal():
    game = served_puck(0.30, 0.0)

    def backwards(time):
        # From the far side of the puck, through it, towards the own goal.
        before = (-0.35, 0.49) if time < 1.5 else (-1.05, -0.05)
        return before if time < 3.0 else (-1.0, 0.45)

    game.sides[0].hand = Script(backwards)
    while game.phase == "play" and game.time < 5.0:
        game.step()
    kinds = [(e.kind, e.side) for e in game.events if "goal" in e.kind]
    assert kinds == [("goal", 1), ("own_goal", -1)]
    figures = game.figures()
    causes = [figures[f"left_own_{cause}"] for cause in ("deflections", "pushes", "rebounds")]
    assert causes == [0, 1, 0]


def test_stopping_a_shot_and_then_pushing_it_in_is_an_own_goal():
    game = served_puck(0.0, -2.0)

    def keeper(time):
        """Stop a shot, let the puck lie, and then push it into the own goal."""
        if time < began + 1.0:
            return -0.95, 0.0
        if time < began + 1.8:
            return -0.35, -0.2
        around = (-0.35, 0.49) if time < began + 2.8 else (-1.05, -0.05)
        return around if time < began + 4.3 else (-1.0, 0.45)

    began = game.time
    game.sides[0].hand = Script(keeper)
    for _ in range(40):
        game.step()
    stopped = [e for e in game.events if e.kind == "hit"]
    assert [e.side for e in stopped] == [-1]
    assert game.score == (0, 0)
    # The puck can be pushed from its far side.
    game.world.puck.place(PuckState(-0.6, 0.30))
    while game.phase == "play" and game.time < began + 5.0:
        game.step()
    assert [(e.kind, e.side) for e in game.events if "goal" in e.kind][1:] == [("own_goal", -1)]


def test_failing_to_stop_a_shot_is_not_an_own_goal():
    game = served_puck(0.0, -6.0)
    game.sides[0].hand = Script(lambda time: (-0.95, 0.12))
    while game.phase == "play" and game.time < 3.0:
        game.step()
    goals = [(e.kind, e.side) for e in game.events if "goal" in e.kind]
    assert goals in ([], [("goal", 1)])


def test_a_seed_too_large_for_two_sides_is_rejected():
    with pytest.raises(InputError, match=r"seed.*4\.61e18: each side has its own 64-bit seed"):
        Game(HARD, EASY, seed=2**62)
    assert Game(HARD, EASY, seed=2**62 - 1).step() is not None


@pytest.mark.slow
def test_figures_summarise_the_events():
    game = played(8, rules=Rules(goals=2))
    figures = game.figures()
    assert (figures["left_goals"], figures["right_goals"]) == game.score
    hits = [e for e in game.events if e.kind == "hit"]
    assert figures["left_hits"] == sum(e.side == -1 for e in hits)
    assert figures["left_hits"] + figures["right_hits"] == len(hits) > 5
    assert figures["duration_s"] == game.time
    assert figures["left_rail_contacts"] == 0


def test_a_game_starts_with_discs_before_their_goals_and_a_puck_in_one_half():
    for seed in range(4):
        game = Game(HARD, pusher(), seed=seed)
        line = game.settings.table.length_m / 2
        np.testing.assert_allclose(game.sides[0].state[:2], (0.25 - line, 0.0))
        np.testing.assert_allclose(game.sides[1].state[:3], (line - 0.25, 0.0, math.pi))
        assert game.puck is not None
        assert game.puck.x == 0.3 * game.referee.server
        assert abs(game.puck.y) <= 0.15
    assert Game(HARD, HARD).seed == 0


def test_a_craft_that_leaves_its_half_is_recorded_once_per_crossing():
    game = Game(pusher(), HARD, seed=1)
    craft = game.sides[0].body
    found = []
    for x in (-0.3, -0.01, 0.02, 0.03, -0.05, -0.2, 0.01):
        disc = craft.disc()
        disc.x, disc.y, disc.vx, disc.vy = x, 0.45, 0.0, 0.0
        craft.take(disc)
        found.append([(e.kind, e.side) for e in game.step() if e.kind == "crossed"])
    assert found == [[], [], [("crossed", -1)], [], [], [], [("crossed", -1)]]


def test_a_served_puck_is_clear_of_all_discs():
    game = Game(HARD, HARD, seed=3)
    for side in (-1, 1):
        mallet = game.sides[side > 0].body
        for y in (-0.14, 0.0, 0.14):
            mallet.x, mallet.y = side * 0.3, y
            for seed in range(5):
                serve(game.world, side, np.random.default_rng(seed))
                place = game.world.puck.state[:2]
                assert place[0] == side * 0.3
                apart = math.dist(place, (mallet.x, mallet.y))
                assert apart > mallet.radius + game.settings.puck.radius_m - 1e-9
                assert abs(place[1]) < game.settings.table.width_m / 2


def test_each_side_of_a_game_has_its_own_seed():
    def seeded(play, seed):
        seeds.append(seed)
        return HARD.hand(play, seed)

    seeds = []
    for seed in range(3):
        Game(Contestant("one", hand=seeded), Contestant("other", hand=seeded), seed=seed)
    assert len(set(seeds)) == 6


def test_a_game_is_shown_with_its_time_and_score():
    assert repr(Game(HARD, EASY)).startswith("Game(time_s=0, phase='")
    assert repr(Game(HARD, EASY)).endswith("score=[0, 0])")
