"""The page: one self-contained file, complete or absent."""

import re
from dataclasses import replace

import numpy as np
import pytest

from airpuck import InputError, Table
from airpuck.deviation.packet_delays import PacketDelays
from airpuck.faults.strengths import find_strengths
from airpuck.model.uncertainty import DelayJitter
from airpuck.report.animation import Mover, moving_drawing
from airpuck.report.evaluation_report import JudgedModels
from airpuck.report.fit_report import fit_report
from airpuck.report.page import PageSection, PageTable, Picture, Text, write_page
from airpuck.report.style import new_figure

from ..apparatus.models import model_of
from ..apparatus.pages import barriers, check_self_contained


def sections():
    figure = new_figure(3, 2)
    figure.add_subplot()
    return [
        PageSection(
            "first",
            "First & last",
            (
                Text(["<b>not bold</b>"], bullets=True),
                PageTable("a table", ["name", "value"], [["x", "1"]], [("", 1), ("group", 1)]),
                Picture("picture", figure, 'a "caption" <here>'),
                Picture("drawing", '<svg xmlns="http://www.w3.org/2000/svg"/>', "drawn by hand"),
            ),
        )
    ]


def test_a_page_is_self_contained_and_escaped(tmp_path):
    path = write_page(tmp_path / "out", "A page", "about it", sections())
    text = path.read_text(encoding="utf-8")
    page = check_self_contained(text)
    assert "<b>" in page.text
    assert "<b>not" not in text
    assert "First & last" in page.text
    figures = tmp_path / "out" / "figures"
    assert (figures / "picture.png").read_bytes()[:4] == b"\x89PNG"
    assert (figures / "drawing.svg").read_text().startswith("<svg")
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == ["figures", "index.html"]


def test_the_answer_comes_first_and_only_terms_used_are_explained(tmp_path):
    answer = PageSection("summary", "In short", (Text(["M3 can be trusted."], bullets=True),))
    text = write_page(tmp_path, "A page", "about τ", [answer, *sections()]).read_text("utf-8")
    assert text.index("M3 can be trusted.") < text.index("<nav") < text.index("First &amp; last")
    assert re.findall("<dt>(.*)</dt>", text) == ["M3", "τ"]
    without = write_page(tmp_path, "A page", "about it", sections()).read_text("utf-8")
    assert without.index("<nav") < without.index("First &amp; last")
    assert "<dt>" not in without


@pytest.mark.browser
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_a_report_has_no_accessibility_barrier(tmp_path, chromium, scheme):
    sync_api = pytest.importorskip("playwright.sync_api")
    cells = [["a name that is long enough to scroll on a phone"] * 8]
    wide = PageTable("a wide table", ["name", *"abcdefg"], cells, [("", 1), ("group", 7)])
    answer = PageSection("summary", "In short", (Text(["M3 can be trusted."]), wide))
    path = write_page(tmp_path, "A page", "about τ", [answer, *sections()])
    with sync_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        for width in (1400, 390):
            look = {"viewport": {"width": width, "height": 800}, "color_scheme": scheme}
            tab = browser.new_context(**look).new_page()
            tab.goto(path.as_uri())
            tab.click("summary")
            assert barriers(tab) == []
            assert tab.evaluate("document.documentElement.scrollWidth") == width
        browser.close()


@pytest.mark.browser
@pytest.mark.parametrize(("preference", "moves"), [("reduce", False), ("no-preference", True)])
def test_a_drawing_moves_unless_reduced_motion_is_preferred(tmp_path, chromium, preference, moves):
    sync_api = pytest.importorskip("playwright.sync_api")
    time = np.linspace(0.0, 20.0, 201)
    craft = Mover("M3", "#0072b2", 0.07, time, np.column_stack([0.05 * time, 0 * time, time]))
    drawn = Picture("moving", moving_drawing(Table(), [craft]), "A flight.", moves=True)
    path = write_page(tmp_path, "A page", "about it", [PageSection("a", "A", [drawn])])
    with sync_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        tab = browser.new_context(reduced_motion=preference).new_page()
        tab.goto(path.as_uri())
        assert barriers(tab) == []
        first = tab.screenshot()
        tab.wait_for_timeout(1000)
        assert (tab.screenshot() != first) == moves
        browser.close()


def test_a_folder_that_is_a_file_is_rejected(tmp_path):
    (tmp_path / "out").write_text("mine")
    with pytest.raises(InputError, match="cannot be written"):
        write_page(tmp_path / "out", "A page", "about it", sections())
    assert (tmp_path / "out").read_text() == "mine"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("study", "on_another"), [("six", True), ("four", False)], indirect=["study"]
)
def test_any_craft_has_a_fit_report(study, judged, tmp_path, on_another, undrawn):
    truth = model_of(study.models[0].vehicle, "M3")
    on = judged if on_another else None
    path = fit_report(study.fits, study.training, tmp_path, judged=on, truth=truth)
    page = check_self_contained(path.read_text(encoding="utf-8"))
    assert ("prediction" in page.ids) == ("time" in page.ids) == on_another
    assert ("figure-prediction" in page.ids) == on_another
    assert {
        "summary",
        "flight",
        "figure-path",
        "craft",
        "thrust",
        "optimiser",
        "parameters",
        "sources",
    } <= page.ids
    for name in study.models[0].vehicle.propeller_names:
        assert name in page.text


def test_a_dead_motor_is_named_at_the_top(study, tmp_path, undrawn, monkeypatch):
    fit = study.fits[3]
    sound = find_strengths(fit.model, study.training)
    first, *others = sound.actuators
    dead = replace(first, value=0.0, interval_95=(-0.01, 0.01), verdict="dead")
    found = replace(sound, actuators=(dead, *others))
    monkeypatch.setattr("airpuck.report.fit_report.find_strengths", lambda *_: found)
    text = fit_report(fit, study.training, tmp_path).read_text(encoding="utf-8")
    assert f"Throughout the recording: {first.name} is dead" in text.split("The flight</h2>")[0]


def test_a_fit_report_shows_packet_arrivals(study, tmp_path, undrawn):
    jitter = DelayJitter(standard_deviation_s=0.0063, standard_error_s=0.0002, packets=3)
    delays = PacketDelays(np.array([20, 50, 90]), 1e-3 * np.array([-6.0, 1, 5]), np.full(3, 1e-3))
    fit = replace(
        study.fits[3],
        model=replace(study.fits[3].model, delay_jitter=jitter),
        packet_delays=(delays,),
    )
    page = check_self_contained(
        fit_report(fit, study.training, tmp_path).read_text(encoding="utf-8")
    )
    assert {"delay", "figure-packet_delays"} <= page.ids
    assert "jitter 6.3 ± 0.2 ms over 3 packets" in page.text


def test_a_fit_to_several_recordings_names_all_of_them(study, tmp_path, undrawn):
    both = [replace(study.training, source=f"lab/{name}") for name in ("monday", "tuesday")]
    page = fit_report(study.fits[3], both, tmp_path).read_text(encoding="utf-8")
    assert f"identified from {2 * study.training.duration:.1f} s of flight" in page
    assert "2 recordings; figures show the first" in page
    assert "lab/monday" in page and "lab/tuesday" in page


def test_a_single_fit_without_truth_has_a_report(study, judged, tmp_path, undrawn):
    alone = JudgedModels(judged.trajectory, judged.evaluations[3:4])
    path = fit_report(study.fits[3], study.training, tmp_path, judged=alone)
    page = check_self_contained(path.read_text(encoding="utf-8"))
    assert "figure-parameters" not in page.ids
    assert "delay" not in page.ids
    with pytest.raises(InputError, match="no fit"):
        fit_report((), study.training, tmp_path)


def test_commands_in_sentences_are_formatted_as_code_and_escaped(tmp_path):
    section = PageSection("a", "A", (Text(["run `airpuck a <b>` & wait", "a single ` stays"]),))
    text = write_page(tmp_path / "out", "A page", "about it", [section]).read_text("utf-8")
    assert "run <code>airpuck a &lt;b&gt;</code> &amp; wait" in text
    assert "a single ` stays" in text
