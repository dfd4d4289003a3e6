"""`airpuck plan` and `airpuck race`: the contract with scripts, mostly without long searches."""

import json
from dataclasses import replace

import numpy as np
import pytest

import airpuck as package
from airpuck.model.model_file import published_model
from airpuck.planning.plan import Plan, Start, read_plan

from ..apparatus.commands import airpuck, ran, refused

FROM, TO = ("--from", 0, 0, 0), ("--to", 0.3, 0, 0)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ((*FROM, "--to", 2, 0, 0), "--to: (2, 0) is outside the rails"),
        (("--from", 2, 0, 0, *TO), "--from: (2, 0) is outside the rails"),
        ((*FROM, "--to", 0, 0, 0), "--to: is where the craft is already"),
        ((*FROM, "--to", 0.3, 0), "--to"),
        ((*FROM, "--to", 0.3, 0, "east"), "--to"),
        (FROM, "--to"),
        (("--from", 0, 0, "nan", *TO), "--from: must be from -100 to 100"),
        ((*FROM, *TO, "--keep-out", 0, 0, "x"), "--keep-out: must be a valid number"),
        ((*FROM, *TO, "--reserve", 1), "--reserve: must be from 0 to 0.9"),
        ((*FROM, *TO, "--free", "both", "--end-velocity", 1, 0, 0), "--end-velocity: is given and"),
        ((*FROM, *TO, "--sped", 1), "did you mean --speed?"),
        ((*FROM, *TO, "--turn", "exct"), "--turn: must be 'shorter' or 'exact', not 'exct'"),
        ((*FROM, *TO, "--free", "yaw", "--turn", "exact"), "--turn: has no effect on a free yaw"),
        ((*FROM, *TO, "--spin", 0), "--spin: must be from 0.1 to 40 rad/s"),
        ((*FROM, *TO, "--speed", 0), "--speed: must be from 0.01 to 20 m/s"),
        ((*FROM, *TO, "--via", 0.1, 0.9), "--via: (0.1, 0.9) is outside the rails"),
        ((*FROM, *TO, "--via", 0.1), "--via"),
        ((*FROM, *TO, "--via", 0.1, "nan"), "--via: must be from -100 to 100"),
        (("none.toml", *FROM, *TO), "none.toml: there is no such file"),
        ((*FROM, *TO, "-o", "/proc/none/plan.toml"), "/proc/none/plan.toml"),
    ],
)
def test_bad_requests_end_in_one_line(tmp_path, arguments, said):
    process = airpuck("plan", *arguments, cwd=tmp_path)
    assert refused(process, said)
    assert process.stdout == ""
    assert not list(tmp_path.iterdir())


def test_a_file_of_another_kind_is_named(tmp_path):
    from airpuck.craft.vehicle import default_vehicle

    default_vehicle().save(tmp_path / "quad.toml")
    assert refused(airpuck("plan", "quad.toml", *FROM, *TO, cwd=tmp_path), "quad.toml")


@pytest.fixture
def searched(monkeypatch):
    """Record the search's request; the search finds a plan at once."""
    asked, model = {}, published_model("M3")

    def search(belief, start, goal, **options):
        asked.update(options, start=start, goal=goal)
        states = np.zeros((2, 12))
        states[1, 0] = 0.3
        found = Plan(model, np.array([0.0, 0.5]), states, np.full((1, 6), 0.1), None)
        return replace(found, starts=(Start("straight", 0.5, "Solve_Succeeded"),))

    monkeypatch.setattr(package, "plan", search)
    return asked


def test_json_is_the_only_standard_output(searched, tmp_path):
    process = airpuck("plan", *FROM, *TO, "--json", "-", "-o", "plan.toml", cwd=tmp_path)
    assert (process.returncode, process.stderr) == (0, "")
    figures = json.loads(process.stdout)
    assert {"time_s", "lower_bound_s", "converged", "starts"} <= set(figures)
    assert figures["lower_bound_s"] is None
    assert read_plan(tmp_path / "plan.toml", published_model("M3")).duration == 0.5


def test_rare_options_may_be_given_in_a_file(searched, tmp_path):
    file = tmp_path / "careful.toml"
    file.write_text("reserve = 0.1\nkeep_out = [[0.0, 0.2, 0.05]]\nvia = [[0.1, 0.1], [0.2, 0.0]]")
    asks = ("plan", *FROM, *TO, "--settings", "careful.toml", "--reserve", 0.2, "--via", -0.1, 0)
    assert airpuck(*asks, cwd=tmp_path).returncode == 0
    assert searched["limits"].reserve == 0.2  # the command line takes precedence
    assert list(searched["via"]) == [(-0.1, 0.0)]
    assert list(searched["keep_out"]) == [(0.0, 0.2, 0.05)]
    for line, said in (
        ("reserv = 0.1", "careful.toml: reserv: is not a known key; did you mean reserve?"),
        ("reserve = 1.0", "careful.toml: reserve: must be from 0 to 0.9"),
        ('turn = "exct"', "careful.toml: turn: must be"),
        ("via = [[0.1]]", "careful.toml: via"),
    ):
        file.write_text(line)
        assert refused(airpuck(*asks, cwd=tmp_path), said)
    asks = ("plan", *FROM, *TO, "--settings", "none.toml")
    assert refused(airpuck(*asks, cwd=tmp_path), "none.toml: there is no such file")


def test_the_help_shows_everyday_options_and_names_the_rest():
    everyday, whole = (airpuck("plan", option).stdout for option in ("--help", "--help-all"))
    assert "--from" in everyday and "--reserve" in everyday and "--help-all" in everyday
    assert "--smoothing" not in everyday
    assert "--from" in whole and "--smoothing" in whole


@pytest.fixture(scope="module")
def planned(tmp_path_factory):
    folder = tmp_path_factory.mktemp("plan")
    path, figures = folder / "plan.toml", folder / "plan.json"
    asks = "plan --from -0.2 0 0 --to 0.2 0 0.5 --reserve 0.02 --intervals 20"
    written = "-o", path, "--figure", folder / "plan.png", "--json", figures
    ended = ran(*asks.split(), *written)
    assert (folder / "plan.png").stat().st_size > 10_000
    return path, json.loads(figures.read_text()), ended.stdout


@pytest.mark.slow
def test_a_plan_is_printed_and_written(planned):
    path, figures, said = planned
    assert figures["converged"] is True
    assert 0 < figures["lower_bound_s"] < figures["time_s"] < 0.7
    assert f"{figures['time_s']:.3f} s; no craft" in said
    assert {"name", "time_s", "status"} == set(figures["starts"][0])
    again = read_plan(path, package.read_model("paper:M3"))
    assert again.duration == figures["time_s"]


@pytest.mark.slow
def test_a_plan_is_raced(planned, tmp_path):
    path, figures, _ = planned
    out, picture = tmp_path / "race.json", tmp_path / "race.png"
    ran("race", "paper:M3", path, "--seeds", 1, "--json", out, "--figure", picture, "-q")
    raced = json.loads(out.read_text())
    assert raced["planned_s"] == figures["time_s"]
    assert len(raced["flown_s"]) == 1
    assert raced["contacts"] == 0
    assert picture.stat().st_size > 10_000


def test_an_unknown_course_is_named():
    assert refused(
        airpuck("race", "paper:M3", "slalm"), "COURSE: must be", "did you mean 'slalom'?"
    )


def test_passing_a_plan_as_the_model_is_explained(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    model, times = package.read_model("paper:M3"), np.array([0.0, 0.5])
    at_rest = package.Plan(model, times, np.zeros((2, 12)), np.zeros((1, 6)), lower_bound=None)
    at_rest.save("mine.toml")
    said = "the model comes first: airpuck race paper:M3 mine.toml"
    assert refused(airpuck("race", "mine.toml"), said)
