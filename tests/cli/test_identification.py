"""Standard errors on the command line."""

import json

import pytest

from airpuck.model.model_file import read_model
from airpuck.recording.bag_writer import write_bag

from ..command_line import airpuck, refused
from ..synthetic import record


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    folder = tmp_path_factory.mktemp("bags") / "flight"
    write_bag(record(duration=14.0, noise=1e-4), folder)
    return folder


def test_identify_prints_and_writes_standard_errors(bag, tmp_path):
    out = ("-o", tmp_path / "m.toml", "--json", tmp_path / "fit.json", "--report", tmp_path / "r")
    out = (*out, "--validation", bag, "-v")
    process = airpuck("identify", bag, *out, "--model", "M4", "--bootstrap", 10, "--seed", 3)
    assert process.returncode == 0, process.stderr
    assert "±" in process.stdout
    assert "F(0.5) motor_c_2" in process.stdout
    assert "10 resampled" in process.stdout
    assert "for control" in process.stdout.splitlines()[0]
    assert "scale is fixed by Newton's law" in process.stdout
    assert "resampled 10 of 10" in process.stderr
    figures = json.loads((tmp_path / "fit.json").read_text())
    lag = figures["parameters"]["motor_time_constant"]
    low, high = lag["interval_95"]
    assert low < lag["value"] < high
    assert lag["standard_error"] > 0
    assert len(lag["bootstrap_95"]) == 2
    assert figures["parameters"]["inertia"]["standard_error"] is None
    assert figures["identifiability"]["free"] - figures["identifiability"]["rank"] == 6
    assert figures["uncertainty"]["seed"] == 3
    assert read_model(tmp_path / "m.toml").uncertainty.bootstrap.seed == 3
    page = (tmp_path / "r" / "index.html").read_text()
    assert "fixed by Newton" in page
    assert " ± " in page
    assert "airpuck identify" in page
    assert (tmp_path / "r" / "figures" / "prediction.pdf").read_bytes()[:4] == b"%PDF"
    assert figures["verdict"]["sentences"][0] in process.stdout
    assert figures["validation"]["rmse"]["x_m"] > 0


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--seed", 3), ("--seed", "--bootstrap")),
        (("--bootstrap", 20, "--method", "adam"), ("--bootstrap", "lm only")),
        (("--bootstrap", 3), ("--bootstrap",)),
        (("--model", "auto", "--method", "adam"), ("--model auto", "lm only")),
    ],
)
def test_options_that_would_do_nothing_are_refused(bag, tmp_path, options, words):
    process = airpuck("identify", bag, "-o", tmp_path / "m.toml", *options)
    assert process.returncode == 2
    assert refused(process, *words) or words


def test_the_rung_is_chosen_and_its_rivals_are_shown(tmp_path):
    write_bag(record(duration=20.0, noise=1e-4), tmp_path / "bag")
    out = ("-o", tmp_path / "m.toml", "--json", tmp_path / "fit.json")
    process = airpuck("identify", tmp_path / "bag", "--model", "auto", *out)
    assert process.returncode == 0, process.stderr
    figures = json.loads((tmp_path / "fit.json").read_text())
    selection, model = figures["selection"], read_model(tmp_path / "m.toml")
    assert model.name == figures["model"] == selection["chosen"]
    assert model.fit["selection"]["ladder"] == [rung["model"] for rung in selection["rungs"]]
    assert model.name in process.stdout and "held out in turn" in process.stdout
    for rung in selection["rungs"]:
        assert f"{1e3 * rung['rmse']['x_m']:.2f}" in process.stdout
