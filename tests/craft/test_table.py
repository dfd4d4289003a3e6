"""The table file: reading, writing, and rejected content."""

import pytest

from airpuck.craft.table import AirHockey, Contact, Puck, Table, read_table
from airpuck.twin.settings import read_twin_settings

from ..apparatus.refusals import rejected
from ..apparatus.tables import EVERYTHING


@pytest.mark.parametrize("table", [EVERYTHING, AirHockey()])
def test_a_table_round_trips_and_is_valid_for_the_twin(tmp_path, table):
    table.save(tmp_path / "table.toml")
    assert read_table(tmp_path / "table.toml") == table
    twin = read_twin_settings(tmp_path / "table.toml")
    # A number that a file omits has the default of the twin's settings.
    assert (twin.table, twin.puck, twin.mallet) == (table.table, table.puck, table.mallet)


def test_a_file_changes_only_the_fields_that_it_names(tmp_path):
    path = tmp_path / "table.toml"
    path.write_text("[puck.rail]\nrestitution = 0.7\n[table]\ngoal_width_m = 0.25")
    found = read_table(path)
    assert found.puck.rail == Contact(restitution=0.7)
    assert found.table == Table(goal_width_m=0.25)
    assert found.puck.mallet == Puck().mallet


def test_unidentified_numbers_are_marked_as_assumed(tmp_path):
    assert "rail.restitution" in Puck().assumed
    assert not {"rail.restitution", "drag_1_s"} & set(EVERYTHING.puck.assumed)
    assert "mallet.grip" in EVERYTHING.puck.assumed
    EVERYTHING.save(tmp_path / "table.toml")
    assert "mallet.grip" in (tmp_path / "table.toml").read_text().partition("[")[0]


def test_the_defaults_match_the_publication():
    puck = Puck()
    assert (puck.radius_m, puck.mass_kg, puck.drag_1_s) == (0.03165, 0.010, 0.2)
    assert (puck.rail.restitution, puck.mallet.restitution) == (0.79, 0.80)
    assert puck.kept_along_rail == pytest.approx(0.84)


@pytest.mark.parametrize(
    ("text", "field"),
    [
        ("[puck.rail]\nrestitution = 1.1", "puck.rail.restitution"),
        ("[puck.rail]\ngrip = -0.1", "puck.rail.grip"),
        ("[puck]\ndrag_1_s = -1.0", "puck.drag_1_s"),
        ("[puck]\nmass_kg = 0.0", "puck.mass_kg"),
        ("[puck]\nradius_m = 0.3", "puck.radius_m"),
        ('[puck.standard_error]\n"rail.colour" = 0.1', "rail.colour"),
        ("[table]\ngoal_width_m = 0.06", "goal_width_m"),
        ("[mallet]\nradius_m = 0.6", "mallet.radius_m"),
        ("[goal]\nwidth_m = 0.3", "goal"),
    ],
)
def test_an_impossible_table_is_rejected(tmp_path, text, field):
    path = tmp_path / "table.toml"
    path.write_text(text)
    with rejected(field):
        read_table(path)
