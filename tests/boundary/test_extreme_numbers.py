"""Extreme values of every number in settings files: rejected in one line, or results are finite."""

import copy
import tomllib

import numpy as np
import pytest
import tomli_w

import airpuck
from airpuck import AirHockey, InputError
from airpuck.boundary.numbers import percent
from airpuck.control.lqr import LQRSettings
from airpuck.control.reference import read_setpoints
from airpuck.control.tuning import default_tuning
from airpuck.craft.vehicle import default_vehicle
from airpuck.model.model_file import nominal_model
from airpuck.physics.puck_on_table import PuckOnTable
from airpuck.twin.play import HandMallet
from airpuck.twin.settings import default_twin_settings

EXTREMES = (1e308, 5e-324, 1e18, 0, -1)
M3 = airpuck.read_model("paper:M3")


def simulated(model):
    n = model.vehicle.n_propellers
    return model.simulate(np.zeros(6 + n), np.full((20, n), 0.5))


def slid(play):
    """A puck that bounces and a mallet that moves."""
    puck = PuckOnTable(play, airpuck.PuckState(0.0, 0.1, 0.0, 3.0, 2.0, 5.0), logs=False)
    puck.run(0.2)
    mallet = HandMallet(play.mallet, play.table, 0.0, 0.0)
    mallet.target = 0.1, 0.1
    return [*puck.state, mallet.x, mallet.y]


READERS = {
    "vehicle": (
        default_vehicle().model_dump(mode="json"),
        lambda path: simulated(nominal_model(airpuck.read_vehicle(path))),
    ),
    "table": (
        AirHockey().model_dump(mode="json", exclude_none=True),
        lambda path: slid(airpuck.read_table(path)),
    ),
    "twin": (
        default_twin_settings().model_dump(mode="json", exclude_none=True),
        lambda path: slid(airpuck.read_twin_settings(path)),
    ),
    "tuning": (
        default_tuning().model_dump(mode="json", exclude_none=True),
        lambda path: list(airpuck.read_tuning(path).of(LQRSettings).weights.errors),
    ),
    "set points": (
        {"setpoints": [{"at_s": 0.5, "x_m": 0.2, "y_m": 0.1, "yaw_rad": 0.3}]},
        lambda path: read_setpoints(path).at(0.0, 0.0).state,
    ),
    "model": (None, lambda path: simulated(airpuck.read_model(str(path)))),
}


def leaves(content, place=()):
    """Return the places of numbers in a file; of a list, the first."""
    if isinstance(content, dict):
        for key, value in content.items():
            yield from leaves(value, (*place, key))
    elif isinstance(content, list):
        for number, value in enumerate(content[:1]):
            yield from leaves(value, (*place, number))
    elif isinstance(content, int | float) and not isinstance(content, bool):
        yield place


@pytest.mark.slow
@pytest.mark.parametrize("kind", READERS)
def test_an_extreme_number_is_rejected_or_harmless(tmp_path, kind):
    content, use = READERS[kind]
    path = tmp_path / "file.toml"
    if content is None:
        M3.save(path)
        content = tomllib.loads(path.read_text())
    refused = 0
    for place in leaves(content):
        for number in EXTREMES:
            changed = inner = copy.deepcopy(content)
            for key in place[:-1]:
                inner = inner[key]
            inner[place[-1]] = number
            path.write_text(tomli_w.dumps(changed))
            try:
                assert np.isfinite(use(path)).all(), (place, number)
            except InputError as error:
                refused += 1
                assert "\n" not in str(error)
                assert str(path) in str(error), (place, number)
            except (OverflowError, FloatingPointError, ValueError, ZeroDivisionError) as error:
                raise AssertionError(place, number) from error
    assert refused


def test_a_mass_of_1e308_names_its_field(tmp_path):
    (tmp_path / "table.toml").write_text("[puck]\nmass_kg = 1e308\n")
    with pytest.raises(InputError, match=r"puck: mass_kg = 1e\+308 must be within ±10000"):
        airpuck.read_table(tmp_path / "table.toml")


def test_a_byte_order_mark_is_ignored(tmp_path):
    (tmp_path / "table.toml").write_bytes(b"\xef\xbb\xbf[puck]\nmass_kg = 0.02\n")
    assert airpuck.read_table(tmp_path / "table.toml").puck.mass_kg == 0.02


def test_percentages_keep_their_sign():
    assert [percent(x) for x in (0.012, -0.012, 0.2, -0.2)] == ["1.2 %", "-1.2 %", "20 %", "-20 %"]
