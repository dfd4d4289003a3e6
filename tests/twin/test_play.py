"""Craft, puck and mallet in the twin."""

import math

import numpy as np
import pytest

from airpuck import InputError, PuckState, Table, Twin
from airpuck.craft.table import Mallet
from airpuck.model.model_file import published_model
from airpuck.recording.bag import write_bag
from airpuck.recording.csv_folder import write_csv
from airpuck.recording.read import read_recording
from airpuck.twin.plant import LONGEST_STEP, build_plant
from airpuck.twin.play import HandMallet, World
from airpuck.twin.settings import default_twin_settings

MODEL = published_model("M3")
QUIET = default_twin_settings()


@pytest.fixture(scope="module")
def plant():
    return build_plant(MODEL)


def test_a_shot_moves_the_craft_and_keeps_momentum_and_energy_bounded(plant):
    start = PuckState(0.5, 0.03, 0.0, -5.0, 0.0, 10.0)
    twin = Twin(MODEL, plant=plant, puck=start)
    twin.wait_until(0.3)
    assert twin.play is not None
    puck, disc = twin.play.puck, plant.disc
    touch = puck.touches[0]
    assert [touch.met for touch in puck.touches] == ["craft"]
    # When it hit: drag slowed it a little.
    left = math.exp(-0.2 * touch.time)
    before = np.array([start.vx, start.vy]) * left
    after = np.array([puck.state.vx, puck.state.vy]) * math.exp(0.2 * (0.3 - touch.time))
    puck_mass = 0.010
    given = puck_mass * (before - after)
    yaw, vx, vy, spin = twin.state[2:6]
    rx, ry = plant.dynamics.center_of_mass
    cos, sin = math.cos(yaw), math.sin(yaw)
    rx, ry = cos * rx - sin * ry, sin * rx + cos * ry
    centre = np.array([vx - spin * ry, vy + spin * rx])
    np.testing.assert_allclose(disc.mass * centre, given, rtol=1e-3)
    energy = disc.mass / 2 * centre @ centre + disc.inertia / 2 * spin**2
    assert 0 < energy < puck_mass / 2 * (before @ before - after @ after)


@pytest.mark.parametrize("speed", [0.5, 3.0])
def test_hitting_a_puck_conserves_momentum(plant, speed):
    twin = Twin(MODEL, plant=plant, puck=PuckState(0.1, 0.005))
    twin.craft.state = np.concatenate([[-0.2, 0.0, 0.3], [speed, 0, 0], twin.state[6:]])
    before = momentum(plant, twin)[:2]
    twin.wait_until(0.3 / speed)
    puck = twin.world.puck
    assert puck is not None and [touch.met for touch in puck.touches] == ["craft"]
    left = math.exp(-0.2 * (0.3 / speed - puck.touches[0].time))  # drag
    given = 0.010 * np.array([puck.state.vx, puck.state.vy]) / left
    assert given[0] > 0.009 * speed
    kept = momentum(plant, twin)[:2]
    np.testing.assert_allclose(kept + given, before, atol=3e-4 * before[0])


def test_steps_are_short_where_a_craft_may_hit_the_puck():
    """Beside the puck, the path of full thrust, 10 m/s², is straight to two micrometres."""
    plant = build_plant(MODEL, compiled=False)

    def step(gap, speed=0.0):
        x = 0.3 + plant.disc.radius + QUIET.puck.radius_m + gap
        twin = Twin(MODEL, plant=plant, pose=(0.3, 0.1, 0.0), puck=PuckState(x, 0.1, 0.0, -speed))
        assert twin.world.puck is not None
        return twin.craft.longest_step(twin.world.puck)

    assert 10.0 * step(0.003) ** 2 / 8 < 2e-6
    assert step(0.05) == LONGEST_STEP
    assert step(0.05, 3.0) == LONGEST_STEP
    # It would be there within a long step.
    assert step(0.05, 12.5) == step(0.003)


def test_an_untouched_puck_does_not_affect_the_flight(plant):
    flights = []
    for puck in (None, PuckState(0.9, 0.45)):
        twin = Twin(MODEL, plant=plant, puck=puck, seed=4)
        for k in range(40):
            twin.wait_until(0.01 * k)
            twin.send(np.full(6, 0.3))
        flights.append(twin.recording())
    for kind in ("pose", "command", "imu", "mouse"):
        alone, beside = flights[0][kind], flights[1][kind]
        np.testing.assert_array_equal(alone.stamp_ns, beside.stamp_ns)
        np.testing.assert_allclose(alone.values, beside.values, atol=1e-12)
    assert "puck" not in flights[0].streams


def recorded(twin):
    """Two seconds in which the mallet moves."""
    twin.play.mallet.target = 0.8, -0.3
    twin.wait_until(2.0)
    return twin.recording()


@pytest.mark.parametrize("write", [write_bag, write_csv])
def test_puck_and_mallet_are_recorded_with_noise_and_dropped_frames(plant, write, tmp_path):
    capture = QUIET.motion_capture.model_copy(update={"dropped": 0.2})
    settings = QUIET.model_copy(update={"motion_capture": capture})
    still = capture.model_copy(update={"position_noise_m": 0.0, "dropped": 0.0})
    exact = QUIET.model_copy(update={"motion_capture": still})
    recording, truth = (
        recorded(Twin(MODEL, each, plant=plant, puck=PuckState(0, 0.3, 0, 1, 1), mallet=(0.8, 0.1)))
        for each in (settings, exact)
    )
    assert 380 * 0.7 < len(recording["puck"]) < 480 * 0.9
    seen = np.isin(truth["puck"].stamp_ns, recording["puck"].stamp_ns)
    errors = recording["puck"].values[:, :2] - truth["puck"].values[seen, :2]
    assert errors.std() == pytest.approx(capture.position_noise_m, rel=0.1)
    assert recording["mallet"].values[-1, 1] == pytest.approx(-0.3, abs=1e-3)
    write(recording, tmp_path / "flown")
    back = read_recording(tmp_path / "flown", needs=("puck",))
    for kind in ("puck", "mallet"):
        np.testing.assert_allclose(back[kind].values, recording[kind].values, atol=1e-12)
        np.testing.assert_array_equal(back[kind].stamp_ns, recording[kind].stamp_ns)


def test_a_puck_in_a_goal_is_not_seen(plant):
    twin = Twin(MODEL, plant=plant, puck=PuckState(0.9, 0.1, 0.0, 3.0, 0.0))
    twin.wait_until(0.5)
    assert twin.play is not None
    assert twin.play.puck.goal == 1
    frames = len(twin.recording()["puck"])
    assert 10 < frames < 30
    twin.play.puck.place(PuckState(0.3, 0.1))
    twin.wait_until(0.6)
    assert len(twin.recording()["puck"]) == frames + 24


@pytest.mark.slow
def test_a_seed_determines_the_game(plant):
    def played():
        twin = Twin(MODEL, plant=plant, puck=PuckState(0.4, 0, 0, -3, 1), mallet=(0.8, 0), seed=9)
        assert twin.play is not None
        for k in range(100):
            twin.wait_until(0.01 * k)
            twin.play.mallet.target = twin.play.puck.state[:2]
        return twin.recording()["puck"], twin.play.puck.touches

    assert played() == played()
    assert len(played()[1]) > 1


def test_a_craft_and_the_mallet_do_not_overlap(plant):
    twin = Twin(MODEL, plant=plant, puck=PuckState(-0.9, 0.4), mallet=(0.3, 0.0), pose=(0.1, 0, 0))
    assert twin.play is not None
    hand = twin.play.mallet
    hand.target = 0.0, 0.0
    for k in range(100):
        twin.wait_until(0.01 * k)
        apart = math.hypot(twin.state[0] - hand.x, twin.state[1] - hand.y)
        assert apart > hand.radius + 0.07 - 1e-9
    assert twin.state[3] < -0.01


def test_steps_as_short_as_rounding_errors_keep_a_hands_speed():
    hand = HandMallet(Mallet(), Table(), 0.85, 0.0)
    hand.target = 0.3, 0.35
    for k in range(60):
        h = (0.0041, 5.6e-17)[k % 2]  # times of events differ by roundings
        way = hand.moving(h)
        way.x, way.y = way.to_x, way.to_y
        before = hand.vx, hand.vy
        hand.arrive(way, h)
        change = math.hypot(hand.vx - before[0], hand.vy - before[1])
        assert change <= 40.0 * h + 1e-9


@pytest.mark.parametrize("target", [(0.2, 0.3), (0.9, -0.4), (5.0, 5.0), (-5.0, 0.0)])
def test_a_hand_respects_its_limits_and_reaches_its_target(target):
    limits, table = Mallet(speed_m_s=3.0, acceleration_m_s2=30.0), Table()
    hand = HandMallet(limits, table, 0.6, 0.0)
    hand.target = target
    before, h, peak = (0.0, 0.0), 1 / 240, 0.0
    for _ in range(400):
        way = hand.moving(h)
        way.x, way.y = way.to_x, way.to_y
        hand.arrive(way, h)
        speed = math.hypot(hand.vx, hand.vy)
        peak = max(peak, speed)
        assert speed <= 3.0 + 1e-9
        change = math.hypot(hand.vx - before[0], hand.vy - before[1])
        # At the border it is stopped.
        assert change <= 30.0 * h + 1e-9 or target[0] in (5.0, -5.0)
        before = hand.vx, hand.vy
        assert hand.radius <= hand.x <= table.reach(hand.radius)[0]
    assert (hand.x, hand.y) == pytest.approx(hand.allowed(*target), abs=1e-4)
    assert peak > 2.0


def test_a_hand_without_a_target_stays_in_place():
    hand = HandMallet(Mallet(), Table(), 0.7, 0.1)
    assert hand.target == (0.7, 0.1)
    way = hand.moving(0.01)
    assert (way.to_x, way.to_y) == (0.7, 0.1)


@pytest.mark.parametrize(
    ("given", "field"),
    [
        ({"mallet": (0.5, 0.0)}, "mallet"),
        ({"puck": PuckState(math.nan, 0.0)}, "puck"),
        ({"puck": PuckState(0.0, 0.0), "mallet": (math.inf, 0.0)}, "mallet"),
        ({"puck": PuckState(0.0, 0.0), "mallet": (0.5,)}, "mallet"),
    ],
)
def test_an_invalid_position_is_rejected(plant, given, field):
    with pytest.raises(InputError) as error:
        Twin(MODEL, plant=plant, **given)
    assert error.value.field == field


def two_crafts(plant, poses, *puck):
    settings, world = QUIET, World(QUIET, PuckState(*(puck or (0.0, 0.5))))
    twins = [
        Twin(MODEL, settings, plant=plant, seed=k, pose=pose, world=world)
        for k, pose in enumerate(poses)
    ]
    return world, twins


def momentum(plant, twin):
    """Return momentum, and angular momentum about the origin."""
    disc, (x, y, yaw, vx, vy, spin) = plant.disc, twin.state[:6]
    rx, ry = plant.dynamics.center_of_mass
    cos, sin = math.cos(yaw), math.sin(yaw)
    rx, ry = cos * rx - sin * ry, sin * rx + cos * ry
    px, py = disc.mass * (vx - spin * ry), disc.mass * (vy + spin * rx)
    energy = (px**2 + py**2) / (2 * disc.mass) + disc.inertia * spin**2 / 2
    turns = (x + rx) * py - (y + ry) * px + disc.inertia * spin
    return np.array([px, py, turns, energy])


@pytest.mark.parametrize("speed", [0.3, 2.0, 8.0])
def test_colliding_craft_conserve_momentum_and_do_not_tunnel(plant, speed):
    world, twins = two_crafts(plant, [(-0.4, 0.02, 0.3), (0.4, -0.02, 2.0)])
    for twin, sign in zip(twins, (1, -1), strict=True):
        twin.craft.state = np.concatenate([twin.state[:3], [sign * speed, 0, 0], twin.state[6:]])
    before = sum(momentum(plant, twin) for twin in twins)
    together = 2 * plant.disc.radius
    met = False
    for k in range(round(0.6 / speed / 0.002)):
        world.run(0.002 * k)
        apart = twins[1].state[0] - twins[0].state[0]
        assert apart > 0
        assert math.dist(twins[0].state[:2], twins[1].state[:2]) > together - 1e-9
        met = met or twins[0].state[3] < 0.9 * speed
    assert met
    after = sum(momentum(plant, twin) for twin in twins)
    # No thrust acts and no rail is near; separating overlaps moves them only a little.
    np.testing.assert_allclose(after[:2], before[:2], atol=1e-3 * plant.disc.mass * speed)
    assert abs(after[2] - before[2]) < 2e-3 * plant.disc.mass * speed
    assert after[3] < before[3]


def test_a_puck_between_two_craft_conserves_momentum(plant):
    poses = [(-0.5, 0.0, 0.0), (0.5, 0.0, math.pi)]
    world, twins = two_crafts(plant, poses, 0, 0.001, 0, 4.0)
    world.run(0.5)
    assert world.puck is not None
    assert [touch.met for touch in world.puck.touches][:2] == ["craft", "craft"]
    given = sum(momentum(plant, twin)[:2] for twin in twins)
    kept = 0.010 * np.array([world.puck.state.vx, world.puck.state.vy])
    # The drag m k v takes the rest: m k times the distance.
    way = np.array([world.puck.state.x, world.puck.state.y - 0.001])
    taken = np.array([0.04, 0.0]) - 0.010 * 0.2 * way
    np.testing.assert_allclose(given + kept, taken, atol=2e-5)


def test_coincident_craft_are_not_moved(plant):
    world, twins = two_crafts(plant, [(-0.5, 0.1, 0.3), (-0.5, 0.1, 0.3)])
    world.run(0.02)
    assert world.met == []
    for twin in twins:
        np.testing.assert_allclose(twin.state[:3], [-0.5, 0.1, 0.3], atol=1e-9)


def test_each_craft_sees_the_other_as_a_mallet(plant):
    _, twins = two_crafts(plant, [(-0.5, 0.1, 0.3), (0.6, -0.2, 2.0)])
    for twin, other in (twins, twins[::-1]):
        seen = [m.values for m in twin.wait_until(0.1) if m.kind == "mallet"]
        assert len(seen) > 20
        np.testing.assert_allclose(np.mean(seen, axis=0), other.state[:3], atol=1e-3)


def test_each_world_has_its_own_puck(plant):
    world, _ = two_crafts(plant, [(-0.5, 0.0, 0.0)])
    with pytest.raises(InputError, match="come with the world"):
        Twin(MODEL, plant=plant, puck=PuckState(0, 0), world=world)
