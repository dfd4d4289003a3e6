"""Skills: starts as published, and a small sibling of the long run."""

import math

import numpy as np
import pytest

from airpuck.boundary.errors import InputError
from airpuck.craft.table import AirHockey, Table
from airpuck.hockey.player import pitch_of
from airpuck.hockey.skills import SKILLS, Skill, Stage, episode, skills
from airpuck.model.model_file import read_model
from airpuck.twin.plant import build_plant
from airpuck.twin.settings import default_twin_settings

MODEL, PLAY = read_model("paper:M3"), AirHockey()
SETTINGS = default_twin_settings().with_delay(MODEL.transport_delay)


def test_the_interval_is_wilsons():
    # By his formula.
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
    """A stage on which no episode goes beyond its start."""

    def twin(self, puck, seed):
        raise Begun(puck)


def start_of(stage, name, number):
    with pytest.raises(Begun) as begun:
        episode(stage, name, [0, number])
    return begun.value.args[0]


@pytest.mark.parametrize("name", SKILLS)
def test_starts_are_the_challenges_on_this_table(name):
    stage = Starts(MODEL, SETTINGS, build_plant(MODEL, SETTINGS), pitch_of(MODEL, PLAY))
    starts = np.array([start_of(stage, name, number) for number in range(80)])
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


@pytest.mark.slow
def test_a_few_episodes_of_each():
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
def test_a_table_without_room_is_refused(table, names):
    with pytest.raises(InputError) as error:
        skills(
            MODEL, settings=SETTINGS.model_copy(update={"table": table}), episodes=1, names=names
        )
    assert error.value.field == "table"


def test_skills_measure_a_tactic_of_the_users(tmp_path):
    (tmp_path / "mine.py").write_text(
        "class Fails:\n    def decide(self, view):\n        raise RuntimeError('mine')\n"
    )
    with pytest.raises(InputError, match=r"mine\.py:Fails.*RuntimeError: mine"):
        skills(MODEL, episodes=1, names=("defend",), tactic=f"{tmp_path / 'mine.py'}:Fails")
