"""Skills: starts as published, and a short version of the long run."""

import math

import numpy as np
import pytest

from airpuck import AirHockey, InputError, PuckState, SetPoint, Table
from airpuck.model.model_file import read_model
from airpuck.twin.plant import build_plant
from airpuck.twin.settings import default_twin_settings
from airpuck_hockey import Intention
from airpuck_hockey.game.skills import SKILLS, Skill, Stage, episode, skills
from airpuck_hockey.player.player import pitch_of

MODEL, PLAY = read_model("paper:M3"), AirHockey()
SETTINGS = default_twin_settings().with_usual_delay(MODEL.transport_delay)
PLANT = build_plant(MODEL, SETTINGS)


def test_the_interval_is_wilsons():
    # By Wilson's formula.
    n, k, z = 200, 188, 1.959964
    share = k / n
    middle = (share + z * z / (2 * n)) / (1 + z * z / n)
    half = z / (1 + z * z / n) * math.sqrt(share * (1 - share) / n + z * z / (4 * n * n))
    np.testing.assert_allclose(
        Skill(k, n, 0).interval_95, [middle - half, middle + half], rtol=1e-6
    )


class Begun(Exception):
    """An episode begins with a puck."""


class Starts(Stage):
    """A stage whose episodes end at their start."""

    def twin(self, puck, seed):
        raise Begun(puck)


def start_of(stage, name, number):
    with pytest.raises(Begun) as begun:
        episode(stage, name, [0, number])
    return begun.value.args[0]


@pytest.mark.parametrize("name", SKILLS)
def test_starts_are_the_challenges_scaled_to_this_table(name):
    stage = Starts(MODEL, SETTINGS, PLANT, pitch_of(MODEL, PLAY))
    starts = np.array([start_of(stage, name, number) for number in range(40)])
    x, y, _, vx, vy, spin = starts.T
    speed, along = np.hypot(vx, vy), 2.2 / 1.948
    if name == "defend":
        assert (x.min() > 0.29 * along - 1e-9) and (x.max() < 0.65 * along + 1e-9)
        assert (speed > 1 - 1e-9).all() and (speed < 3 + 1e-9).all() and np.ptp(speed) > 1.5
        assert (vx < 0).all() and (np.abs(np.arctan2(vy, -vx)) < 0.5 + 1e-9).all()
        assert np.abs(spin).max() > 5
    else:
        assert (x < -0.2 * along + 1e-9).all()
        room = 1.1 / 2 - PLAY.puck.radius_m - 2 * 0.07
        if name == "hit":
            assert (np.abs(y) < room).all() and (speed < 0.5 + 1e-9).all() and np.ptp(speed) > 0.3
            # In nearly all directions, but more towards the craft.
            assert vy.min() < -0.1 and vy.max() > 0.1 and vx.min() < -0.3
        else:
            near_rail = np.abs(y) > room - 1e-9
            assert (near_rail | (x < -0.8 * along + 1e-9)).all() and not speed.any()


class Placed(Stage):
    """A stage with another start of the puck."""

    start = PuckState(0.0, 0.0)

    def twin(self, puck, seed):
        return super().twin(self.start, seed)


class Idle:
    """A tactic that stays at home and counts its decisions."""

    def __init__(self):
        self.decisions = 0

    def decide(self, view):
        self.decisions += 1
        return Intention("home", SetPoint(*view.pitch.home, 0.0))


@pytest.mark.parametrize(
    ("name", "start", "result"),
    [
        # A puck that rests ends the episode: anywhere in the own half, or where it can be shot.
        ("defend", PuckState(-0.4, 0.1), (True, True)),
        ("prepare", PuckState(-0.4, 0.1), (True, True)),
        # A puck out of reach, or in a goal, also ends it.
        ("defend", PuckState(0.6, 0.1, 0.0, 0.5, 0.0), (True, False)),
        ("hit", PuckState(0.6, 0.1, 0.0, 0.5, 0.45), (False, False)),
        ("hit", PuckState(0.6, 0.0, 0.0, 1.5, 0.0), (True, False)),
        ("defend", PuckState(-1.09, 0.12, 0.0, -3.0, 0.0), (False, False)),
        ("prepare", PuckState(-1.09, 0.12, 0.0, -3.0, 0.0), (False, False)),
    ],
)
def test_an_episode_ends_when_its_outcome_is_certain(name, start, result):
    idle = Idle()
    stage = Placed(MODEL, SETTINGS, PLANT, pitch_of(MODEL, PLAY), lambda: idle)
    object.__setattr__(stage, "start", start)
    assert episode(stage, name, [0, 0]) == result
    assert idle.decisions < 15


@pytest.mark.slow
def test_a_few_episodes_of_each_skill_succeed():
    found = skills(MODEL, episodes=3, seed=5)
    assert found["defend"].successes == 3
    assert found["hit"].successes >= 2
    assert found["prepare"].successes >= 1


@pytest.mark.parametrize(
    "table, names",
    [
        (Table(length_m=0.5, width_m=0.25, goal_width_m=0.1), ("hit",)),
        (Table(length_m=0.3, width_m=0.6, goal_width_m=0.1), ("hit",)),  # it fills its half
    ],
)
def test_a_table_without_room_is_rejected(table, names):
    with pytest.raises(InputError) as error:
        skills(
            MODEL, settings=SETTINGS.model_copy(update={"table": table}), episodes=1, names=names
        )
    assert error.value.field == "table"


def test_skills_are_measured_for_a_user_tactic(tmp_path):
    (tmp_path / "mine.py").write_text(
        "class Fails:\n    def decide(self, view):\n        raise RuntimeError('mine')\n"
    )
    with pytest.raises(InputError, match=r"mine\.py:Fails.*RuntimeError: mine"):
        skills(MODEL, episodes=1, names=("defend",), tactic=f"{tmp_path / 'mine.py'}:Fails")
