"""Users' pilots: flown on the twin, by name from a file, and rejected if invalid."""

import json
import textwrap
from pathlib import Path

import numpy as np
import pytest

import airpuck
from airpuck.boundary.errors import InputError
from airpuck.control.reference import Target
from airpuck.flight.loop import check_pilot, pilot_maker
from airpuck.model.model_file import published_model
from tests.apparatus import commands as command_line
from tests.apparatus import typechecker

M3 = published_model("M3")

EXAMPLE = Path(__file__).parents[2] / "examples" / "own_pilot" / "spring.py"
SPRING = EXAMPLE.read_text()


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "my_pilot.py"
    path.write_text(SPRING)
    return path


def test_the_example_is_short():
    code = SPRING.partition("\n\n")[2]
    assert len([line for line in code.splitlines() if line.strip()]) <= 25


@pytest.mark.slow
def test_a_user_pilot_flies_by_name_from_the_command_line(file, tmp_path):
    points = tmp_path / "points.toml"
    points.write_text("setpoints = [{at_s = 0.5, x_m = 0.2, y_m = 0.1, yaw_rad = 0.3}]")
    ran = command_line.airpuck(
        *("track", "paper:M3", "--truth", "paper:M3", "--dwell", "5", "--json", "-"),
        *("--setpoints", points, "--law", f"{file}:Spring"),
    )
    (flight,) = json.loads(ran.stdout)["flights"]
    assert flight["gains"] is None and list(flight["outcomes"]) == ["open loop"]
    assert (flight["model"], flight["pilot"]) == ("M3", "Spring")
    (result,) = flight["setpoints"]
    assert result["set_point"] == {"x_m": 0.2, "y_m": 0.1, "yaw_rad": 0.3}
    assert abs(result["steady_state_error"]["x_m"]) < 0.1


@pytest.mark.slow
def test_a_pilot_with_clipped_commands_is_warned_about_by_name(file, tmp_path):
    file.write_text(SPRING.replace("(np.clip(", "(1.9 * np.clip("))
    points = tmp_path / "points.toml"
    points.write_text("setpoints = [{at_s = 0.2, x_m = 0.8, y_m = 0.3, yaw_rad = 3.0}]")
    ran = command_line.airpuck(
        *("track", "paper:M3", "--truth", "paper:M3", "--dwell", "0.3"),
        *("--setpoints", points, "--law", f"{file}:Spring", "-o", tmp_path / "page"),
    )
    assert ran.stderr.startswith(f"warning: commands of {file}:Spring from 0.057 to ")
    assert ran.stderr.endswith("were clipped to [0, 1]\n")
    assert "Spring" in ran.stdout
    page = (tmp_path / "page" / "index.html").read_text()
    assert "The set points of points.toml, flown with Spring (M3) on a twin of M3." in page


def pilot(**changes):
    """An instance of a class that lacks or changes something."""
    methods = {"step": lambda self, time: airpuck.Step(np.full(6, 0.03)), **changes}
    return type("Mine", (airpuck.Pilot,), methods)()


def test_a_subclass_of_pilot_needs_only_step():
    check_pilot(pilot())
    assert pilot().reference.at(0.0, 0.0).state[:3].tolist() == [0, 0, 0]
    check_pilot(airpuck.TrackingController(M3, airpuck.SetPoint(0, 0, 0)))


@pytest.mark.parametrize(
    ("wrong", "problem"),
    [
        (object(), "must have a `reference`"),
        (pilot(reference="here"), "must have a `reference`"),
        (pilot(sent=None), "lacks sent()"),
        (pilot(sent=lambda self, command: None), "sent() must take 2 arguments beside self"),
        (pilot(measured=lambda self, *, pose: None), "measured() must take 1 argument beside self"),
        (pilot(watches="puck"), "must have `watches`"),
        (pilot(watches=("pukc",)), "must have `watches`"),
    ],
)
def test_an_invalid_pilot_is_rejected_before_the_flight(wrong, problem):
    with pytest.raises(InputError, match="pilot") as refused:
        check_pilot(wrong)
    assert problem in str(refused.value)


@pytest.mark.parametrize(
    ("step", "problem"),
    [
        (lambda self, time: np.zeros(6), "step() must return airpuck.Step(command), not ndarray"),
        (lambda self, time: airpuck.Step(np.zeros(4)), "needs 6 finite numbers"),
        (
            lambda self, time: airpuck.Step(np.full(6, 50.0)),
            "pilot Mine: step() at 0.00 s: its command goes from 50 to 50, but motors take 0 to 1",
        ),
        (
            lambda self, time: airpuck.Step(np.full(6, np.nan if time > 0.05 else 0.1)),
            "pilot Mine: step() at 0.06 s: its command needs 6 finite numbers",
        ),
    ],
)
def test_an_invalid_command_is_rejected(step, problem):
    with pytest.raises(InputError) as refused:
        airpuck.fly(pilot(step=step), airpuck.Twin(M3), 0.1)
    assert problem in str(refused.value)


def test_commands_slightly_out_of_range_are_clipped_with_a_warning():
    log = airpuck.fly(
        pilot(step=lambda self, time: airpuck.Step(np.full(6, -0.2))), airpuck.Twin(M3), 0.02
    )
    assert log.warnings == ("commands of pilot Mine from -0.2 to -0.2 were clipped to [0, 1]",)


@pytest.mark.parametrize("lost", [None, 5, airpuck.PuckState(0, 0)])
def test_a_reference_lost_in_flight_is_named(lost):
    def step(self, time):
        typechecker.pause()
        self.reference = lost
        return airpuck.Step(np.zeros(6))

    with pytest.raises(InputError, match="pilot Mine: must have a `reference`"):
        airpuck.fly(pilot(step=step), airpuck.Twin(M3), 0.05)


def test_a_non_finite_reference_is_named():
    class Lost:
        def at(self, now, ahead):
            return Target(np.full(6, np.nan), np.zeros(3))

    with pytest.raises(InputError, match="pilot Mine: its reference must be 6 finite numbers"):
        airpuck.fly(pilot(reference=Lost()), airpuck.Twin(M3), 0.05)


@pytest.mark.parametrize(
    "beyond",
    [
        airpuck.TimedPath([0.0, 1.0], [(0, 0, 0), (5, 0, 0)]),
        airpuck.Rendezvous(1.0, (5, 0, 0, 0, 0, 0)),
        airpuck.Rendezvous(1.0, np.zeros(6), then=airpuck.SetPoint(0, 5, 0)),
        airpuck.SetPoints([0.0], [(0, 5, 0)]),
    ],
)
def test_a_reference_beyond_the_table_is_rejected(beyond):
    with pytest.raises(InputError, match=r"setpoint: .* is outside the table"):
        airpuck.fly(pilot(reference=beyond), airpuck.Twin(M3), 0.05)


@pytest.mark.parametrize(("duration", "period"), [(-1.0, 0.01), (1.0, 0.0), (1.0, 10.0)])
def test_a_flight_lasts_at_least_one_period(duration, period):
    with pytest.raises(InputError, match="period: must be above 0 and at most the duration"):
        airpuck.fly(pilot(), airpuck.Twin(M3), duration, period)


@pytest.mark.parametrize(
    ("text", "name", "problem"),
    [
        (SPRING, "{}:Springs", "has no class 'Springs'"),
        (SPRING, "{}", "must be FILE.py:NAME, such as my_law.py:Mine, not"),
        ("import nowhere_to_be_found", "{}:Spring", "cannot be imported: ModuleNotFoundError"),
        ("def (", "{}:Spring", "cannot be imported: SyntaxError"),
        (
            "class Spring:\n    pass",
            "{}:Spring",
            "cannot be made from (model, reference): TypeError",
        ),
    ],
)
def test_an_invalid_file_is_rejected(tmp_path, text, name, problem):
    path = tmp_path / "my_pilot.py"
    path.write_text(textwrap.dedent(text))
    with pytest.raises(InputError) as refused:
        pilot_maker(name.format(path))(M3, airpuck.SetPoint(0, 0, 0))
    assert problem in str(refused.value) and "--law" in str(refused.value)
