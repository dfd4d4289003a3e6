"""The player: on both sides, and with missing or wrong poses of the puck."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import airpuck
import airpuck_hockey
from airpuck import AirHockey, InputError, Measurement, PuckState, Rendezvous, SetPoint, Twin
from airpuck.control.reference import asked, preview
from airpuck.flight.loop import control
from airpuck.model.model_file import nominal_model, read_model
from airpuck.planning.minimal_time import craft_of, read_minimal_times
from airpuck.twin.plant import build_plant
from airpuck.twin.settings import default_twin_settings
from airpuck_hockey import Intention, Level, Player
from airpuck_hockey.player.player import LEVELS, check_player, pitch_of, slower, weakened
from airpuck_hockey.player.tactic import Frame
from tests.apparatus.models import scaled

MODEL, PLAY = read_model("paper:M3"), AirHockey()
SETTINGS = default_twin_settings().with_usual_delay(MODEL.transport_delay)


@pytest.fixture(scope="module")
def plant():
    return build_plant(MODEL, SETTINGS)


def start_of(player):
    pose = np.array([*player.pitch.home, 0.0])
    return tuple(Frame(player.side).states(pose).tolist())


def puck_for(side, *state):
    return PuckState(*Frame(side).states(np.array(state)).tolist())


def twin_of(player, puck, plant, seed=0):
    return Twin(
        MODEL, SETTINGS, seed=seed, pose=start_of(player), plant=plant, puck=puck, logs=False
    )


class Noted:
    """A tactic that goes home and records its views."""

    def __init__(self):
        self.views = []

    def decide(self, view):
        self.views.append(view)
        return Intention("home", SetPoint(*view.pitch.home, 0.0))


@pytest.mark.slow
@pytest.mark.parametrize("side", [-1, 1])
def test_a_shot_is_saved_on_either_side_within_the_own_half(plant, side):
    player = Player(MODEL, PLAY, side=side)
    twin = twin_of(player, puck_for(side, 0.6, 0.0, 0, -2.0, -0.17, 0), plant)
    for _ in control(player, twin, 1.2):
        assert side * twin.state[0] > MODEL.vehicle.radius_m
    assert twin.play.puck.goal != side  # it may have scored
    assert twin.play.puck.goal or side * twin.play.puck.state.vx < 0


def test_both_sides_see_the_same_game_rotated(plant):
    seen = []
    for side in (-1, 1):
        player = Player(MODEL, PLAY, tactic := Noted(), side=side)
        twin = twin_of(player, puck_for(side, 0.3, 0.2, 0, -1.0, 0.8, 2.0), plant)
        for _ in control(player, twin, 0.4):
            pass
        seen.append(tactic.views[-1])
    np.testing.assert_allclose(seen[0].craft[:2], seen[1].craft[:2], atol=2e-3)
    np.testing.assert_allclose(seen[0].puck.mean[:2], seen[1].puck.mean[:2], atol=5e-4)
    np.testing.assert_allclose(seen[0].puck.mean[3:5], seen[1].puck.mean[3:5], atol=0.02)


def test_a_rotated_reference_is_the_same_motion_from_the_other_side():
    meet = Rendezvous(1.0, (0.3, 0.1, 0.2, 1.0, -0.5, 0.3), then=SetPoint(0.1, 0.2, 0.0))
    times = np.array([0.1, 0.3, 0.5])
    np.testing.assert_array_equal(asked(Frame(1).reference(meet), 0.4), Frame(1).states(meet.state))
    ours, other = preview(meet, 0.4, times), preview(Frame(1).reference(meet), 0.4, times)
    np.testing.assert_allclose(other.states[:, :2], -ours.states[:, :2])
    np.testing.assert_allclose(other.states[:, 2], ours.states[:, 2] + math.pi)
    np.testing.assert_allclose(other.states[:, 3:5], -ours.states[:, 3:5])
    assert other.arrival.remaining == ours.arrival.remaining
    np.testing.assert_allclose(
        Frame(1).states(Frame(1).states(ours.states))[:, [0, 1, 3]], ours.states[:, [0, 1, 3]]
    )


def test_a_player_with_reaction_time_sees_the_past(plant):
    player = Player(MODEL, PLAY, tactic := Noted(), level=Level(reaction_s=0.1))
    twin = twin_of(player, puck_for(-1, 0.3, 0.0, 0, -1.0, 0.0, 0.0), plant)
    for _ in control(player, twin, 0.5):
        pass
    ages = [view.time - view.puck.time for view in tactic.views if view.puck is not None]
    assert min(ages) >= 0.1
    assert max(ages) < 0.12


def test_a_weaker_craft_has_less_thrust_and_needs_longer():
    from airpuck.physics.thrust import thrust

    def full(model):
        top = np.full(6, model.vehicle.command_max)
        return thrust(model.dynamics.thrust, top).sum()

    assert full(weakened(MODEL, 0.5)) / full(MODEL) == pytest.approx(0.5, abs=0.01)
    # From rest, half the acceleration takes √2 as long; from a speed v likewise as from √2 v.
    times = read_minimal_times()
    weak = slower(times, 0.5)
    assert weak((0.7, 0.0), (0.0, 0.0)) == pytest.approx(2**0.5 * times((0.7, 0.0), (0.0, 0.0)))
    assert weak((0.7, 0.0), (0.5, 0.5)) == pytest.approx(
        2**0.5 * times((0.7, 0.0), (0.5 * 2**0.5, 0.5 * 2**0.5))
    )
    with pytest.raises(InputError, match="thrust"):
        Level(thrust=0.0)
    assert set(LEVELS) == {"easy", "medium", "hard"}


def test_the_fence_encloses_the_own_half():
    pitch = pitch_of(MODEL, PLAY)
    assert pitch.fence[1, 0] <= -MODEL.vehicle.radius_m
    assert pitch.inside(np.array([pitch.home])).all()


def stepped(player, measure, steps, start=0.0):
    """Step a player whose craft stands at home; `measure` gives the puck's poses."""
    for k in range(steps):
        for frame in range(3):
            stamp = start + 0.01 * k + frame / 300
            player.measured(Measurement("pose", stamp, np.array([*player.pitch.home, 0.0])))
            measure(player, stamp)
        step = player.step(start + 0.01 * (k + 1))
        player.sent(start + 0.01 * (k + 1), step.command)
        assert np.isfinite(step.command).all()


def moving(player, stamp):
    player.measured(Measurement("puck", stamp, np.array([0.5 - 0.5 * stamp, 0.1, 0.0])))


def frozen(player, stamp):
    player.measured(Measurement("puck", stamp, np.array([0.4, 0.1, 0.0])))


def garbage(player, stamp):
    player.measured(Measurement("puck", stamp, np.array([math.nan, 0.1, 0.0])))
    player.measured(Measurement("puck", math.inf, np.array([0.2, 0.1, 0.0])))
    player.measured(Measurement("puck", stamp, np.array([1e9, 0.1, 0.0])))
    player.measured(Measurement("mallet", stamp, np.array([math.nan] * 3)))


@pytest.mark.parametrize(
    ("then", "sight"), [(moving, "seen"), (frozen, "frozen"), (garbage, "lost")]
)
def test_a_frozen_or_missing_puck_is_recognised(then, sight):
    player = Player(MODEL, PLAY)
    stepped(player, moving, 20)
    assert player.sight == "seen" and player.predicted is not None
    stepped(player, then, 120, start=0.2)
    assert player.sight == sight
    if sight == "lost":
        assert player.intention.kind == "home"
        assert player.predicted is None


def test_a_tactic_that_returns_nothing_is_rejected_by_name():
    class Idle:
        def decide(self, view):
            return None

    player = Player(MODEL, PLAY, Idle())
    player.measured(Measurement("pose", 0.0, np.array([-0.9, 0.0, 0.0])))
    with pytest.raises(InputError, match=r"Idle.*Intention"):
        player.step(0.01)
    with pytest.raises(InputError, match="side"):
        Player(MODEL, PLAY, side=0)


def test_noise_rotates_a_shot_about_the_puck():
    class Striker:
        def decide(self, view):
            state = (-0.4, 0.0, 0.0, 1.0, 0.0, 0.0)
            return Intention("strike", Rendezvous(0.5, state), (0.5, -0.3, 0.0))

    found = []
    for seed in range(10):
        player = Player(MODEL, PLAY, Striker(), level=Level(shot_noise_rad=0.2), seed=seed)
        stepped(player, moving, 2)
        first = player.intention.reference.state
        stepped(player, moving, 2, start=0.02)
        np.testing.assert_array_equal(first, player.intention.reference.state)
        assert np.hypot(*(first[:2] - [-0.3, 0.0])) == pytest.approx(0.1)
        angle = math.atan2(first[4], first[3])
        np.testing.assert_allclose(
            first[:2], [-0.3 - 0.1 * math.cos(angle), -0.1 * math.sin(angle)]
        )
        found.append(angle)
    assert 0.08 < np.std(found) < 0.4
    assert airpuck_hockey.Player is Player


@pytest.mark.parametrize("side", [-1, 1])
def test_lists_and_arrays_of_a_tactic_are_rotated_on_either_side(side):
    class Plain:
        def decide(self, view):
            given = Intention("home", SetPoint(*view.pitch.home, 0.0))
            # Without the checks of signatures, which only tests have.
            object.__setattr__(given, "path", [[0.1, 0.2], [0.3, 0.4]])
            object.__setattr__(given, "meet", np.array([1.0, 0.1, 0.2]))
            object.__setattr__(given, "avoid", np.array([0.1, 0.2, 0.05]))
            return given

    player = Player(MODEL, PLAY, Plain(), side=side)
    stepped(player, moving, 2)
    found = player.intention
    np.testing.assert_allclose(found.path, -side * np.array([[0.1, 0.2], [0.3, 0.4]]))
    np.testing.assert_allclose(found.meet, [1.0, -side * 0.1, -side * 0.2])
    np.testing.assert_allclose(found.avoid, [-side * 0.1, -side * 0.2, 0.05])


def test_the_tactic_of_the_documentation_plays(plant):
    text = (Path(__file__).parents[4] / "docs" / "hockey.md").read_text()
    block = next(b for b in text.split("```python\n")[1:] if "class Keeper" in b)
    source = block.partition("```")[0]
    assert len(source.splitlines()) <= 20
    names = {}
    exec(source, names)
    player = Player(MODEL, PLAY, names["Keeper"]())
    twin = twin_of(player, PuckState(0.6, 0.1, 0.0, -1.0, 0.0, 0.0), plant)
    for _ in control(player, twin, 1.8):
        pass
    assert player.intention.kind == "defend"
    assert twin.play.puck.goal == 0


def test_the_estimate_uses_the_commands_that_were_sent():
    """Two players see the same poses; only one receives the commands of running propellers."""
    found = []
    for command in (None, np.full(6, MODEL.vehicle.command_max) * [1, 0, 0, 0, 0, 1]):
        player = Player(MODEL, PLAY, tactic := Noted())
        for k in range(30):
            player.measured(Measurement("pose", 0.01 * k, np.array([*player.pitch.home, 0.0])))
            player.step(0.01 * (k + 1))
            if command is not None:
                player.sent(0.01 * (k + 1), command)
        found.append(tactic.views[-1].craft[3:5])
    assert np.linalg.norm(found[1] - found[0]) > 0.02


@pytest.mark.parametrize("side", [-1, 1])
def test_a_puck_is_seen_only_on_the_table(side):
    x, y = PLAY.table.length_m / 2, PLAY.table.width_m / 2
    for place, seen in (
        ((x, 0.0), True),
        ((-x, y), True),
        ((x + 0.09, -y - 0.09), True),
        ((x + 0.11, 0.0), False),
        ((0.0, -y - 0.11), False),
    ):
        player = Player(MODEL, PLAY, tactic := Noted(), side=side)
        stepped(
            player,
            lambda p, stamp, at=place: p.measured(Measurement("puck", stamp, np.array([*at, 0.0]))),
            3,
        )
        assert (tactic.views[-1].puck is not None) == seen


def test_the_opponents_velocity_is_estimated_within_some_frames():
    player = Player(MODEL, PLAY, tactic := Noted())

    def passing(player, stamp):
        player.measured(Measurement("mallet", stamp, np.array([0.8, 0.5 - stamp, 0.0])))

    stepped(player, passing, 20)
    np.testing.assert_allclose(tactic.views[-1].opponent[2:], [0.0, -1.0], atol=0.02)
    np.testing.assert_allclose(tactic.views[-1].opponent[:2], [0.8, 0.3], atol=0.02)
    # Old poses are ignored.
    player.measured(Measurement("mallet", 0.1, np.array([0.0, 0.0, 0.0])))
    stepped(player, passing, 1, start=0.2)
    assert tactic.views[-1].opponent[0] == 0.8


def test_a_puck_is_frozen_after_six_repeated_poses():
    player = Player(MODEL, PLAY)
    stepped(player, moving, 20)
    assert player.predicted is not None
    np.testing.assert_allclose(
        player.predicted[::20], [[0.4, 0.1], [0.2, 0.1], [0.0, 0.1]], atol=0.05
    )
    # Three frames a step: one new place and five repeats, then three more.
    stepped(player, frozen, 2, start=0.2)
    assert player.sight == "seen"
    stepped(player, frozen, 1, start=0.22)
    assert player.sight == "frozen"
    assert player.predicted is None
    # A puck that was at rest may repeat its pose.
    resting = Player(MODEL, PLAY)
    stepped(resting, frozen, 20)
    assert resting.sight == "seen"


def test_too_slow_a_command_rate_is_rejected_before_planning():
    examples = Path(__file__).parents[4] / "examples"
    atmos = airpuck.read_vehicle(examples / "free_flyers/atmos.toml")
    with pytest.raises(InputError, match=r"one command every 100 ms .* hockey needs one every 10"):
        check_player(nominal_model(atmos))
    check_player(read_model("paper:M3"))


def test_a_player_of_a_weak_craft_allows_for_its_longer_times(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    model = airpuck.read_model("paper:M3")
    other = scaled(model, 0.41)
    file = tmp_path / "airpuck" / "minimal_times" / f"{craft_of(other)}.toml"
    file.parent.mkdir(parents=True)
    slow = replace(read_minimal_times(), craft=craft_of(other), time=2 * read_minimal_times().time)
    slow.save(file)
    play = AirHockey()
    usual, weaker = Player(model, play), Player(other, play)
    assert weaker.pitch.acceleration == pytest.approx(usual.pitch.acceleration / 4, rel=1e-3)
    # A shot at 2.5 m/s: the craft strikes it back if there is time, and otherwise blocks it.
    assert "strike" in decisions(usual)
    assert decisions(weaker) == {"defend"}


def decisions(player):
    """Return the decisions of a player at home about a straight shot at 2.5 m/s."""
    kinds = []
    for k in range(20):
        time = 0.01 * k
        player.measured(Measurement("pose", time, np.array([-0.9, 0.15, 0.0])))
        player.measured(Measurement("puck", time, np.array([0.8 - 2.5 * time, 0.0, 0.0])))
        player.step(time)
        kinds.append(player.intention.kind)
    return set(kinds[8:])  # after some frames the velocity is known
