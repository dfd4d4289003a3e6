"""`airpuck.export.write`, and the command, whatever the kind."""

import json
import os
from contextlib import nullcontext
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from airpuck import InputError, Plan, export
from airpuck.control.lqr import LQRSettings, lqr_gain
from airpuck.control.tuning import default_tuning, tuning_for
from airpuck.export import kinds
from airpuck.export.c import initializer
from airpuck.model.model_file import nominal_model, read_model
from airpuck.twin.settings import default_twin_settings
from tests.apparatus.commands import airpuck, refused
from tests.apparatus.export_crafts import DISH, FOUR, ON_OFF, PAPER, REVERSIBLE, WHEELED

M4 = PAPER["M4"]


def test_an_unknown_kind_lists_the_kinds(tmp_path):
    with pytest.raises(InputError, match=r"must be 'c', .*, not 'cassadi'; did you mean 'casadi'"):
        export.write(M4, "cassadi", tmp_path)


@pytest.mark.parametrize(
    ("kind", "given"),
    [("casadi", {"twin": default_twin_settings()}), ("mjcf", {"tuning": default_tuning()})],
)
def test_settings_that_a_kind_does_not_use_are_rejected(kind, given, tmp_path):
    with pytest.raises(InputError, match=f"is not part of an export to {kind}"):
        export.write(M4, kind, tmp_path / "out", **given)
    assert not list(tmp_path.iterdir())


def test_a_failed_export_leaves_the_folder_unchanged(tmp_path, monkeypatch):
    export.write(M4, "mjcf", tmp_path)
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    failing = replace(kinds.KINDS["mjcf"], module=__name__)
    monkeypatch.setitem(kinds.KINDS, "mjcf", failing)
    with pytest.raises(InputError, match="the disk is full"):
        export.write(PAPER["M2"], "mjcf", tmp_path)
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before


def write(subject, folder):
    """Write one of two files, as a kind of export that fails."""
    (folder / "craft.xml").write_text("half")
    raise OSError(28, "the disk is full")


HELD = {
    "on_off": (ON_OFF, {"casadi", "gym", "matlab"}),
    "reversible propeller": (REVERSIBLE, {"casadi", "matlab"}),
    "reaction wheel": (WHEELED, set()),
}


@pytest.mark.parametrize("kind", export.KINDS)
@pytest.mark.parametrize("actuators", HELD)
def test_actuators_that_a_kind_cannot_represent_are_rejected_by_name(kind, actuators, tmp_path):
    model, held = HELD[actuators]
    expected = pytest.raises(InputError, match=f"the kind {actuators}, which an export to {kind} ")
    with nullcontext() if kind in held else expected:
        export.write(model, kind, tmp_path)


@pytest.mark.parametrize("effect", ["Dish", "Hull"])
@pytest.mark.parametrize("kind", sorted(set(export.KINDS) - {"casadi", "gym"}))
def test_effects_that_a_kind_cannot_represent_are_rejected_by_name(kind, effect, tmp_path):
    parameters = replace(M4.parameters, hull=np.full(7, 0.1))
    hull = replace(M4, parameters=parameters, free=parameters.mask(frozenset()))
    with pytest.raises(InputError, match=f"effect {effect}, which an export to {kind} cannot"):
        export.write(DISH if effect == "Dish" else hull, kind, tmp_path)


def test_names_cannot_end_a_line_string_or_comment(tmp_path):
    vehicle = M4.vehicle.model_copy(update={"name": "a--b\nmass: 1\n'%-->"})
    model = replace(M4, name="M\n4", source="x\ny", vehicle=vehicle)
    for kind in ("casadi", "holohover", "matlab", "mjcf"):
        export.write(model, kind, tmp_path)
    assert read_model(tmp_path / "holohover_params.yaml").vehicle.mass_kg == vehicle.mass_kg
    assert json.loads((tmp_path / "arguments.json").read_text("utf-8"))["vehicle"] == vehicle.name
    mujoco.MjModel.from_xml_path(str(tmp_path / "craft.xml"))
    lines = (tmp_path / "airpuck_parameters.m").read_text("utf-8").splitlines()
    assert all(line.startswith(("function", "%", "    ", "end")) for line in lines)


@pytest.mark.parametrize("kind", ["c", "casadi", "gym", "matlab"])
def test_the_source_may_have_any_file_name(kind, tmp_path):
    export.write(replace(M4, source=os.fsdecode(b"\xff.json")), kind, tmp_path)


def test_unrelated_files_in_the_folder_are_kept(tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    written = export.write(M4, "mjcf", tmp_path)
    assert "notes.txt" not in written.files
    assert (tmp_path / "notes.txt").read_text() == "mine"


def test_a_folder_in_place_of_a_file_stops_the_export_before_writing(tmp_path):
    (tmp_path / "craft.xml").mkdir()
    with pytest.raises(InputError, match=r"craft\.xml: is a folder"):
        export.write(M4, "mjcf", tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["craft.xml"]


def test_the_command_prints_files_and_facts_as_json(tmp_path):
    done = airpuck("export", "paper:M4", "--to", "mjcf", "-o", tmp_path, "--json", "-")
    found = json.loads(done.stdout)
    assert (found["kind"], found["folder"]) == ("mjcf", str(tmp_path))
    assert all((tmp_path / name).is_file() for name in found["files"])
    assert found["facts"]["time step"] == "0.25 ms"


def test_the_command_adds_a_plan(tmp_path):
    random, times = np.random.default_rng(0), np.linspace(0.0, 0.3, 7)
    commands = random.uniform(0.1, 0.8, (6, 6))
    start = np.concatenate([np.zeros(6), np.full(6, 0.03)])
    states = np.vstack([start, M4.simulate(start, commands, np.diff(times))])
    Plan(M4, times, states, commands, None).save(tmp_path / "flight.toml")
    words = "export", "paper:M4", "--plan", tmp_path / "flight.toml", "-o", tmp_path / "c"
    done = airpuck(*words, "--to", "c", "--json", "-")
    found = json.loads(done.stdout)
    assert found["facts"]["law"] == "plan"
    assert "airpuck_flight.c" in found["files"]
    assert refused(airpuck(*words, "--to", "fmu"), "--plan: is not part of an export to fmu")


def test_the_command_exports_the_controller_that_other_commands_fly(tmp_path):
    heavy = FOUR.vehicle.model_copy(update={"mass_kg": 2.0})
    nominal_model(heavy).save(tmp_path / "slow.toml")
    airpuck("export", tmp_path / "slow.toml", "--to", "c", "-o", tmp_path)
    slowed = tuning_for(nominal_model(heavy))
    assert slowed != default_tuning()
    gain = initializer(lqr_gain(slowed.of(LQRSettings).weights, slowed.period_s))
    assert f".gain = {gain}" in (tmp_path / "airpuck_data.c").read_text()


@pytest.mark.parametrize("option", ["--tuning", "--law"])
def test_the_command_names_the_option_that_a_kind_does_not_use(option, tmp_path):
    done = airpuck("export", "paper:M4", "--to", "mjcf", "-o", tmp_path, option, "lqr")
    assert refused(done, f"{option}: is not part of an export to mjcf")


def test_the_command_does_not_replace_its_inputs(tmp_path):
    export.write(M4, "holohover", tmp_path)
    given = tmp_path / "params.json"
    text = given.read_text().replace("{", '{"data": 1, ', 1)
    given.write_text(text)
    done = airpuck("export", given, "--to", "holohover", "-o", tmp_path)
    assert refused(done, "params.json", "is also an input")
    assert given.read_text() == text
    assert len(list(tmp_path.iterdir())) == 2


def test_nothing_is_written_outside_an_existing_folder(tmp_path, monkeypatch):
    # It may be the only folder that one may write to, or lie on a file system of its own.
    made = []

    def noted(path, *args, **more):
        made.append(path)
        original(path, *args, **more)

    original = kinds.Path.mkdir
    monkeypatch.setattr(kinds.Path, "mkdir", noted)
    export.write(M4, "mjcf", tmp_path)
    assert made and all(path.is_relative_to(tmp_path) for path in made)


def test_a_model_can_export_itself(tmp_path):
    written = M4.export("casadi", tmp_path / "own")
    export.write(M4, "casadi", tmp_path / "other")
    assert written.files and (tmp_path / "own" / written.files[0]).is_file()
    for name in written.files:
        assert (tmp_path / "own" / name).read_bytes() == (tmp_path / "other" / name).read_bytes()
