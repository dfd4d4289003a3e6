"""Environments of air hockey against the official checkers, and the package's own skills."""

import math
import sys
from dataclasses import replace
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env, data_equivalence
from pettingzoo.test import parallel_api_test, parallel_seed_test

from airpuck import InputError, Pilot, PuckState, Step, Table
from airpuck.export import write
from airpuck.model.model_file import published_model
from airpuck.twin.settings import OnBoard
from airpuck_hockey.export.gym import ENVIRONMENTS, PuckEnv
from airpuck_hockey.export.gym_game import GameEnv
from airpuck_hockey.game.skills import SKILLS, skills
from tests.apparatus.environments import MODEL, NOISELESS, PERIOD, SETTINGS, actions, flown

# Gymnasium warns of infinite bounds, which rates have.
pytestmark = pytest.mark.filterwarnings("ignore::UserWarning")


def test_games_are_rendered_and_render_modes_are_checked():
    game = GameEnv(render_mode="rgb_array")
    game.reset(seed=0)
    picture = game.render()
    assert picture is not None
    left, right = picture[:, : picture.shape[1] // 2], picture[:, picture.shape[1] // 2 :]
    for half, own, other in ((left, (0, 114, 178), (213, 94, 0)), (right, (213, 94, 0), None)):
        assert (half == own).all(axis=2).any()
        assert other is None or not (half == other).all(axis=2).any()
    with pytest.raises(InputError, match="render_mode"):
        GameEnv(render_mode="human")


class Shaky(Pilot):
    """A pilot, in place of the package's player, whose commands depend on time alone."""

    count = 0

    def __init__(self, *_, **__):
        Shaky.count, self.commands = 0, actions(200)

    def step(self, time):
        Shaky.count += 1
        return Step(self.commands[round(time / PERIOD)])


@pytest.mark.slow
@pytest.mark.parametrize("name", SKILLS)
def test_skills_succeed_as_in_the_package(name, monkeypatch):
    monkeypatch.setattr("airpuck_hockey.game.skills.Player", Shaky)
    for module in ("airpuck_hockey.game.skills", "airpuck_hockey.export.gym"):
        monkeypatch.setattr(f"{module}.LONGEST", 1.0)
    blind = SETTINGS.model_copy(update={"on_board": OnBoard(rate_hz=0.0)})
    ends = []
    skills(
        MODEL,
        settings=blind,
        episodes=3,
        names=(name,),
        progress=lambda _, done, successes: ends.append((successes, Shaky.count)),
    )
    env, successes = PuckEnv(name), 0
    for k, (expected, count) in enumerate(ends):
        env.np_random = np.random.default_rng([0, k])
        env.reset()
        for command in actions(200):
            observation, reward, over, late, info = env.step(command)
            if over or late:
                break
        successes += info["is_success"]
        assert reward == info["is_success"]
        assert successes == expected
        # The flight sends one more command before it is known to be over.
        assert round(observation["time"][0] / PERIOD) == (count if late else count - 1)


def test_the_first_observation_includes_the_motion_of_the_puck():
    observation, _ = PuckEnv("defend").reset(seed=3)
    assert 1.0 <= np.hypot(*observation["puck_rate"][:2]) <= 3.0


def test_pettingzoos_checkers_pass():
    parallel_api_test(GameEnv(limit_s=0.2), num_cycles=30)
    parallel_seed_test(GameEnv, num_cycles=10)


def test_a_seed_determines_the_game():
    one, two, found = GameEnv(), GameEnv(), []
    for env in (one, two, one):
        results = [env.reset(seed=3)]
        for left, right in zip(actions(10), actions(10, seed=1), strict=True):
            results.append(env.step({"left": left, "right": right}))
        found.append(results)
    assert data_equivalence(found[0], found[1], exact=True)
    assert data_equivalence(found[0], found[2], exact=True)


def test_both_sides_observe_the_same_game():
    radio = NOISELESS.radio.model_copy(update={"jitter_s": 0.0})
    # With its centre of mass in the body's frame, a craft flies the same in every direction.
    craft = replace(MODEL, frame="body")
    env = GameEnv(craft, NOISELESS.model_copy(update={"radio": radio}))
    observations, _ = env.reset(seed=0)
    for command in actions(30):
        left, right = observations["left"], observations["right"]
        for name in ("pose_rate", "mallet_rate", "pose_age", "sent"):
            np.testing.assert_allclose(left[name], right[name], atol=1e-9)
        for name in ("pose", "mallet"):
            np.testing.assert_allclose(left[name][:2], right[name][:2], atol=1e-9)
            assert math.cos(left[name][2] - right[name][2]) == pytest.approx(1.0, abs=1e-12)
        np.testing.assert_allclose(left["puck"][:2], -right["puck"][:2], atol=1e-9)
        observations, *_ = env.step({"left": command, "right": command})


@pytest.mark.parametrize(("towards", "winner"), [(1, "left"), (-1, "right")])
def test_a_goal_is_rewarded(towards, winner):
    env = GameEnv()
    env.reset(seed=0)
    assert env.game.world.puck is not None
    # Beside the disc that defends the goal.
    env.game.world.puck.place(PuckState(towards * 0.8, 0.15, 0.0, towards * 3.0, 0.0, 0.0))
    rewards, total = {}, 0.0
    for _ in range(40):
        idle = dict.fromkeys(env.agents, np.zeros(6))
        _, rewards, terminated, truncated, infos = env.step(idle)
        total += sum(rewards.values())
        if not env.agents:
            break
    loser = {"left": "right", "right": "left"}[winner]
    assert rewards == {winner: 1.0, loser: -1.0}
    assert total == 0.0
    assert all(terminated.values())
    assert not any(truncated.values())
    assert infos[winner] == {"score": (1, 0)}
    assert infos[loser] == {"score": (0, 1)}


def test_a_game_needs_two_actions():
    env = GameEnv()
    env.reset(seed=0)
    with pytest.raises(InputError, match="right: has no action"):
        env.step({"left": np.zeros(6)})
    # The game continues.
    observations, *_ = env.step(dict.fromkeys(env.agents, np.zeros(6)))
    assert observations["left"]["time"] == PERIOD


def test_pictures_show_the_craft_in_place():
    env: Any = gymnasium.make("airpuck/Defend-v0", render_mode="rgb_array").unwrapped
    env.reset(seed=1)
    before = env.render()
    # Room for rails of 3 cm, 300 pixels per metre.
    assert before.shape == (round(300 * 1.16), round(300 * 2.26), 3)
    x, y, _ = env._twin.state[:3]
    white = np.argwhere((before == 255).all(axis=2)).mean(axis=0)
    np.testing.assert_allclose(white / 300 - (0.58, 1.13), (-y, x), atol=0.01)


@pytest.mark.parametrize("name", ENVIRONMENTS)
def test_gymnasiums_checker_passes(name):
    check_env(gymnasium.make(f"airpuck/{name}-v0").unwrapped, skip_render_check=True)


def test_a_seed_determines_the_episode():
    env, other, commands = PuckEnv("hit"), PuckEnv("hit"), actions(20)
    first = flown(env, commands, seed=4)
    other.reset(seed=9)
    assert data_equivalence(flown(env, commands, seed=4), first, exact=True)
    assert data_equivalence(flown(other, commands, seed=4), first, exact=True)
    assert not data_equivalence(flown(env, commands, seed=5), first)


def test_an_unknown_skill_is_named():
    with pytest.raises(InputError, match="skill"):
        PuckEnv("juggle")


def test_an_export_registers_environments_for_its_craft(tmp_path, monkeypatch):
    table = Table(length_m=3.0, width_m=1.5)
    settings = SETTINGS.model_copy(update={"table": table})
    craft = published_model("M2")
    written = write(craft, "gym-hockey", tmp_path / "my_player", twin=settings)
    assert set(written.files) == {"__init__.py", "model.toml", "twin.toml"}
    monkeypatch.syspath_prepend(str(tmp_path))
    env = gymnasium.make("my_player:my_player/Hit-v0").unwrapped
    assert isinstance(env, PuckEnv)
    assert env.model.name == "M2"
    assert env.settings.table == table
    assert sys.modules["my_player"].game(limit_s=5.0).settings.table == table
