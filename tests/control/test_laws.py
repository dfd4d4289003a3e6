"""Users' laws: by name from a file or a registry, and rejected if invalid."""

import json
import textwrap
from pathlib import Path

import numpy as np
import pytest

import airpuck
from airpuck import MPC, InputError
from airpuck.control.law import LawOptions, law_named
from airpuck.control.laws import LAWS
from airpuck.control.tuning import default_tuning
from airpuck.model.model_file import published_model
from airpuck.twin.experiments import track
from tests.apparatus import commands as command_line

M3 = published_model("M3")
EXAMPLE = Path(__file__).parents[2] / "examples" / "own_law" / "pid.py"
PID = f"{EXAMPLE}:PID"


def test_the_example_is_short():
    code = EXAMPLE.read_text().partition("\n\n")[2]
    assert len([line for line in code.splitlines() if line.strip()]) <= 25


@pytest.mark.slow
def test_a_user_law_reaches_its_set_point_and_keeps_its_state():
    controller = airpuck.TrackingController(
        M3, airpuck.SetPoint(0.4, -0.1, 0.5), default_tuning().with_law(PID)
    )
    np.testing.assert_array_equal(controller.state, np.zeros(3))
    twin = airpuck.Twin(M3)
    log = airpuck.fly(controller, twin, 2.0)
    assert set(log.status[10:]) == {"exact"}
    arrived = twin.truth[1][-1, :3]
    np.testing.assert_allclose(arrived, [0.4, -0.1, 0.5], atol=0.015)
    assert np.abs(controller.state).max() > 0


def test_a_law_registered_in_python_is_found_by_name(monkeypatch):
    monkeypatch.setitem(LAWS, "mine", law_named(PID))
    tuning = default_tuning().with_law("mine")
    log = track(M3, airpuck.SetPoint(0.1, 0.0, 0.0), 0.3, tuning=tuning)
    assert log.status[-1] == "exact"


class Creep(airpuck.Law):
    """Gives every motor the same command."""

    def __init__(self, model, tuning, options=None, level=0.2):
        self.command = np.full(model.vehicle.n_propellers, level)

    def step(self, state, moment):
        return airpuck.Step(self.command), state


def test_a_law_is_given_by_name_class_or_object():
    goal, own = airpuck.SetPoint(0.1, 0.0, 0.0), Creep(M3, default_tuning(), level=0.3)
    for law, kind, level in (("mpc", MPC, None), (Creep, Creep, 0.2), (own, Creep, 0.3)):
        controller = airpuck.TrackingController(M3, goal, law=law, compiled=False)
        controller.pose(0.0, np.zeros(3))
        assert type(controller.law) is kind
        assert level is None or (controller.step(0.0).command == level).all()
    recording = track(M3, goal, 0.2, law=Creep).recording
    assert (recording["command"].values[5:] == 0.2).all()
    assert "a law of its own" in recording.source


def test_settings_of_a_user_law_are_given_under_its_name(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("mine.py").write_text(
        textwrap.dedent("""
            import airpuck, numpy as np

            class Level(airpuck.LawSettings):
                law = "Creep"
                level: float = 0.2

            class Creep(airpuck.Law):
                Settings = Level

                def __init__(self, model, tuning, options=None):
                    self.command = np.full(6, tuning.of(Level).level)

                def step(self, state, moment):
                    return airpuck.Step(self.command), state
        """)
    )
    Path("tuning.toml").write_text('law.kind = "mine.py:Creep"\n[law."mine.py:Creep"]\nlevel = 0.4')
    tuned = airpuck.read_tuning("tuning.toml")
    for tuning, level in ((tuned, 0.4), (default_tuning().with_law("mine.py:Creep"), 0.2)):
        controller = airpuck.TrackingController(M3, airpuck.SetPoint(0, 0, 0), tuning)
        controller.pose(0.0, np.zeros(3))
        assert (controller.step(0.0).command == level).all()
    tuned.save("again.toml")
    assert airpuck.read_tuning("again.toml") == tuned
    Path("tuning.toml").write_text('[law."mine.py:Creep"]\nlevle = 0.4')
    with pytest.raises(InputError, match=r"Creep\.levle: is not a known key; did you mean level"):
        airpuck.read_tuning("tuning.toml")


def test_a_name_that_makes_no_law_is_rejected(monkeypatch):
    monkeypatch.setitem(LAWS, "mine", lambda *given: object())
    with pytest.raises(InputError, match=r"law: must inherit from airpuck\.Law"):
        airpuck.TrackingController(M3, airpuck.SetPoint(0.1, 0.0, 0.0), law="mine")


def test_a_step_changes_only_the_state_that_it_returns():
    controller = airpuck.TrackingController(
        M3, airpuck.SetPoint(0.3, 0.0, 0.0), default_tuning().with_law("mpc"), compiled=False
    )
    controller.pose(0.0, np.zeros(3))
    begun = controller.state
    first = controller.step(0.0).command
    moved = controller.state
    assert moved is not begun and np.abs(moved.plan - begun.plan).max() > 0
    # Apart from the solver's last active set, the same state gives the same command.
    controller.state = begun
    np.testing.assert_allclose(controller.step(0.0).command, first, atol=1e-6)


@pytest.mark.slow
def test_a_user_law_flies_by_name_from_the_command_line(tmp_path):
    points = tmp_path / "points.toml"
    points.write_text("setpoints = [{at_s = 0.5, x_m = 0.2, y_m = 0.1, yaw_rad = 0.3}]")
    ran = command_line.airpuck(
        *("track", "paper:M3", "--truth", "paper:M3", "--dwell", "3", "--json", "-"),
        *("--setpoints", points, "--law", PID),
    )
    (flight,) = json.loads(ran.stdout)["flights"]
    assert flight["law"] == PID and flight["gains"] is None
    (result,) = flight["setpoints"]
    assert abs(result["steady_state_error"]["x_m"]) < 0.05


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("class PID:\n    def __init__(self, *given): ...", "must inherit from airpuck.Law"),
        ("class PID:\n    pass", "cannot be made from (model, tuning, options): TypeError"),
        ("class Other:\n    pass", "has no class 'PID'"),
    ],
)
def test_classes_that_are_not_laws_are_rejected(tmp_path, text, problem):
    path = tmp_path / "mine.py"
    path.write_text(textwrap.dedent(text))
    with pytest.raises(InputError) as refused:
        law_named(f"{path}:PID")(M3, default_tuning(), LawOptions())
    assert problem in str(refused.value) and "--law" in str(refused.value)
