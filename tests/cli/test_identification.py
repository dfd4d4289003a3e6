"""Standard errors and the choice of a rung on the command line."""

import json

import pytest

# The report on a ladder, without the fits that precede it, which take a minute.
from airpuck.model.model_file import published_model, read_model

from ..apparatus.commands import ran

MODEL = published_model("M3")


@pytest.mark.slow
def test_identify_prints_and_writes_standard_errors(bag, tmp_path, undrawn):
    out = ("-o", tmp_path / "m.toml", "--json", tmp_path / "fit.json", "--report", tmp_path / "r")
    out = (*out, "--validation", bag, "-v")
    process = ran("identify", bag, *out, "--model", "M4", "--bootstrap", 10, "--seed", 3)
    assert "±" in process.stdout
    assert "F(0.5) motor_c_2" in process.stdout
    assert "10 resampled" in process.stdout
    assert "for control" in process.stdout.splitlines()[0]
    assert "scale is fixed by Newton's law" in process.stdout
    assert "resamplings: 100 %" in process.stderr
    figures = json.loads((tmp_path / "fit.json").read_text())
    lag = figures["values"]["motor_time_constant"]
    low, high = lag["interval_95"]
    assert low < lag["value"] < high
    assert lag["standard_error"] > 0
    assert len(lag["bootstrap_95"]) == 2
    assert figures["values"]["inertia"]["standard_error"] is None
    assert figures["identifiability"]["free"] - figures["identifiability"]["rank"] == 6
    assert figures["uncertainty"]["seed"] == 3
    assert read_model(tmp_path / "m.toml").uncertainty.bootstrap.seed == 3
    page = (tmp_path / "r" / "index.html").read_text()
    assert "fixed by Newton" in page
    assert " ± " in page
    assert "airpuck identify" in page
    assert (tmp_path / "r" / "figures" / "prediction.pdf").read_bytes() == b"drawn"
    assert figures["verdict"]["sentences"][0] in process.stdout
    assert figures["validation"]["rmse"]["x_m"] > 0
