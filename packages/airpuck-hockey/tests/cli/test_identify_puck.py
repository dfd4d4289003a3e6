"""`airpuck identify-puck`: from a bag to a table file."""

import json

import numpy as np
import pytest

from airpuck.craft.table import AirHockey, Contact, Puck, read_table
from airpuck.physics.puck import PuckState
from airpuck.physics.puck_on_table import PuckOnTable
from airpuck.recording.bag import write_bag
from airpuck.recording.stream import COLUMNS, Recording, Stream
from tests.apparatus.commands import airpuck, refused

TRUTH = AirHockey(puck=Puck(drag_1_s=0.1, rail=Contact(restitution=0.7, friction=0.15)))


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    """Ten seconds of a puck alone."""
    rng, poses = np.random.default_rng(0), []
    puck = PuckOnTable(TRUTH, PuckState(0, 0.3, 0, 3.0, 2.5, 10))
    for k in range(2400):
        puck.run(k / 240)
        if puck.goal or k % 600 == 599:
            puck.place(PuckState(0.1, 0.3, 0, *rng.normal(0, 3, 2).tolist(), 5))
        poses.append(np.array(puck.state[:3]) + rng.normal(0, 5e-5, 3))
    stamp = 10**18 + (np.arange(2400) / 240 * 1e9).astype(np.int64)
    folder = tmp_path_factory.mktemp("puck") / "bag"
    write_bag(
        Recording({"puck": Stream(stamp, stamp, np.array(poses), COLUMNS["puck"])}, ""), folder
    )
    return folder


@pytest.mark.slow
def test_a_puck_recording_becomes_a_table_file(bag, tmp_path):
    done = airpuck("identify-puck", bag, "-o", "table.toml", "--json", "figures.json", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    for words in ("drag_1_s", "rail.restitution", "flights", "table.toml"):
        assert words in done.stdout
    found = read_table(tmp_path / "table.toml")
    assert found.puck.drag_1_s == pytest.approx(0.1, abs=0.01)
    assert found.puck.rail.restitution == pytest.approx(0.7, abs=0.02)
    figures = json.loads((tmp_path / "figures.json").read_text())
    numbers = figures["puck"]["rail.restitution"]
    assert numbers == {
        "value": found.puck.rail.restitution,
        "standard_error": found.puck.standard_error["rail.restitution"],
    }
    assert figures["puck"]["mass_kg"]["standard_error"] is None
    assert figures["bounces"]["rail"] > 3
    assert figures["kept_along_rail"] == pytest.approx(found.puck.kept_along_rail)


@pytest.mark.slow
def test_without_an_output_option_nothing_is_written(bag, tmp_path):
    done = airpuck("identify-puck", bag, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "add -o table.toml" in done.stdout
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_sizes_come_from_the_table_file(bag, tmp_path):
    given = AirHockey(puck=Puck(mass_kg=0.02))
    given.save(tmp_path / "given.toml")
    done = airpuck(
        "identify-puck", bag, "--table", "given.toml", "-o", "new.toml", "-q", cwd=tmp_path
    )
    assert done.returncode == 0, done.stderr
    assert read_table(tmp_path / "new.toml").puck.mass_kg == 0.02


def test_a_missing_table_is_rejected(bag, tmp_path):
    done = airpuck("identify-puck", bag, "--table", "none.toml", cwd=tmp_path)
    assert refused(done, "none.toml")
    assert not list(tmp_path.iterdir())
