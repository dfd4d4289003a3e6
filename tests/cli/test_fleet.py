"""`airpuck fleet`."""

import json
import re

import pytest
from PIL import Image

from ..apparatus.commands import airpuck, ran, refused

SCENARIO = """
duration_s = 1.5
[[craft]]
name = "left"
start = [-0.3, 0.1, 0.0]
goal = [0.0, 0.1, 0.0]
[[craft]]
name = "right"
start = [0.4, -0.1, 0.0]
goal = [0.9, -0.1, 0.0]
[[deaths]]
craft = "right"
time_s = 0.0
"""


def test_a_flight_is_summarised_drawn_and_written(tmp_path):
    path = tmp_path / "two.toml"
    path.write_text(SCENARIO)
    gif, page = tmp_path / "two.gif", tmp_path / "page"
    ended = ran("fleet", path, "-o", page, "--animation", gif, "--json", tmp_path / "two.json")
    figures = json.loads((tmp_path / "two.json").read_text())
    assert figures["names"] == ["left", "right"]
    assert figures["died_s"] == {"right": 0.0}
    assert figures["arrived_s"]["right"] is None
    assert "right died at 0.00 s" in ended.stdout
    text = (page / "index.html").read_text()
    assert "strayed [mm]" in text
    svg = (page / "figures" / "flight.svg").read_text()
    # Two craft and their goals; y points down.
    assert svg.count("<animateTransform") == 8
    assert re.search(r'values="-0\.300 -0\.100;', svg)
    with Image.open(gif) as picture:
        # 20 frames a second, until the craft has rested for 0.3 s.
        assert picture.n_frames == pytest.approx(20 * (figures["settled_s"] + 0.3), abs=3)


def test_a_mistake_in_a_scenario_ends_in_one_line(tmp_path):
    path = tmp_path / "two.toml"
    path.write_text(SCENARIO.replace("[0.4, -0.1, 0.0]", "[-0.3, 0.15, 0.0]"))
    assert refused(airpuck("fleet", path), "two.toml: start: of right is 0.05 m from that of left")
    assert refused(airpuck("fleet", "crosing"), "did you mean 'crossing'")
