"""Environments against the official checkers, the twin, and the package's own skills."""

import math
from itertools import pairwise
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env, data_equivalence
from gymnasium.vector import AutoresetMode

from airpuck import InputError, Table, Twin
from airpuck.export import write
from airpuck.export.gym import ENVIRONMENTS, CourseEnv, CourseVectorEnv
from airpuck.export.gym_task import CourseTask
from airpuck.model.model_file import published_model
from airpuck.twin.experiments import COURSES

from ..apparatus.changes import changed
from ..apparatus.environments import MODEL, NOISELESS, PERIOD, SETTINGS, actions, flown

# Gymnasium warns of infinite bounds, which rates have.
pytestmark = pytest.mark.filterwarnings("ignore::UserWarning")


def test_pictures_show_the_craft_in_place():
    env: Any = gymnasium.make("airpuck/SetPoint-v0", render_mode="rgb_array").unwrapped
    options = {"start": (0.4, 0.2, 0.0), "goal": (-0.5, 0.0, 0.0)}
    env.reset(seed=1, options=options)
    before = env.render()
    assert before.dtype == np.uint8
    # Room for rails of 3 cm, 300 pixels per metre.
    assert before.shape == (round(300 * 1.16), round(300 * 2.26), 3)
    x, y, _ = env._twin.state[:3]
    white = np.argwhere((before == 255).all(axis=2)).mean(axis=0)
    np.testing.assert_allclose(white / 300 - (0.58, 1.13), (-y, x), atol=0.01)
    env.reset(seed=2)
    assert (env.render() != before).any()
    assert gymnasium.make("airpuck/SetPoint-v0").unwrapped.render() is None
    with pytest.raises(gymnasium.error.ResetNeeded):
        gymnasium.make("airpuck/SetPoint-v0", render_mode="rgb_array").unwrapped.render()


@pytest.mark.parametrize("name", ENVIRONMENTS)
def test_gymnasiums_checker_passes(name):
    check_env(gymnasium.make(f"airpuck/{name}-v0").unwrapped, skip_render_check=True)


def test_a_seed_determines_the_episode():
    env, other, commands = CourseEnv(), CourseEnv(), actions(20)
    first = flown(env, commands, seed=4)
    other.reset(seed=9)
    assert data_equivalence(flown(env, commands, seed=4), first, exact=True)
    assert data_equivalence(flown(other, commands, seed=4), first, exact=True)
    assert not data_equivalence(flown(env, commands, seed=5), first)


def test_an_episode_equals_a_flight_of_the_twin():
    # Without jitter the seed of the twin does not matter.
    settings = changed(NOISELESS, radio={"jitter_s": 0.0})
    start, commands = (0.2, -0.1, 1.0), actions(40)
    twin, env = Twin(MODEL, settings, pose=start), CourseEnv(twin=settings)
    env.reset(options={"start": start, "goal": (0.0, 0.0, 0.0)})
    seen = [(0.0, np.array(start))]
    for k, command in enumerate(commands):
        twin.send(command)
        latest = twin.wait_until((k + 1) * PERIOD)[-1]
        seen.append((latest.stamp, latest.values))
        observation, *_ = env.step(command)
        assert observation["time"][0] == (k + 1) * PERIOD
        np.testing.assert_array_equal(observation["pose"], latest.values)
        np.testing.assert_allclose(observation["pose_age"], (k + 1) * PERIOD - latest.stamp)
        np.testing.assert_array_equal(observation["sent"][0], command)
        (before, last), (now, pose) = seen[-2:]
        np.testing.assert_allclose(observation["pose_rate"], (pose - last) / (now - before))


def test_each_vector_environment_equals_a_single_one():
    settings, rows, limit = NOISELESS, 3, 0.15
    vector = CourseVectorEnv(rows, twin=settings, limit_s=limit)
    single = [CourseEnv(twin=settings, limit_s=limit) for _ in range(rows)]
    assert vector.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP
    assert vector.single_observation_space == single[0].observation_space
    observations, _ = vector.reset(seed=7)
    expected = [env.reset(seed=7 + row)[0] for row, env in enumerate(single)]
    over = [False] * rows
    for commands in actions(40, size=rows * 6).reshape(40, rows, 6):
        for name, values in observations.items():
            np.testing.assert_allclose(values, [each[name] for each in expected], atol=1e-8)
        assert vector.observation_space.contains(observations)
        observations, *ends, _ = vector.step(commands)
        for row, env in enumerate(single):
            if over[row]:
                expected[row], result = env.reset()[0], (0.0, False, False)
            else:
                expected[row], *result, _ = env.step(commands[row])
            np.testing.assert_allclose([end[row] for end in ends], result[:3], atol=1e-8)
            over[row] = bool(result[1] or result[2])


def test_a_seed_determines_the_vector_environment():
    env, commands = gymnasium.make_vec("airpuck/Race-v0", num_envs=2), actions(10, size=12)
    commands = commands.reshape(10, 2, 6)
    first = flown(env, commands, seed=4)
    assert data_equivalence(flown(env, commands, seed=4), first, exact=True)
    poses = first[-1][0]["pose"]
    assert not np.array_equal(poses[0], poses[1])


def test_a_camera_clock_offset_shifts_only_pose_ages():
    early = changed(NOISELESS, motion_capture={"clock_offset_s": -2.0})
    found = [flown(CourseEnv(twin=one), actions(5), seed=0) for one in (NOISELESS, early)]
    for (plain, *_), (shifted, *_) in zip(*found, strict=True):
        np.testing.assert_allclose(shifted["pose_age"], plain["pose_age"] + 2.0, atol=1e-9)
        np.testing.assert_allclose(shifted["pose_rate"], plain["pose_rate"], atol=1e-6)


@pytest.mark.parametrize(
    "action", [np.full(6, np.nan), [0.5, math.inf, 0, 0, 0, 0], np.zeros(5), 0.5, None, ["a"] * 6]
)
def test_an_action_that_is_not_a_command_is_rejected(action):
    env = CourseEnv()
    env.reset(seed=0)
    with pytest.raises(InputError, match="action: needs 6 finite numbers"):
        env.step(action)


def test_actions_beyond_the_range_are_clipped():
    env = CourseEnv()
    wild = flown(env, [np.array([-5.0, 9.0, 0.5, -0.1, 1.1, 1e300])] * 9, seed=0)
    tame = flown(env, [np.array([0.0, 1.0, 0.5, 0.0, 1.0, 1.0])] * 9, seed=0)
    assert data_equivalence(wild, tame, exact=True)


def test_misuse_is_reported_by_name():
    with pytest.raises(gymnasium.error.ResetNeeded):
        CourseEnv().step(np.zeros(6))
    for make, field in (
        (lambda: CourseEnv(course="rally"), "course"),
        (lambda: CourseEnv(render_mode="human"), "render_mode"),
        (lambda: CourseEnv(limit_s=math.nan), "limit_s"),
        (lambda: CourseVectorEnv(0), "num_envs"),
        (lambda: CourseEnv().reset(options={"goal": (9.0, 0.0, 0.0)}), "goal: is beyond"),
        (lambda: CourseEnv().reset(options={"gaol": (0.1, 0.0, 0.0)}), "did you mean 'goal'"),
        (lambda: CourseEnv().reset(options={"goal": "left"}), "goal"),
        (lambda: CourseVectorEnv(2).reset(options={"start": np.zeros((3, 3))}), "start"),
    ):
        with pytest.raises(InputError, match=field):
            make()


def test_rewards_add_up_to_the_decrease_of_the_remaining_length_minus_time():
    start, goal = np.array([-0.5, 0.1, 0.5]), np.array([0.3, -0.2, -0.5])
    env = CourseEnv()
    results = flown(env, actions(30), options={"start": start, "goal": goal})
    last = results[-1][0]["pose"]

    def remaining(pose):
        turn = abs(math.remainder(pose[2] - goal[2], 2 * math.pi))
        return math.dist(pose[:2], goal[:2]) + MODEL.vehicle.radius_m * turn

    total = sum(reward for _, reward, *_ in results[1:])
    assert total == pytest.approx(remaining(start) - remaining(last) - 30 * PERIOD, abs=1e-12)


def test_a_race_ends_at_the_goal_after_passing_all_points_in_order():
    task = CourseTask(MODEL, SETTINGS, "slalom", size=2)
    start, goal, points = COURSES["slalom"]
    for row in range(2):
        task.draw(row, np.random.default_rng(0), {})
    length = sum(math.dist(a, b) for a, b in pairwise([start[:2], *points, goal[:2]]))
    path = [*((*point, 0.0) for point in points), goal]
    # The second craft leaves out the first point.
    total = 0.0
    for row in path:
        poses = np.array([row, goal if row is path[0] else row], dtype=float)
        reward, there = task.judge(poses, np.zeros((2, 3)))
        total += reward[0]
    assert there.tolist() == [True, False]
    assert total == pytest.approx(length - len(path) * PERIOD, abs=1e-12)
    assert not task.judge(np.array([goal] * 2), np.full((2, 3), 0.1))[1].any()


@pytest.mark.slow
def test_the_baseline_reaches_a_goal_from_observations_alone():
    env = CourseEnv()
    options = {"start": (0.0, 0.0, 0.0), "goal": (0.2, 0.1, 0.5)}
    observation, _ = env.reset(seed=0, options=options)
    policy, over, late = env.baseline(), False, False
    while not (over or late):
        observation, _, over, late, info = env.step(policy(observation))
    assert info["is_success"]
    assert observation["time"][0] < 3.0


def test_an_export_registers_environments_for_its_craft(tmp_path, monkeypatch):
    table = Table(length_m=3.0, width_m=1.5)
    settings = SETTINGS.model_copy(update={"table": table})
    written = write(published_model("M2"), "gym", tmp_path / "my_craft", twin=settings)
    assert set(written.files) == {"__init__.py", "model.toml", "twin.toml"}
    monkeypatch.syspath_prepend(str(tmp_path))
    env = gymnasium.make("my_craft:my_craft/SetPoint-v0").unwrapped
    assert isinstance(env, CourseEnv)
    assert env.model.name == "M2"
    assert env.settings.table == table
    np.testing.assert_array_equal(
        env.model.parameters.thrust, published_model("M2").parameters.thrust
    )


def test_a_table_without_room_is_rejected(tmp_path):
    small = SETTINGS.model_copy(
        update={"table": Table(length_m=0.3, width_m=0.2, goal_width_m=0.1)}
    )
    with pytest.raises(InputError, match="table"):
        write(MODEL, "gym", tmp_path / "craft", twin=small)
    assert not (tmp_path / "craft").exists()
