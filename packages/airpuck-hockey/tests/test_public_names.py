"""Public functions and objects reject impossible values by name, in one line."""

from functools import partial

import numpy as np
import pytest

import airpuck
import airpuck_hockey
from tests.apparatus import typechecker
from tests.apparatus.refusals import rejected

NAN = np.nan
M3 = airpuck.read_model("paper:M3")
HOME = airpuck.SetPoint(-0.9, 0.0, 0.0)


def intention(**changed):
    return airpuck_hockey.Intention(**{"kind": "defend", "reference": HOME} | changed)


def player(**changed):
    return airpuck_hockey.Player(M3, airpuck.AirHockey(), **changed)


WRONG = [
    ("kind", lambda: intention(kind="defnd")),
    ("reference", lambda: intention(reference=None)),
    ("meet", lambda: intention(meet=(NAN, 0.0, 0.0))),
    ("meet", lambda: intention(meet=(0.0, 0.0))),
    ("path", lambda: intention(path=np.zeros(3))),
    ("chance", lambda: intention(chance=5)),
    ("avoid", lambda: intention(avoid=(0.0, 0.0, -1.0))),
    ("opponent_radius", lambda: player(opponent_radius=NAN)),
    ("opponent_radius", lambda: player(opponent_radius=-1.0)),
    ("seed", lambda: player(seed=-1)),
    ("level", lambda: player(level="easy")),
    ("left", lambda: airpuck_hockey.Game("airpuck", "human")),
    ("pose", lambda: airpuck_hockey.PuckFilter(airpuck.AirHockey()).pose(0.0, np.zeros(2))),
    ("x", lambda: airpuck_hockey.PuckFilter(airpuck.AirHockey()).crossing(NAN)),
    ("goals", lambda: airpuck_hockey.Rules(goals=1.5)),
    ("thrust", lambda: airpuck_hockey.Level("weak")),
    ("games", partial(airpuck_hockey.match, "human", "human", True)),
    ("episodes", partial(airpuck_hockey.skills, M3, episodes=-1)),
    ("workers", partial(airpuck_hockey.match, "human", "keeper", workers="two")),
]


@pytest.fixture(autouse=True)
def unchecked():
    """Imports everything, and leaves the checks to airpuck."""
    assert all(hasattr(airpuck_hockey, name) for name in dir(airpuck_hockey))
    typechecker.pause()


@pytest.mark.parametrize(("field", "made"), WRONG)
def test_impossible_values_are_named(field, made):
    with rejected(field=field):
        made()


def test_lists_and_arrays_remain_accepted():
    assert intention(meet=np.zeros(3), avoid=[0, 0, 1], path=[[0.0, 0.0]]).kind == "defend"
