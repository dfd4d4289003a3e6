"""The live view: valid set points; and, in a real browser, that the craft follows them."""

import io
import json
import math
import signal
import socket
from collections.abc import Iterator
from dataclasses import dataclass
from threading import Thread
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from PIL import Image

import airpuck
from airpuck.craft.table import Table
from airpuck.deviation.significance import ModelError
from airpuck.estimate.estimator import ActuationEstimate
from airpuck.flight.health import Health
from airpuck.live.watch import Observer
from airpuck.web.requests import Wish, packed_state
from airpuck.web.server import SCENE, STATE
from airpuck.web.view import (
    VIEW_PAGE,
    Gauge,
    health_gauges,
    inside,
    judged,
    plan_gauges,
    timing_gauges,
    view_hello,
)

from ..apparatus.arena import Arena
from ..apparatus.pages import barriers
from ..apparatus.processes import POSES, REFERENCES, Process, Watch


def test_times_are_compared_with_their_limits():
    figures = {"pose_to_command_ms": "2.50 (p99)", "period_jitter_ms": "4.00 (p99)"}
    latency, jitter, missed = timing_gauges({**figures, "missed_deadlines": "3"})
    assert (latency.value, latency.share) == ("2.50 of 5 ms", pytest.approx(0.5))
    assert (jitter.value, jitter.share) == ("4.00 of 2 ms", pytest.approx(2.0))
    assert missed == Gauge("missed deadlines", "3")
    assert timing_gauges({"pose_age_ms": "what"}) == []


def test_a_plan_is_shown_only_while_it_is_recent():
    figures = {"limits": "motor, rail", "bound by": "motion"}
    shown = plan_gauges(10.0, "softened", figures, 11.0)
    assert shown == [Gauge("plan", "softened"), Gauge("limits ahead", "motor, rail")]
    assert plan_gauges(10.0, "optimal", {"limits": ""}, 11.0)[1].value == "none"
    assert plan_gauges(10.0, "softened", figures, 13.0) == []


def test_findings_of_a_controller_are_shown_while_it_flies():
    found = ActuationEstimate(np.array([0.62, 1.0]), np.array([0.03, 0.1]), {}, 0.0124, 0.001)
    beat = 10.0, "exact", {"missed_deadlines": "0", **found.figures(["left", "right"])}
    beats = {"airpuck fly craft_2": beat, "airpuck record": (10.9, "info", {"poses": "3"})}
    observer = SimpleNamespace(beats=beats, clock=SimpleNamespace(now=11.0))
    found = {"left": "62 ± 3 %", "right": "100 ± 10 %", "delay": "+12.4 ± 1.0 ms"}
    assert Observer.found.fget(observer) == found
    observer.clock.now = 13.0
    assert Observer.found.fget(observer) == {}


def test_each_channel_and_each_motor_has_a_gauge():
    errors = (
        ModelError("delay", 0.002, 0.001, 0.005, True, 1.0, -0.02),
        ModelError("left", -0.2, 0.01, 0.05, True, 1e-9, 0.6),
        ModelError("right", 0.0, 0.01, 0.05, True, 1.0, 0.1),
    )
    health = Health(True, 30, np.array([8e-3, 4e-3, 0.1]), errors)
    assert judged(health)
    (_, errors), (_, causes) = health_gauges(health)
    assert errors == [
        ("x", "8.0 mm", pytest.approx(0.5)),
        ("y", "4.0 mm", pytest.approx(0.25)),
        ("yaw", "0.100 rad", pytest.approx(0.2)),
    ]
    assert causes == [
        ("left", "80 ± 1 %", pytest.approx(0.6)),
        ("right", "100 ± 1 %", pytest.approx(0.1)),
        ("delay", "+2.0 ± 1.0 ms", pytest.approx(-0.02)),
    ]
    assert health.findings == ("left gives 20.0 % ± 1.0 % less than modelled",)
    assert "; shares of the error: left 60 %" in str(health)


def test_a_craft_without_a_verdict_is_described_in_words():
    health = Health(False, 0, np.full(3, np.nan), ())
    assert not judged(health)
    assert health_gauges(health) == [(str(health), [])]


def test_a_set_point_stays_inside_the_rails():
    np.testing.assert_array_equal(
        inside(Wish(1, 0.25, -2.0, 1.0), (1.0, 0.5)), [0.25, -0.5, 1.0, 0, 0, 0]
    )


# In the browser -----------------------------------------------------------------------------------


# This one comes first: a second Playwright cannot start while the page of the flights is open.
@pytest.mark.browser
@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", [1400, 390])
def test_the_live_page_has_no_accessibility_barrier(chromium, scheme, width):
    sync_api = pytest.importorskip("playwright.sync_api")
    # Nothing flies here, so a busy machine only makes this test slow.
    arena = Arena(view_hello(airpuck.read_model("paper:M3"), Table()), page=VIEW_PAGE)
    state = packed_state(0.0, 0, True, (0.0,) * 3, (0.0,) * 4, (0.2, 0.1, 0.5), (0.3,) * 6)
    scene = {"seen": True, "set_point": [0.5, 0.2, 0.0], "plan": None, "hint": "Drag the ring."}
    gauges = [Gauge("controller", "optimal"), Gauge("age of the pose", "14.0 of 10 ms", 1.4)]
    panel = {"flight": gauges, "health": [("Errors", gauges)], "findings": [["weak", "warning"]]}
    panel["events"] = [["1 s ago, fly: no pose", "error"], ["2 s ago, fly: flying", "info"]]
    try:
        with sync_api.sync_playwright() as playwright:
            browser = playwright.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
            look = {"viewport": {"width": width, "height": 800}, "color_scheme": scheme}
            tab = browser.new_context(**look).new_page()
            tab.goto(f"http://127.0.0.1:{arena.port}", timeout=120_000)
            while not tab.evaluate("document.getElementById('events').childElementCount"):
                arena.pipe.send_bytes(STATE + state)
                for name, content in (("scene", scene), ("panel", panel)):
                    message = json.dumps({"is": name, **content}).encode()
                    arena.pipe.send_bytes(SCENE + message)
            tab.evaluate("requestAnimationFrame = () => 0")  # leaves the processor to axe-core
            assert barriers(tab) == []
            assert tab.evaluate("document.documentElement.scrollWidth") == width
            browser.close()
    finally:
        arena.close()


@pytest.fixture(scope="module")
def flight(domain, chromium) -> Iterator[tuple[Watch, int, Process]]:
    """A twin, a controller that follows the graph, and a view: the watcher, the port, the view."""
    pytest.importorskip("websockets")
    watch = Watch(domain)
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    commands = [["twin"], ["fly"], ["view"]]
    options = {"fly": ["--follow"], "view": ["--port", port]}
    processes = [
        Process(*words, "paper:M3", *options.get(words[0], ()), domain=domain) for words in commands
    ]
    try:
        watch.until(lambda: "flying" in watch.events("fly"), timeout=90)
        watch.until(lambda: any("at http" in said for said in watch.events("view")), timeout=90)
        yield watch, port, processes[-1]
    finally:
        for process in processes:
            process.kill()
        watch.close()


@dataclass
class Page:
    """The page in headless Chromium, and a watcher of the graph."""

    page: Any
    watch: Watch
    asked: list[str]

    def picture(self) -> np.ndarray:
        """Return the current screen: red, green, blue."""
        image = Image.open(io.BytesIO(self.page.screenshot())).convert("RGB")
        return np.array(image).astype(int)

    def pixel(self, point) -> tuple[float, float]:
        """Return the screen position of a point on the table."""
        x, y = map(float, point)
        return tuple(
            self.page.evaluate(
                f"""(() => {{ const [px, py] = table.toPixels({x}, {y});
                const box = table.canvas.getBoundingClientRect();
                return [box.left + px, box.top + py]; }})()"""
            )
        )

    def around(self, picture: np.ndarray, point, size: int = 6) -> np.ndarray:
        """Return the part of a picture around a point on the table."""
        x, y = map(round, self.pixel(point))
        return picture[y - size : y + size, x - size : x + size]

    def shows_set_point(self, pose) -> bool:
        """Return whether the ring's colour is visible around the craft."""
        red, _, blue = self.around(self.picture(), (pose[0], pose[1] - 0.085)).mean(axis=(0, 1))
        return bool(red - blue > 25)

    def drag(self, begin, end) -> None:
        """Drag from one point of the table to another."""
        self.page.mouse.move(*self.pixel(begin))
        self.watch.run(0.3)
        self.page.mouse.down()
        for share in np.linspace(0.1, 1.0, 10):
            self.page.mouse.move(*self.pixel(np.add(begin, share * np.subtract(end, begin))))
            self.watch.run(0.1)
        self.watch.run(0.3)
        self.page.mouse.up()

    @property
    def pose(self) -> np.ndarray:
        """Return the position of the craft."""
        return self.watch.newest(POSES)

    @property
    def wish(self) -> np.ndarray:
        """Return the set point that the page requests."""
        return self.watch.newest(REFERENCES)

    def ask(self, **numbers: float) -> None:
        """Enter numbers of a set point."""
        labels = {"yaw": "yaw [rad]", "y": "y [m]", "x": "x [m]"}
        for name, value in numbers.items():
            box = self.page.get_by_label(labels[name])
            box.fill(f"{value:g}")
            box.press("Enter")

    def enter(self, x: float, y: float, yaw: float) -> None:
        """Enter a set point as numbers, and wait until the craft is there."""
        # On a busy machine a page that lags may overwrite a new set point with an old one.
        for _ in range(5):
            self.ask(x=x, y=y, yaw=yaw)
            self.watch.run(1.5)
            if self.watch.heard[REFERENCES] and np.allclose(self.wish[:3], (x, y, yaw)):
                break
        self.arrives((x, y), yaw)

    def arrives(self, place, yaw: float | None = None) -> None:
        """Wait until the craft rests at a place."""

        def there() -> bool:
            poses = np.array(self.watch.values(POSES)[-60:])
            if len(poses) < 60:
                return False
            off = np.hypot(*(poses[:, :2] - place).T).max()
            turned = 0.0 if yaw is None else np.abs(poses[:, 2] - yaw).max()
            return bool(off < 0.03 and turned < 0.25)

        self.watch.forget()
        self.watch.until(there, timeout=60)


@pytest.fixture(scope="module")
def page(flight, chromium) -> Iterator[Page]:
    """The page, painted."""
    sync_api = pytest.importorskip("playwright.sync_api")
    watch, port, _ = flight
    with sync_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        tab = browser.new_page(viewport={"width": 1280, "height": 720})
        asked: list[str] = []
        tab.on("request", lambda request: asked.append(request.url))
        tab.goto(f"http://127.0.0.1:{port}", timeout=60_000)
        while not tab.evaluate("airpuck.scene().set_point !== null"):
            watch.run(0.1)
        shown = Page(tab, watch, asked)
        watch.until(lambda: shown.shows_set_point(shown.pose), timeout=60)
        yield shown
        browser.close()


@pytest.mark.browser
def test_entering_a_set_point_moves_the_craft_on_the_page(page, flight):
    left, right = (-0.6, -0.2), (0.4, 0.1)
    page.enter(*left, 0.0)
    page.watch.until(lambda: page.shows_set_point(left), timeout=60)
    before = page.picture()
    page.enter(*right, 0.0)
    page.watch.until(lambda: not page.shows_set_point(left), timeout=60)
    after = page.picture()
    for place in (left, right):
        changed = page.around(after, place, 30) - page.around(before, place, 30)
        assert np.abs(changed).max() > 150  # the craft's dark outline and mark
    unchanged = np.abs(page.around(after, (0.9, -0.4)) - page.around(before, (0.9, -0.4)))
    assert unchanged.mean() < 5
    # The page fetches nothing from other hosts.
    _, port, _ = flight
    ours = (f"http://127.0.0.1:{port}", f"ws://127.0.0.1:{port}", "data:", "blob:")
    assert [url for url in page.asked if not url.startswith(ours)] == []


@pytest.mark.browser
def test_dragging_the_set_point_moves_the_craft(page):
    start, goal = np.array([-0.6, -0.2]), np.array([0.4, 0.15])
    page.enter(*start, 0.0)
    # Grab it off-centre: the grabbed point stays under the pointer.
    grip = np.array([-0.03, -0.08])
    page.drag(start + grip, goal + grip)
    page.watch.run(0.5)
    np.testing.assert_allclose(page.wish[:3], (*goal, 0.0), atol=0.02)
    page.arrives(page.wish[:2], 0.0)


@pytest.mark.browser
def test_dragging_the_handle_turns_the_craft(page):
    place, radius = np.array([0.1, 0.0]), 1.95 * 0.07
    page.enter(*place, 0.0)
    page.drag(np.add(place, (radius, 0.0)), np.add(place, (0.0, 0.25)))
    page.watch.run(0.5)
    np.testing.assert_allclose(page.wish[:3], (*place, math.pi / 2), atol=0.1)
    page.arrives(place, page.wish[2])


@pytest.mark.browser
def test_a_picture_for_the_documentation_is_taken(page, flight, request):
    """Take a picture in flight, with the set point ahead; store it as ``--screenshot FILE``."""
    view = flight[2]

    def stop_on_the_way() -> None:
        page.watch.until(lambda: page.pose[0] > -0.3, timeout=30)
        view.signal(signal.SIGSTOP)

    page.enter(-0.7, -0.25, 0.0)
    page.watch.forget()
    page.watch.until(lambda: page.watch.heard[POSES])
    # Entering numbers and taking a picture take longer than the flight, so freeze the display.
    stopping = Thread(target=stop_on_the_way)
    stopping.start()
    try:
        page.ask(yaw=0.8, y=0.22, x=0.6)
        stopping.join()
        page.watch.run(1.0)
        picture = page.picture()
    finally:
        view.signal(signal.SIGCONT)
    assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 200  # painted
    path = request.config.getoption("--screenshot")
    if path is not None:
        image = Image.fromarray(picture.astype(np.uint8)).quantize(128, dither=Image.Dither.NONE)
        image.save(path, optimize=True)
