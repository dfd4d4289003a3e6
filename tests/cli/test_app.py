"""The command line from a user's point of view."""

import contextlib
import io
import json
import os
import subprocess
import sys
from functools import partial
from pathlib import Path

import numpy as np
import pytest

import airpuck as package
from airpuck import write_csv
from airpuck.boundary.extensions import added
from airpuck.cli.app import known_commands, main
from airpuck.cli.options import published_flights
from airpuck.model.model_file import read_model
from airpuck.report import reproduce as paper

from ..apparatus.changes import with_propellers
from ..apparatus.commands import airpuck, airpuck_process, ran, refused
from ..apparatus.synthetic_flights import record


@pytest.fixture(scope="module")
def identified(bag) -> Path:
    path = bag.parent / "model.toml"
    ran("identify", bag, "-o", path, "--json", bag.parent / "fit.json")
    return path


def test_the_help_lists_all_commands_and_each_keeps_its_options():
    shown = airpuck_process().stdout
    assert all(name in shown for name in known_commands())
    assert all(len(command.params) for command in known_commands().values())


@pytest.mark.parametrize("command", ["preprocess", "identify", "check"])
def test_a_missing_recording_is_rejected_before_any_library_is_imported(command):
    heavy = ("numpy", "rich", "airpuck.model", "airpuck.cli.live")
    code = f"""
import atexit, sys
from airpuck.cli import main
atexit.register(lambda: print(*[name for name in {heavy} if name in sys.modules]))
sys.argv[1:] = [{command!r}, "nowhere", "-o", "t.npz"][: 2 if {command!r} == "check" else None]
main()
"""
    words = [sys.executable, "-c", code]
    process = subprocess.run(words, capture_output=True, text=True, check=False)
    assert refused(process, "nowhere", "there is no such file or folder")
    assert not process.stdout.split()


@pytest.mark.parametrize("name", sorted(known_commands()))
def test_help_texts_keep_their_units(name):
    # Rich takes [s] for markup, and leaves it out, unless it is escaped.
    command = known_commands()[name]
    names = {parameter.name for parameter in command.params}
    words = [name, "--help-all" if "help_all" in names else "--help"]
    shown = " ".join(airpuck(*words, env={**os.environ, "COLUMNS": "1000"}).stdout.split())
    for text in [command.help, *(parameter.help for parameter in command.params)]:
        assert (text or "").replace("\\", "").splitlines()[0] in shown


def test_commands_are_named_like_the_functions_of_the_package():
    # airpuck.export, faults and fleet are packages, to check what would remain open, and `vehicle`
    # shows one. Others start a process on the graph; their functions are in airpuck.live.
    others = {"demo", "export", "faults", "fleet", "check", "vehicle", "race"}
    others |= {"fly", "fly_excitation", "fly_fleet", "fly_plan", "fly_setpoints", "fly_topic"}
    others |= {"preflight_recording", "record", "twin", "twin_fleet", "view", "watch"}
    own = {name for name in known_commands() if name not in added("airpuck.commands")}
    verbs = {name.replace("-", "_") for name in own} - others
    assert verbs <= set(dir(package))


@pytest.mark.parametrize("name", ["reproduce", "demo"])
@pytest.mark.parametrize("option", ["-o", "--output", "--out"])
def test_the_output_folder_has_the_same_option_names_everywhere(tmp_path, name, option):
    (tmp_path / "file").write_text("mine")
    process = airpuck(name, option, tmp_path / "file" / "out")
    assert refused(process, "-o", "cannot be written")


def test_the_version_is_printed():
    assert airpuck_process("--version").stdout.strip().startswith("airpuck 0.")


def test_preprocess_writes_arrays(bag, tmp_path):
    process = ran("preprocess", bag, "-o", tmp_path / "traj.npz", "--json", "-")
    assert json.loads(process.stdout)["samples"] > 1800
    with np.load(tmp_path / "traj.npz") as archive:
        assert archive["state"].shape == (len(archive["t"]), 6)
        assert archive["input"].shape == (len(archive["t"]), 6)


@pytest.mark.slow
def test_evaluate_prints_only_json(bag, identified, tmp_path):
    process = airpuck_process("evaluate", identified, bag, "--json", "-")
    assert process.stderr == ""
    figures = json.loads(process.stdout)
    assert {"protocol", "horizon_s", "windows", "rmse", "median_abs"} <= set(figures)
    assert set(figures["rmse"]) == {"x_m", "y_m", "yaw_rad"}
    assert figures["rmse"]["x_m"] < 2e-3
    # A preprocessed file serves as a recording, and a span takes a part.
    airpuck("preprocess", bag, "-o", tmp_path / "traj.npz")
    whole, saved, part = (
        json.loads(airpuck("evaluate", identified, *words, "--json", "-").stdout)
        for words in ((bag,), (tmp_path / "traj.npz",), (bag, "--span", 0.5, 1))
    )
    assert saved == whole
    assert part["windows"] == pytest.approx(whole["windows"] / 2, abs=1)


def test_check_accepts_a_right_layout_and_rejects_a_wrong_one(bag, tmp_path):
    assert airpuck("check", bag).returncode == 0
    from airpuck.craft.vehicle import default_vehicle

    vehicle = default_vehicle()
    names = [vehicle.propeller_names[k] for k in (3, 1, 2, 0, 4, 5)]
    with_propellers(vehicle, lambda k, _: {"name": names[k]}).save(tmp_path / "swapped.toml")
    process = airpuck("check", bag, "--vehicle", tmp_path / "swapped.toml")
    assert process.returncode == 2
    assert "swapped" in process.stdout
    assert "motor_b_2, motor_a_1" in process.stderr.splitlines()[-1]
    # A mapping that reverses y alone: the correction is stated in terms of that mapping.
    (tmp_path / "lab.toml").write_text('[pose]\naxes = ["x", "-y", "z"]\n')
    process = airpuck("check", bag, "--mapping", tmp_path / "lab.toml")
    assert process.returncode == 2
    assert 'axes = ["x", "y", "z"]' in process.stdout
    assert process.stderr.splitlines()[-1].endswith(": the y axis")


def test_excite_reports_how_often_a_rail_was_hit(tmp_path):
    tilted = tmp_path / "tilted.toml"
    tilted.write_text("[effects]\ntilt_rad = [0.0, 0.1]\n[radio]\nloss = 1.0")
    arguments = ("excite", "--duration", "3", "--twin", tilted, "--json", tmp_path / "f.json")
    process = ran(*arguments, "-o", tmp_path / "bag")
    figures = json.loads((tmp_path / "f.json").read_text())
    contacts = figures["rail_contacts_s"]
    # 0.48 m downhill, without a command that arrives.
    assert contacts[0] == pytest.approx((2 * 0.48 / 0.981) ** 0.5, abs=0.01)
    assert 0.1 < figures["paused_s"] < 3
    assert f"paused near the rails: {figures['paused_s']:.1f} s" in process.stdout
    assert f"with a rail: {len(contacts)}, at 1.0" in process.stdout


@pytest.mark.parametrize("folder", [None, "elsewhere"])
def test_track_reports_that_it_flies_without_the_real_flights(monkeypatch, capsys, folder):
    monkeypatch.delenv("AIRPUCK_DATA", raising=False)
    if folder is not None:
        monkeypatch.setenv("AIRPUCK_DATA", folder)
    assert published_flights(["paper:M4", "paper:M3"]) == [None, None]
    said = " ".join(capsys.readouterr().err.split())
    assert "with paper:M4 is missing: " in said
    assert ("not set" if folder is None else "elsewhere") in said
    # The paper flew no M3.
    published_flights(["paper:M3"])
    assert not capsys.readouterr().err


def test_a_bad_recording_ends_in_one_line_and_writes_nothing(tmp_path):
    write_csv(record(duration=4.0), tmp_path / "flight")
    (path,) = (tmp_path / "flight").glob("*pose*.csv")
    path.write_text("\n".join(path.read_text().splitlines()[:40]))
    (tmp_path / "model.toml").write_text("old")
    process = airpuck("identify", tmp_path / "flight", "-o", tmp_path / "model.toml")
    assert refused(process, str(tmp_path / "flight"), "too short")
    assert (tmp_path / "model.toml").read_text() == "old"


@pytest.mark.slow
def test_the_demo_runs_from_start_to_end(tmp_path, undrawn, monkeypatch):
    # A report needs five models and flights of 90 s, a test does not.
    monkeypatch.setattr("airpuck.report.reproduce.demo", partial(paper.demo, duration=9.0))
    monkeypatch.setattr("airpuck.report.reproduce._MODELS", ("M0", "M3"))
    monkeypatch.setattr("airpuck.report.reproduce._PILOTS", ("M3",))
    process = ran("demo", "--out", tmp_path / "demo", "--quiet")
    page = Path(process.stdout.strip())
    assert page.read_text().startswith("<!DOCTYPE html>")
    found, truth = (read_model(m) for m in (tmp_path / "demo/models/M3.toml", "paper:M3"))
    assert found.parameters.inertia == pytest.approx(truth.parameters.inertia, rel=0.01)
    assert found.transport_delay == pytest.approx(5 / 240, abs=2e-3)


def test_datasets_are_listed_with_their_licences():
    listed = ran("fetch", "--list")
    names = {"holohover": "BSD 2-Clause", "air-bearing-satellite": "MIT"}
    for name, licence in {**names, "cybership-enterprise": "MIT"}.items():
        assert any(name in line and licence in line for line in listed.stdout.splitlines())


def test_a_closed_or_full_stream_is_not_reported_as_a_bug(monkeypatch):
    with monkeypatch.context() as closed:
        closed.setattr("sys.argv", ["airpuck", "--version"])
        closed.setattr("sys.stdout", None)
        with pytest.raises(SystemExit) as ended:
            main()
    assert ended.value.code == 0
    with monkeypatch.context() as closed, contextlib.redirect_stdout(io.StringIO()) as shown:
        closed.setattr("sys.argv", ["airpuck", "nonsense"])
        closed.setattr("sys.stderr", None)
        with pytest.raises(SystemExit) as ended:
            main()
    assert ended.value.code == 2
    assert shown.getvalue() == ""


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="has no full disk")
def test_errors_that_cannot_be_printed_keep_their_exit_status(monkeypatch):
    monkeypatch.setattr("sys.argv", ["airpuck", "nonsense"])
    file = os.open("/dev/full", os.O_WRONLY)
    full = io.TextIOWrapper(io.FileIO(file, "w"), write_through=True)
    monkeypatch.setattr("sys.stderr", full)
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 2
