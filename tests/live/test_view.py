"""The live view: what the user may wish for; and, in a real browser, that the craft obeys."""

from __future__ import annotations

import math
import shutil
import socket
from collections.abc import Iterator

import numpy as np
import pytest

from airpuck.live.view import Wishes

from .processes import POSES, Process, Watch

REACH = (1.0, 0.5)


def test_wishes_stay_inside_the_rails_and_are_taken_once():
    wishes = Wishes(REACH)
    assert wishes.take() is None
    wishes.put(0.3, -2.0, 1.0)
    np.testing.assert_array_equal(wishes.take(), [0.3, -0.5, 1.0, 0, 0, 0])
    assert wishes.take() is None
    np.testing.assert_array_equal(wishes.newest, [0.3, -0.5, 1.0, 0, 0, 0])
    wishes.put(math.nan, 0.0, 0.0)
    assert wishes.take() is None


@pytest.fixture(scope="module")
def flight(domain) -> Iterator[tuple[Watch, int]]:
    """A twin, a controller that follows the graph, a view: who watches them, and the port."""
    pytest.importorskip("viser")
    watch = Watch(domain)
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    commands = [["twin"], ["fly", "--topic"], ["view", "--port", port]]
    processes = [Process(*words, "--model", "paper:M3", domain=domain) for words in commands]
    try:
        watch.until(lambda: "flying" in watch.events("fly"), timeout=90)
        watch.until(lambda: any("at http" in said for said in watch.events("view")), timeout=90)
        yield watch, port
    finally:
        for process in processes:
            process.kill()
        watch.close()


@pytest.fixture
def page(flight):
    """The page in headless Chromium, painted."""
    chromium = shutil.which("chromium") or shutil.which("chromium-browser")
    if chromium is None:
        pytest.skip("needs Chromium: install the distribution's package")
    sync_api = pytest.importorskip("playwright.sync_api")
    software = ["--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
    with sync_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=chromium, args=[*software, "--no-sandbox"]
        )
        page = browser.new_page(viewport={"width": 1200, "height": 700})
        page.asked = []
        page.on("request", lambda request: page.asked.append(request.url))
        page.goto(f"http://127.0.0.1:{flight[1]}", timeout=60_000)
        page.get_by_label("x [m]").wait_for(timeout=60_000)
        yield page
        browser.close()


def reaches(watch: Watch, x: float, y: float) -> bool:
    """Whether the craft is where it should be."""
    poses = watch.values(POSES)[-1:]
    return bool(poses) and math.hypot(poses[0][0] - x, poses[0][1] - y) < 0.05


@pytest.mark.browser
def test_entering_a_set_point_moves_the_craft(page, flight):
    watch, port = flight
    number = page.get_by_label("x [m]")
    number.fill("0.4")
    number.press("Enter")
    watch.until(lambda: reaches(watch, 0.4, 0.0), timeout=60)
    # Nothing is fetched from elsewhere.
    ours = (f"http://127.0.0.1:{port}", f"ws://127.0.0.1:{port}", "data:", "blob:")
    assert [url for url in page.asked if not url.startswith(ours)] == []
