"""present, resid and compare on the command line."""

import json
from dataclasses import replace

import numpy as np
import pytest

from airpuck.craft.vehicle import default_vehicle
from airpuck.model.model_file import read_model
from airpuck.recording.bag import write_bag

from ..apparatus.commands import airpuck, ran, refused
from ..apparatus.models import four_propellers
from ..apparatus.synthetic_flights import record


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "craft.toml"
    default_vehicle().save(path)
    return path


def test_the_vehicle_command_shows_propellers_and_motions(file, tmp_path):
    process = ran("vehicle", file, "--json", tmp_path / "v.json")
    for words in ("137.7 g, radius 70 mm", "motor_b_2", "turn right"):
        assert words in process.stdout
    figures = json.loads((tmp_path / "v.json").read_text())
    assert figures["mass_kg"] == 0.1377
    assert figures["motions"]["missing"] == []
    # Two propellers at 30 degrees and two at right angles: 2 F cos 30° / m, minus idle thrust.
    assert 7.9 < figures["motions"]["alone"]["forward_m_s2"] < 2 * 0.644 * 0.866 / 0.1377


def test_the_vehicle_command_names_impossible_motions(tmp_path):
    four_propellers().save(tmp_path / "craft.toml")
    process = ran("vehicle", tmp_path / "craft.toml")
    assert "no propeller turns it right (clockwise)" in process.stdout


@pytest.mark.parametrize(("suffix", "begins"), [("svg", b"<?xml"), ("png", b"\x89PNG")])
def test_the_vehicle_is_drawn(file, tmp_path, suffix, begins):
    out = tmp_path / f"craft.{suffix}"
    assert ran("vehicle", file, "-o", out).stdout.splitlines()[-1] == str(out)
    assert out.read_bytes().startswith(begins)


def test_unknown_formats_and_implausible_masses_are_rejected(file, tmp_path):
    assert refused(airpuck("vehicle", file, "-o", tmp_path / "craft.jpg"), ".svg", "-o")
    file.write_text(file.read_text().replace("mass_kg = 0.1377", "mass_kg = 137.7"))
    assert refused(airpuck("vehicle", file), "mass_kg = 137.7", "grams?")


pytestmark = pytest.mark.slow


def test_commands_that_read_a_damaged_recording_repeat_its_warning(tmp_path):
    """A recording whose log ends in the middle, in commands that only read it."""
    bag = tmp_path / "bag"
    write_bag(record(duration=4.0), bag)
    [log] = bag.glob("*.mcap")
    content = log.read_bytes()
    log.write_bytes(content[: int(0.9 * len(content))])
    shown = "-o", tmp_path / "flight.html"
    assert "is damaged: it is cut short" in ran("animate", bag, *shown).stderr
    assert not ran("animate", bag, *shown, "-q").stderr


def test_preprocessed_recordings_are_checked(tmp_path):
    write_bag(record(duration=8.0), tmp_path / "bag")
    ran("preprocess", tmp_path / "bag", "-o", tmp_path / "t.npz", "-q")
    assert "agree" in ran("check", tmp_path / "t.npz").stdout


def test_one_file_cannot_be_two_outputs_under_two_paths(tmp_path):
    (tmp_path / "in").mkdir()
    out = ("-o", tmp_path / "m.toml", "--json", tmp_path / "in" / ".." / "m.toml")
    assert refused(airpuck("identify", "bag", *out), "is also the output of -o")


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    """A bag, and two models, each learned from one half of it."""
    folder = tmp_path_factory.mktemp("judging")
    write_bag(record(duration=10.0, noise=1e-4), folder / "bag")
    for name, span in (("early", (0, 0.5)), ("late", (0.5, 1))):
        out = folder / f"{name}.toml"
        ran("identify", folder / "bag", "--span", *span, "-o", out, "--model", "M2")
    return folder


def test_present_prints_and_writes_json(flown):
    process = ran("present", flown / "early.toml")
    assert "for control" in process.stdout.splitlines()[0]
    for words in ("free: first-order lag", "±", "bandwidth", "loss", "data "):
        assert words in process.stdout
    figures = json.loads(airpuck("present", flown / "early.toml", "--json", "-").stdout)
    lag = next(value for value in figures["parameters"] if value["label"] == "τ")
    assert lag["learned"]
    assert lag["interval_95"][0] < lag["value"] < lag["interval_95"][1]


def test_resid_prints_and_writes_json(flown, tmp_path, undrawn):
    out = ("-o", tmp_path / "page", "--json", tmp_path / "r.json")
    process = ran("resid", flown / "early.toml", flown / "bag", "--lags", 10, *out)
    assert "innovations are" in process.stdout
    assert "AIC" in process.stdout
    figures = json.loads((tmp_path / "r.json").read_text())
    assert len(figures["whiteness"]) == 3
    assert len(figures["cross_correlation"]) == 18
    assert "Residual tests" in (tmp_path / "page" / "index.html").read_text()
    assert (tmp_path / "page" / "figures" / "residuals.png").read_bytes() == b"drawn"


def test_evaluate_and_compare_write_pages(flown, tmp_path, undrawn, monkeypatch):
    early, late, bag = flown / "early.toml", flown / "late.toml", flown / "bag"
    process = ran("compare", early, late, bag, "-o", tmp_path / "two")
    page = (tmp_path / "two" / "index.html").read_text()
    # Models have the same names on the terminal and on the page.
    for written in (process.stdout, page):
        assert "late against early" in written
        assert str(flown) not in written.replace(f"{early} {late} {bag}", "")
        assert "AIC" in written
    assert (tmp_path / "two" / "figures" / "path.pdf").read_bytes() == b"drawn"
    assert refused(airpuck("compare", early, late, "-o", tmp_path / "three"), "RECORDING", "-o")
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1700000000")
    words = "evaluate", early, bag, "-o", tmp_path / "one", "--json", "-"
    figures = json.loads(airpuck(*words).stdout)
    page = (tmp_path / "one" / "index.html").read_text()
    assert figures["verdict"]["sentences"][0] in page
    assert "2023-11-14 22:13 UTC" in page
    assert f"airpuck evaluate {early} {bag} -o" in page
    assert airpuck(*words).returncode == 0
    assert (tmp_path / "one" / "index.html").read_text() == page
    both = json.loads(airpuck(*words, "--law", "mpc").stdout)["verdict"]
    assert list(both["controller"]) == (["lqr", "mpc"] if both["controller"] else [])
    assert refused(airpuck(*words, "--law", "bogus"), "bogus", "mpc")


def test_comparing_two_models_reports_drift(flown):
    models = flown / "early.toml", flown / "late.toml"
    process = ran("compare", *models)
    assert "moved" in process.stdout or "fell" in process.stdout or "rose" in process.stdout
    assert "same files" in process.stdout
    figures = json.loads(airpuck("compare", *models, flown / "bag", "--json", "-").stdout)
    assert {"label", "z", "p_value", "moved"} <= set(figures["drift"]["changes"][0])
    assert {"rmse", "fit_percent", "aic", "bic"} <= set(figures["evaluations"][1])


def test_models_without_known_errors_are_compared_on_the_recording(flown, tmp_path):
    # As after an unfinished fit: nothing in it has a standard error.
    late = read_model(flown / "late.toml")
    assert late.uncertainty is not None
    unknown = np.full_like(late.uncertainty.covariance, np.nan)
    blind = replace(late.uncertainty, covariance=unknown, standard_errors=unknown[0])
    replace(late, uncertainty=blind).save(tmp_path / "blind.toml")
    models = flown / "early.toml", tmp_path / "blind.toml"
    assert refused(airpuck("compare", *models), "known errors")
    process = ran("compare", *models, flown / "bag", "--json", tmp_path / "c.json")
    assert "drift is unknown: no learned quantity" in process.stdout
    figures = json.loads((tmp_path / "c.json").read_text())
    assert figures["drift"]["changes"] == figures["drift"]["verdicts"] == []
    assert len(figures["evaluations"]) == 2


def test_invalid_comparisons_are_rejected(flown):
    assert refused(airpuck("compare", flown / "early.toml"), "RECORDING")
    assert refused(airpuck("compare", "paper:M3", "paper:M4"), "known errors")
    wrong = airpuck("compare", "paper:M3", flown / "bag", "--protocol", "causal")
    assert refused(wrong, "looks ahead", "actuation")
