"""`airpuck plan` and `airpuck race`."""

import json

import numpy as np
import pytest

import airpuck as package
from airpuck.planning.plan import read_plan

from ..apparatus.commands import airpuck, refused


@pytest.fixture(scope="module")
def planned(tmp_path_factory):
    folder = tmp_path_factory.mktemp("plan")
    path, figures = folder / "plan.toml", folder / "plan.json"
    ended = airpuck(
        *[
            "plan",
            "--from",
            "-0.2",
            "0",
            "0",
            "--to",
            "0.2",
            "0",
            "0.5",
            "--reserve",
            "0.02",
            "--intervals",
            "20",
        ],
        *("-o", path, "--figure", folder / "plan.png", "--json", figures),
    )
    assert ended.returncode == 0
    assert (folder / "plan.png").stat().st_size > 10_000
    return path, json.loads(figures.read_text()), ended.stdout


@pytest.mark.slow
def test_a_plan_is_said_and_written(planned):
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
    ended = airpuck(
        "race", "paper:M3", path, "--seeds", 1, "--json", out, "--figure", picture, "-q"
    )
    assert ended.returncode == 0
    raced = json.loads(out.read_text())
    assert raced["planned_s"] == figures["time_s"]
    assert len(raced["flown_s"]) == 1
    assert raced["contacts"] == 0
    assert picture.stat().st_size > 10_000


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("plan --from 0 0 0 --to 2 0 0", "--to: (2, 0) is outside the rails"),
        ("plan --from 0 0 0 --to 0.5 0 0 --via 0.1", "--via"),
        ("plan --from 0 0 0 --to 0.5 0 0 --keep-out 0 0 x", "--keep-out: must be a valid number"),
        ("plan --from 0 0 nan --to 0.5 0 0", "--from: must be from -100 to 100"),
        ("plan --from 0 0 0 --to 0.5 0 0 --reserve 1", "--reserve: must be from 0 to 0.9"),
        (
            "plan --from 0 0 0 --to 0.5 0 0 --free both --end-velocity 1 0 0",
            "--end-velocity: is given and left free",
        ),
    ],
)
def test_wrong_requests_end_in_one_line(words, said):
    assert refused(airpuck(*words.split()), said)


def test_an_unknown_course_is_named():
    assert refused(
        airpuck("race", "paper:M3", "slalm"), "COURSE: must be", "did you mean 'slalom'?"
    )


def test_a_plan_in_place_of_the_model_is_told_apart(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    model, times = package.read_model("paper:M3"), np.array([0.0, 0.5])
    at_rest = package.Plan(model, times, np.zeros((2, 12)), np.zeros((1, 6)), lower_bound=None)
    at_rest.save("mine.toml")
    said = "the model comes first: airpuck race paper:M3 mine.toml"
    assert refused(airpuck("race", "mine.toml"), said)


@pytest.mark.parametrize(
    ("command", "said"),
    [("twin", "True model of the simulated craft"), ("race", "Model for the controller")],
)
def test_help_tells_which_model_a_command_takes(command, said):
    assert said in " ".join(airpuck(command, "--help").stdout.replace("│", " ").split())
