"""The page that compares laws shows the figures of the flights, and plans where they lead."""

import json
import re

import numpy as np
import pytest
from matplotlib.colors import to_hex

from airpuck import FlightLog, Table
from airpuck.control.law import Prediction
from airpuck.flight.track import Track
from airpuck.report import style
from airpuck.report.animation import animate
from airpuck.report.control_report import error_figure, summary, tracking_report, tracking_sections
from airpuck.report.plot import path_figure
from airpuck.report.scene import plan_at, read_scene
from airpuck.twin.tracking_study import Tracked

from ..apparatus.drawn_flights import CRAFT, flight

pytestmark = pytest.mark.slow

PLANS = {
    0: Prediction(np.array([0.1, 0.2]), np.full((2, 6), 0.05), ()),
    10: Prediction(np.array([0.1, 0.2]), np.full((2, 6), 0.1), ("motor",)),
    100: Prediction(np.array([0.1, 0.2]), np.full((2, 6), 0.2), ("motor", "rail")),
}


def flown(law: str, plans: dict[int, Prediction] | None = None) -> Tracked:
    """A spiral of 2 s from the centre outwards, with motor 1 at full command for a tenth of it."""
    recording = flight()
    time = 0.01 * np.arange(190)
    command = np.full((190, 6), 0.5)
    command[100:119, 0] = 1.0
    took = np.linspace(1e-3, 3e-3, 190)
    status, accelerations = ("optimal",) * 190, np.zeros((190, 3))
    log = FlightLog(time, command, status, accelerations, took, plans or {}, (), recording, CRAFT)
    track = Track.of(recording, CRAFT, law)
    table = Table(length_m=1.0, width_m=0.8)
    return Tracked("M4", law, None, track, None, log, CRAFT, table, f"M4 {law}")


@pytest.fixture(scope="module")
def flights() -> list[Tracked]:
    return [flown("lqr"), flown("mpc", PLANS)]


def test_figures_match_the_flight(flights):
    content = flights[1].to_json()
    assert content["saturated"] == pytest.approx(19 / 190 / 6)
    x, y = np.abs(flights[1].twin.pose[:, :2]).T
    radius = CRAFT.radius_m
    nearest = min((0.5 - radius - x).min(), (0.4 - radius - y).min())
    assert content["clearance_m"] == pytest.approx(nearest)
    assert content["step_ms"]["p50"] == pytest.approx(2.0)
    assert content["step_ms"]["max"] == pytest.approx(3.0)
    assert content["outcomes"] == {"optimal": 190} and content["law"] == "mpc"


def test_the_summary_has_the_same_columns_for_each_law(flights):
    found = summary(flights)
    lqr, mpc = (dict(zip(found.headings, row, strict=True)) for row in found.rows)
    assert (lqr["flight"], mpc["flight"]) == ("M4 lqr", "M4 mpc")
    assert lqr["nearest [mm]"] == f"{1e3 * flights[0].clearance.min():.0f}"
    assert (lqr["of all"], lqr["any"]) == ("1.7 %", "10 %")
    assert (mpc["median [ms]"], mpc["99 % [ms]"]) == ("2.00", "2.98")


def test_plans_are_drawn_at_their_ends_in_the_colour_of_the_active_limit(flights):
    lqr, mpc = path_figure(flights).axes
    assert not lqr.collections[0].get_segments()
    lines = mpc.collections[0]
    np.testing.assert_allclose([s[0, 0] for s in lines.get_segments()], [0.05, 0.1, 0.2])
    wanted = [style.BOUND_COLORS[k] for k in ("nothing", "motor", "motion")]
    assert [to_hex(c) for c in lines.get_colors()] == wanted
    *_, clearance = error_figure(flights).axes
    drawn = [line for line in clearance.lines if len(line.get_ydata()) > 2]
    for line, one in zip(drawn, flights, strict=True):
        np.testing.assert_allclose(line.get_ydata(), 1e3 * one.clearance)


def test_a_single_law_has_the_usual_page(flights):
    usual = [section.anchor for section in tracking_sections(flights[:1])]
    both = [section.anchor for section in tracking_sections(flights)]
    assert usual == ["tracking", "inputs"]
    assert both == ["summary", "tracking", "errors", "above", "outcomes", "inputs"]


def test_the_page_shows_both_laws_and_links_the_animation(flights, tmp_path):
    page = tracking_report(flights, "M4", tmp_path).read_text()
    assert "M4 lqr" in page and "M4 mpc" in page and "flight_M4_mpc.html" in page
    moving = (tmp_path / "flight_M4_mpc.html").read_text()
    found = re.search(r'<script type="application/json" id="flight">(.*?)</script>', moving)
    plans = json.loads(found[1])["plans"]
    assert [plan["color"] for plan in plans] == [
        style.BOUND_COLORS[k] for k in ("nothing", "motor", "motion")
    ]
    # As differences of tenths of a millimetre.
    assert [plan["x"] for plan in plans] == [[500, 0], [1000, 0], [2000, 0]]


def test_a_plan_is_shown_from_its_step_until_it_is_outdated(flights, tmp_path):
    scene = read_scene(flights[1].recording, CRAFT, log=flights[1].log)
    begin = scene.command_time[0]
    assert plan_at(scene, begin - 0.01) is None
    assert plan_at(scene, begin + 0.05).bound == "nothing"
    assert plan_at(scene, begin + 0.2).bound == "motor"
    assert plan_at(scene, begin + 0.5) is None
    assert not read_scene(flights[1].recording, CRAFT).plans
    path = animate(flights[1].recording, tmp_path / "a.gif", log=flights[1].log, span=(0.5, 0.7))
    assert path.stat().st_size > 1000
