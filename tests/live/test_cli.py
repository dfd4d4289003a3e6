"""Input that the live commands reject before they join a graph."""

import pytest

from airpuck import InputError, Table
from airpuck.boundary.files import write_toml
from airpuck.cli import app as application
from airpuck.cli.live import Guarded
from airpuck.control.settings import ExcitationPlan
from airpuck.model.model_file import published_model

MODEL = "paper:M3"


def run(*arguments: str) -> None:
    application.app([*arguments], standalone_mode=False)


FLY, EXCITE = ("fly", MODEL), ("fly-excitation",)


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        ((*FLY, "--setpoint", "1", "0.3", "north"), "--setpoint: must be a valid number, not 'nor"),
        ((*FLY, "--setpoint", "-2", "0", "0"), r"setpoint: \(-2, 0\) is outside the geofence"),
        ((*FLY, "--setpoint", "0", "0", "0", "--dwell", "0"), "--dwell: must be from 0.1 to 1000 "),
        ((*FLY, "--dwell", "2"), "--dwell: applies to several --setpoint; give more"),
        ((*FLY, "--dwell", "2", "--setpoints", "p.toml"), "--setpoint; times are in the file"),
        ((*FLY, "--dwell", "2", "--plan", "p.toml"), "--setpoint; the plan has its own times"),
        ((*FLY, "--dwell", "2", "--follow"), "--setpoint; the node that publishes"),
        ((*FLY, "--setpoints", "p.toml", "--follow"), "--follow: cannot be combined with --setp"),
        ((*FLY, "--plan", "p.toml", "--setpoint", "0", "0", "0"), "--plan: cannot be combined wi"),
        ((*FLY, "--law", "nowhere.py:Mine"), "nowhere.py: --law: there is no such file"),
        ((*FLY, "--geofence", "1", "-1"), "--geofence: must be above 0, at most 100 m"),
        ((*FLY, "--interface", "wifi7"), "--interface: there is no network interface 'wifi7'"),
        ((*FLY, "--amplitude", "0.5"), "--amplitude: no such option"),
        ((*FLY, "--setpoints", "nowhere.toml"), r"nowhere.toml: there is no such file"),
        ((*EXCITE, "--hold", "0.001"), "hold: must be at least the controller's period"),
        ((*EXCITE, "--plan", "nowhere.toml"), "nowhere.toml: there is no such file"),
        ((*EXCITE, "--vehicle", "v.toml"), "v.toml: there is no such file"),
    ],
)
def test_bad_usage_ends_in_one_line(arguments, problem):
    with pytest.raises(InputError, match=problem):
        run(*arguments)


def test_an_estimator_is_rejected_for_a_pilot_without_one(tmp_path):
    (tmp_path / "mine.py").write_text(
        "import airpuck\n\nclass Mine(airpuck.Pilot):\n    def step(self, time): ...\n"
    )
    with pytest.raises(InputError, match=r"--estimator: .*mine.py:Mine has its own estimator"):
        run("fly", MODEL, "--law", f"{tmp_path / 'mine.py'}:Mine", "--estimator", "learning")


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("fly --model paper:M3 --law mpc", "airpuck fly paper:M3 --law mpc"),
        ("fly --law mpc --model=paper:M3", "airpuck fly paper:M3 --law mpc"),
        ("track --model a.toml --model b.toml", "airpuck track a.toml b.toml"),
        ("replay bag --model a.toml", "airpuck replay a.toml bag"),
        ("race slalom", "airpuck race paper:M3 slalom"),
        ("fly-setpoints points.toml", "airpuck fly MODEL --setpoints FILE"),
        ("fly-topic", "airpuck fly MODEL --follow"),
        ("fly-plan --plan p.toml", "airpuck fly MODEL --plan FILE"),
    ],
)
def test_an_outdated_command_line_is_rejected_with_its_replacement(old, new):
    with pytest.raises(InputError, match=f"{new}$"):
        application.commands()(old.split(), prog_name="airpuck", standalone_mode=False)


def a_plan(path, **changes):
    """Write a plan file of a craft that stays in place."""
    at = [0.5, 0.0, *[0.0] * 4, *[0.03] * 6]
    content = {
        "format": "airpuck plan 1",
        "motors": list(published_model("M3").vehicle.propeller_names),
        "lower_bound_s": 0.1,
        "reserve": 0.0,
        "times_s": [0.0, 0.1],
        "states": [at, at],
        "commands": [[0.03] * 6],
    }
    write_toml(path, content | changes)
    return path


def test_plans_of_the_wrong_kind_are_rejected(tmp_path):
    optimal, excitation = a_plan(tmp_path / "plan.toml"), tmp_path / "excitation.toml"
    ExcitationPlan().save(excitation)
    with pytest.raises(InputError, match=r"excitation.toml: .* expected a time-optimal plan"):
        run("fly", MODEL, "--plan", str(excitation))
    with pytest.raises(InputError, match=r"plan.toml: .* expected a plan of an excitation"):
        run("fly-excitation", "--plan", str(optimal))
    model = tmp_path / "model.toml"
    published_model("M3").save(model)
    with pytest.raises(InputError, match=r"model.toml: is a model; expected a time-optimal plan"):
        run("fly", MODEL, "--plan", str(model))


def test_a_plan_that_cannot_start_from_rest_in_the_geofence_is_rejected(tmp_path):
    with pytest.raises(InputError, match=r"plan.toml: leaves the geofence, ±0.4 m by ±1 m"):
        run("fly", MODEL, "--plan", str(a_plan(tmp_path / "plan.toml")), "--geofence", "0.4", "1")
    moving = [0.0, 0.0, 0.0, 0.5, 0.0, 0.0, *[0.03] * 6]
    path = a_plan(tmp_path / "moving.toml", states=[moving, moving])
    with pytest.raises(InputError, match=r"moving.toml: begins in motion"):
        run("fly", MODEL, "--plan", str(path))


def test_the_predictive_law_stays_within_the_geofence_or_the_rails():
    craft = published_model("M3")
    radius = craft.vehicle.radius_m
    fenced = Guarded(geofence=(0.6, 0.3)).bounds(craft)[1]
    assert fenced.reach(radius) == pytest.approx((0.6, 0.3))
    assert Guarded().bounds(craft)[1] == Table()


def test_a_vehicle_beside_a_model_is_rejected(tmp_path):
    published_model("M3").vehicle.save(tmp_path / "v.toml")
    with pytest.raises(InputError, match="--vehicle: a model includes its vehicle"):
        run("fly-excitation", "--model", MODEL, "--vehicle", str(tmp_path / "v.toml"))


def test_set_points_in_a_file_must_lie_within_the_geofence(tmp_path):
    points = tmp_path / "points.toml"
    write_toml(points, {"setpoints": [{"at_s": 0.0, "x_m": 0.9, "y_m": 0.0, "yaw_rad": 0.0}]})
    with pytest.raises(InputError, match=r"\(0.9, 0\)"):
        run("fly", MODEL, "--setpoints", str(points), "--geofence", "0.5", "0.5")


@pytest.mark.slow
def test_a_recorder_reports_a_full_disk(domain, tmp_path, monkeypatch):
    from airpuck.live.record import BagFile, record
    from airpuck.live.settings import LiveSettings

    def full(_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(BagFile, "flush", full)
    with pytest.raises(InputError, match=r"bag: cannot be written \(No space left on device\)"):
        record(tmp_path / "bag", LiveSettings(domain=domain, duration=5.0, quiet=True))
