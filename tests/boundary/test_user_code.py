"""Any misbehaviour of a user's tactic or pilot becomes one line that names its file."""

import json
import sys

import pytest

import airpuck
from airpuck.boundary.errors import InputError
from airpuck.boundary.extensions import UserCode
from airpuck.control.law import Moment, law_named
from airpuck.flight.loop import pilot_maker
from tests.apparatus import typechecker
from tests.apparatus.misdeeds import MISDEEDS, one_line, written

PILOT = """
class Mine(airpuck.Pilot):
    def __init__(self, model, reference):
        {init}wrong()
        self.where = {where}

    @property
    def reference(self):
        {reference}wrong()
        return self.where

    def step(self, time):
        {step}wrong()
        return airpuck.Step(np.full(6, 0.03))

    def pose(self, time, pose):
        {pose}wrong()

    def sent(self, time, command):
        {sent}wrong()
"""


def flown(name):
    airpuck.track(
        airpuck.read_model("paper:M3"),
        airpuck.SetPoint(0.1, 0.0, 0.0),
        0.1,
        make_pilot=pilot_maker(name),
    )


@pytest.mark.parametrize("misdeed", MISDEEDS.values(), ids=MISDEEDS)
@pytest.mark.parametrize("place", ["init", "reference", "step", "pose", "sent"])
def test_a_misbehaving_pilot_ends_in_one_line(tmp_path, capsys, place, misdeed):
    name = written(tmp_path, PILOT, place, misdeed)
    with pytest.raises(InputError) as error:
        flown(name)
    one_line(error, name, capsys)


def test_modules_next_to_the_file_can_be_imported_and_shadow_none(tmp_path):
    (tmp_path / "beside_it.py").write_text("number = 5\n")
    (tmp_path / "json.py").write_text("1 / 0\n")
    (tmp_path / "mine.py").write_text("import json\nimport beside_it\ndef mine(): return json\n")
    try:
        assert UserCode(f"{tmp_path / 'mine.py'}:mine", "--law").kind() is json
    finally:
        sys.path.remove(str(tmp_path))
        del sys.modules["beside_it"]


def test_a_folder_is_rejected_as_a_code_file(tmp_path):
    (tmp_path / "mine.py").mkdir()
    with pytest.raises(InputError, match=r"mine\.py: tactic: is a folder"):
        UserCode(f"{tmp_path / 'mine.py'}:Mine", "tactic")


def test_a_law_with_a_non_finite_command_is_named_by_its_file(tmp_path):
    file = tmp_path / "mine.py"
    file.write_text(
        "import airpuck\n"
        "class Mine(airpuck.Law):\n"
        "    def step(self, state, moment):\n"
        "        return airpuck.Step([float('nan')] * 6), state\n"
    )
    law = law_named(f"{file}:Mine")(None, None, None)
    typechecker.pause()
    with pytest.raises(InputError, match=r"mine\.py:Mine: .*command: must be finite numbers"):
        law.step(None, Moment(airpuck.SetPoint(0, 0, 0), 0.0, 0.0, lambda: None))


def test_a_misbehaving_reference_of_a_pilot_ends_in_one_line(tmp_path, capsys):
    name = written(tmp_path, PILOT, "at")
    with pytest.raises(InputError) as error:
        flown(name)
    one_line(error, name, capsys)
