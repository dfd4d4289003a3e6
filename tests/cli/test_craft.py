"""`airpuck vehicle`."""

import json

import pytest

from airpuck.craft.vehicle import default_vehicle

from ..apparatus.commands import airpuck, refused
from ..apparatus.models import four_propellers


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "craft.toml"
    default_vehicle().save(path)
    return path


def test_propellers_and_motions_are_shown(file, tmp_path):
    process = airpuck("vehicle", file, "--json", tmp_path / "v.json")
    assert process.returncode == 0, process.stderr
    for words in ("137.7 g, radius 70 mm", "motor_b_2", "turn right"):
        assert words in process.stdout
    figures = json.loads((tmp_path / "v.json").read_text())
    assert figures["mass_kg"] == 0.1377
    assert figures["motions"]["missing"] == []
    # Two propellers at 30 degrees and two at right angles: 2 F cos 30° / m, minus idle thrust.
    assert 7.9 < figures["motions"]["alone"]["forward_m_s2"] < 2 * 0.644 * 0.866 / 0.1377


def test_what_cannot_be_done_is_said(tmp_path):
    four_propellers().save(tmp_path / "craft.toml")
    process = airpuck("vehicle", tmp_path / "craft.toml")
    assert process.returncode == 0
    assert "no propeller turns it right (clockwise)" in process.stdout


@pytest.mark.parametrize(("suffix", "begins"), [("svg", b"<?xml"), ("png", b"\x89PNG")])
def test_it_is_drawn(file, tmp_path, suffix, begins):
    out = tmp_path / f"craft.{suffix}"
    process = airpuck("vehicle", file, "-o", out, "-q")
    assert (process.returncode, process.stdout) == (0, "")
    assert out.read_bytes().startswith(begins)


def test_wrong_use_is_refused(file, tmp_path):
    assert refused(airpuck("vehicle", file, "-o", tmp_path / "craft.jpg"), ".svg", "-o")
    file.write_text(file.read_text().replace("mass_kg = 0.1377", "mass_kg = 137.7"))
    assert refused(airpuck("vehicle", file), "mass_kg = 137.7", "grams?")
