"""The page of a game in a real browser; only the last test plays a real game."""

import io
import json
import math
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

import airpuck
from airpuck.craft.table import Mallet, Table
from airpuck.twin.play import HandMallet
from airpuck.twin.settings import default_twin_settings
from airpuck.web.requests import packed_state
from airpuck.web.server import EVENT, SCENE, STATE, THOUGHT
from airpuck_hockey.game.contestant import contestant
from airpuck_hockey.game.game import Game
from airpuck_hockey.game.rules import Rules
from airpuck_hockey.web import page as match_page
from airpuck_hockey.web.live_page import live_hello
from airpuck_hockey.web.page import GAME_PAGE, hello_of, watch_in_browser
from airpuck_hockey.web.settings import ArenaSettings
from tests.apparatus.arena import Arena, free_port
from tests.apparatus.pages import barriers


@pytest.mark.slow
def test_a_page_shows_a_game_from_start_to_end(monkeypatch):
    pytest.importorskip("websockets")
    from websockets.exceptions import ConnectionClosed
    from websockets.sync.client import connect

    monkeypatch.setattr(match_page, "_END", 0.2)
    players = contestant("human:hard"), contestant("human:easy")
    game, said = Game(*players, rules=Rules(limit_s=1.0)), []
    arena, ready = ArenaSettings(free_port(), browser=False), threading.Event()

    def tell(line: str) -> None:
        said.append(line)
        ready.set()

    model = airpuck.read_model("paper:M3")
    playing = threading.Thread(target=watch_in_browser, args=(game, model, arena, tell))
    playing.start()
    assert ready.wait(30.0)
    assert said == [f"Watch at http://127.0.0.1:{arena.port} (Ctrl-C ends)"]
    assert game.time == 0.0  # it waits for the page
    news, states = [], []
    with connect(f"ws://127.0.0.1:{arena.port}/", compression=None) as page:
        try:
            while True:
                message = page.recv(timeout=30)
                (states if isinstance(message, bytes) else news).append(message)
        except ConnectionClosed:
            pass
    playing.join(30.0)
    hello, *news = map(json.loads, news)
    assert hello["names"] == ["human:hard", "human:easy"]
    assert hello["sides"] == ["hand", "hand"]
    assert {one["phase"] for one in news if one["is"] == "status"} == {"watch"}
    assert news[-1] == {"is": "event", "kind": "over", "side": 0}
    seen = [struct.unpack("<dIB3x10f", state) for state in states]
    assert seen[-1][0] == pytest.approx(1.0)
    # The positions of both mallets equal those at the end of the game.
    left, right = game.sides
    assert seen[-1][6:8] == pytest.approx(right.state[:2], abs=1e-6)
    assert seen[-1][10:12] == pytest.approx(left.state[:2], abs=1e-6)


pytestmark = pytest.mark.browser

ROOT = Path(__file__).parents[4]
VERMILLION = (213, 94, 0)


@pytest.fixture(scope="module")
def browser(chromium) -> Iterator[Any]:
    """Headless Chromium."""
    sync_api = pytest.importorskip("playwright.sync_api")
    with sync_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        yield browser
        browser.close()


def greeting(say=hello_of) -> dict[str, Any]:
    return say(airpuck.read_model("paper:M3"), default_twin_settings())


@pytest.fixture
def arena() -> Iterator[Arena]:
    """A server."""
    with closing(Arena(greeting(), page=GAME_PAGE)) as made:
        yield made


class Page:
    """A page of a game whose states the test sets."""

    def __init__(self, browser: Any, arena: Arena, **look: Any) -> None:
        self._arena, self._time = arena, 0.0
        self.tab = browser.new_context(**look).new_page()
        self.errors: list[str] = []
        self.asked: list[str] = []
        self.tab.on("pageerror", lambda error: self.errors.append(str(error)))
        self.tab.on("console", lambda line: self.errors.append(line.text))
        self.tab.on("request", lambda request: self.asked.append(request.url))
        self.tab.goto(f"http://127.0.0.1:{arena.port}/")
        self.until("table && table.scale > 0")

    def until(self, condition: str) -> None:
        """Wait until a condition holds; the page's policy forbids the browser's own function."""
        for _ in range(200):
            if self.tab.evaluate(condition):
                return
            time.sleep(0.05)
        raise AssertionError(condition)

    def status(self, phase: str, score: tuple[int, int] = (0, 0), level: str = "medium") -> None:
        """Report the state of the game."""
        status = {"is": "status", "phase": phase, "score": score, "level": level}
        self._arena.pipe.send_bytes(SCENE + json.dumps(status).encode())
        self.until(
            "airpuck.status().phase + airpuck.status().score + airpuck.status().level === "
            f"'{phase}{score[0]},{score[1]}{level}'"
        )

    def show(self, puck=(0.3, 0.2, 0.0), mallet=(0.8, -0.1), craft=(-0.8, 0.1, 0.0)) -> None:
        """Place everything, and wait until it is drawn."""
        for _ in range(20):
            self._time += 0.01
            places = puck, (*mallet, 0.0, 0.0), craft
            self._state = STATE + packed_state(self._time, 0, False, *places, (0.0,) * 6)
            self.again()
        time.sleep(0.1)

    def calls(self, kind: str, side: int, words: str) -> None:
        """Report an event, and wait until the page calls it."""
        event = {"is": "event", "kind": kind, "side": side, "strength": 0.0}
        self._arena.pipe.send_bytes(EVENT + json.dumps(event).encode())
        self.until(f"document.getElementById('call').textContent === {json.dumps(words)}")

    def again(self) -> None:
        """Send the newest state again."""
        self._arena.pipe.send_bytes(self._state)
        time.sleep(0.01)

    def pixel(self, x: float, y: float) -> tuple[float, float]:
        """Return the screen position of a point on the table."""
        return tuple(
            self.tab.evaluate(
                f"""(() => {{ const [px, py] = table.toPixels({x}, {y});
                const box = table.canvas.getBoundingClientRect();
                return [box.left + px, box.top + py]; }})()"""
            )
        )

    def color(self, x: float, y: float) -> np.ndarray:
        """Return its colour, the median of 5 × 5 points."""
        image = Image.open(io.BytesIO(self.tab.screenshot())).convert("RGB")
        sharp = image.width / self.tab.viewport_size["width"]
        px, py = (round(sharp * value) for value in self.pixel(x, y))
        part = np.array(image)[py - 2 : py + 3, px - 2 : px + 3].reshape(-1, 3)
        return np.median(part, axis=0)


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", [1280, 390])
def test_the_game_has_no_accessibility_barrier(browser, arena, width, scheme):
    page = Page(browser, arena, viewport={"width": width, "height": 800}, color_scheme=scheme)
    assert barriers(page.tab) == []
    page.status("play")
    assert barriers(page.tab) == []


@pytest.mark.parametrize(
    ("width", "height", "tall"), [(1280, 720, False), (390, 800, True), (800, 360, False)]
)
def test_everything_is_drawn_where_the_state_says(browser, arena, width, height, tall):
    page = Page(browser, arena, viewport={"width": width, "height": height})
    page.status("play")
    page.show()
    np.testing.assert_allclose(page.color(0.8, -0.1), VERMILLION, atol=12)
    np.testing.assert_allclose(page.color(0.29, 0.2), (34, 34, 34), atol=12)
    np.testing.assert_allclose(page.color(-0.8, 0.1), (255, 255, 255), atol=12)
    floor = page.color(0.4, -0.3)
    page.show(mallet=(0.4, -0.3))
    np.testing.assert_allclose(page.color(0.4, -0.3), VERMILLION, atol=12)
    np.testing.assert_allclose(page.color(0.8, -0.12), floor, atol=6)
    # The person's goal is on the right, or at the bottom; the whole table is visible.
    assert page.tab.evaluate("table.tall") == tall
    (x0, y0), (x1, y1) = page.pixel(-1.1, 0.55), page.pixel(1.1, -0.55)
    assert (y1 > y0) if tall else (x1 > x0)
    for x, y in ((x0, y0), (x1, y1)):
        assert 0 < x < width
        assert 0 < y < height
    # Nothing is cut off or scrolls.
    assert page.tab.evaluate(
        "[...document.querySelectorAll('button, output')].every(one => { const box = "
        "one.getBoundingClientRect(); return !box.width || box.left >= 0 && box.right <= innerWidth"
        " && box.bottom <= innerHeight; }) && document.documentElement.scrollHeight <= innerHeight"
    )
    assert page.errors == []
    ours = (f"http://127.0.0.1:{arena.port}", f"ws://127.0.0.1:{arena.port}", "data:")
    assert [url for url in page.asked if not url.startswith(ours)] == []


def test_everything_stays_in_place_while_time_stands_still(browser, arena):
    page = Page(browser, arena, viewport={"width": 1280, "height": 720})
    page.status("paused")
    page.show()
    for _ in range(250):
        page.again()
    np.testing.assert_allclose(page.color(0.8, -0.1), VERMILLION, atol=12)
    assert page.tab.evaluate("airpuck.states.length") <= 20


def test_the_pointer_position_is_sent_in_metres(browser, arena):
    page = Page(browser, arena, viewport={"width": 1280, "height": 720})
    arena.hears("sit")
    page.status("play")
    page.show()
    page.tab.mouse.move(*page.pixel(0.5, 0.25))
    _, (number, x, y, _) = arena.heard()
    assert number in (1, 2)  # a raw update, and the move with the next frame
    assert (x, y) == pytest.approx((0.5, 0.25), abs=0.004)


def test_a_finger_moves_the_mallet_ahead_of_it(browser, arena):
    page = Page(
        browser, arena, viewport={"width": 390, "height": 800}, has_touch=True, is_mobile=True
    )
    arena.hears("sit")
    page.status("play")
    page.show()
    page.tab.touchscreen.tap(*page.pixel(0.6, 0.1))
    _, (_, x, y, _) = arena.heard()
    assert y == pytest.approx(0.1, abs=0.01)
    # Upwards, towards the craft.
    assert 0.3 < x < 0.5


def test_the_page_predicts_the_mallet_like_the_server(browser, arena):
    page = Page(browser, arena, viewport={"width": 800, "height": 500})
    random = np.random.default_rng(0)
    hand = HandMallet(Mallet(), Table(), 0.85, 0.0)
    mallet = [hand.x, hand.y, 0.0, 0.0]
    for _ in range(40):
        hand.target = tuple(random.uniform((-0.2, -0.7), (1.3, 0.7)).tolist())
        for _ in range(4):
            way = hand.moving(0.01)
            way.x, way.y = way.to_x, way.to_y
            hand.arrive(way, 0.01)
            mallet = page.tab.evaluate(f"moved({mallet}, {list(hand.target)}, 0.01)")
            assert mallet == pytest.approx((hand.x, hand.y, hand.vx, hand.vy), abs=1e-9)


def test_keys_buttons_and_cards_work(browser, arena):
    page = Page(browser, arena, viewport={"width": 1280, "height": 720})
    arena.hears("sit")
    title, go = page.tab.locator("#title"), page.tab.locator("#go")
    page.status("ready")
    assert "First to 7" in page.tab.locator("#words").inner_text()
    go.click()
    arena.hears("go")
    page.status("play", (2, 3))
    assert not page.tab.locator("#card").is_visible()
    assert page.tab.locator(".score").inner_text().split() == ["airpuck", "2", ":", "3", "you"]
    page.tab.keyboard.press(" ")
    arena.hears("pause")
    page.status("paused", (2, 3))
    assert title.inner_text() == "Paused"
    assert go.inner_text() == "Resume"
    assert "R restarts" in page.tab.locator("#hint").inner_text()
    assert page.tab.locator("#pause").get_attribute("aria-label") == "Resume"
    page.tab.keyboard.press(" ")
    arena.hears("go")
    page.tab.get_by_role("button", name="easy").click()
    assert arena.ordered() == {"do": "level", "level": "easy", "on": False}
    assert "at the level easy" in page.tab.locator("#words").inner_text()
    page.status("over", (3, 7), "easy")
    assert title.inner_text() == "You win"
    go.click()
    arena.hears("restart")
    page.status("over", (7, 3), "easy")
    assert title.inner_text() == "The craft wins"
    page.tab.keyboard.press("r")
    arena.hears("restart")
    sound = page.tab.locator("#sound")
    assert sound.get_attribute("aria-pressed") == "true"
    page.tab.keyboard.press("m")
    assert sound.get_attribute("aria-pressed") == "false"
    page.tab.reload()
    assert sound.get_attribute("aria-pressed") == "false"
    assert page.errors == []


def look(page: Page, name: str, *properties: str) -> list[str]:
    """Return computed style properties of a button."""
    style = f"getComputedStyle([...document.querySelectorAll('button')].find(b => b.{name}))"
    return [page.tab.evaluate(f"{style}.getPropertyValue('{one}')") for one in properties]


def brightness(color: str) -> float:
    """Return the relative luminance of a CSS colour (WCAG 2.2); NaN if it is transparent."""
    parts = [float(part) for part in color[color.index("(") + 1 : -1].split(",")]
    if parts[3:] == [0.0]:
        return math.nan
    linear = [
        c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4
        for c in np.divide(parts[:3], 255)
    ]
    return float(np.dot((0.2126, 0.7152, 0.0722), linear))


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_the_selected_level_stays_readable_under_the_pointer(browser, arena, scheme):
    page = Page(browser, arena, viewport={"width": 1280, "height": 720}, color_scheme=scheme)
    arena.hears("sit")
    page.status("play")
    page.tab.get_by_role("button", name="medium").hover()
    pressed = "textContent === 'medium'"
    ink, ground = map(brightness, look(page, pressed, "color", "background-color"))
    low, high = sorted((ink, ground))
    assert (high + 0.05) / (low + 0.05) > 7
    # The focus ring is not cut off by what surrounds the button.
    assert page.tab.evaluate("getComputedStyle(byId('levels')).overflow") == "visible"


def test_buttons_on_a_phone_are_large_enough_for_a_thumb(browser, arena):
    for width, height in ((390, 800), (320, 640), (800, 360)):
        page = Page(
            browser,
            arena,
            viewport={"width": width, "height": height},
            has_touch=True,
            is_mobile=True,
        )
        page.status("ready")
        sizes = page.tab.evaluate(
            "[...document.querySelectorAll('button')].map(one => one.getBoundingClientRect())"
            ".filter(box => box.width).map(box => [box.width, box.height])"
        )
        assert len(sizes) >= 7
        assert np.min(sizes) >= 44
        page.tab.close()


def test_a_level_chosen_while_a_game_starts_is_announced_and_sent(browser, arena):
    page = Page(browser, arena, viewport={"width": 1280, "height": 720})
    arena.hears("sit")
    page.status("starting")
    hard = page.tab.get_by_role("button", name="hard")
    hard.click()
    assert arena.ordered() == {"do": "level", "level": "hard", "on": False}
    assert hard.get_attribute("aria-pressed") == "true"
    assert "at the level hard" in page.tab.locator("#words").inner_text()
    page.status("ready")  # of the game that was already starting
    assert "at the level hard" in page.tab.locator("#words").inner_text()
    page.status("ready", level="hard")
    assert "First to 7" in page.tab.locator("#words").inner_text()
    # The pointer gave the space bar back.
    page.tab.keyboard.press(" ")
    arena.hears("go")


@pytest.mark.parametrize(("width", "height"), [(1280, 720), (390, 800)])
def test_arrow_keys_move_the_mallet_in_their_direction(browser, arena, width, height):
    page = Page(browser, arena, viewport={"width": width, "height": height})
    arena.hears("sit")
    page.status("play")
    page.show(mallet=(0.6, 0.1))
    start = page.pixel(0.6, 0.1)
    for key, (right, down) in {"ArrowUp": (0, -1), "d": (1, 0), "ArrowDown": (0, 1)}.items():
        page.tab.evaluate("wishes.length = 0")
        page.tab.keyboard.down(key)
        page.tab.wait_for_timeout(150)
        page.tab.keyboard.up(key)
        page.tab.wait_for_timeout(50)
        _, (_, x, y, _) = arena.heard()
        while arena.pipe.poll(0.1):
            _, (_, x, y, _) = arena.heard()
        moved = np.subtract(page.pixel(x, y), start)
        assert moved @ (right, down) > 5
        assert abs(moved @ (down, right)) < 1
        assert arena.silent()


def test_space_presses_the_focused_button(browser, arena):
    page = Page(browser, arena, viewport={"width": 1280, "height": 720})
    arena.hears("sit")
    page.status("play")
    page.tab.get_by_role("button", name="easy").focus()
    page.tab.keyboard.press(" ")
    assert arena.ordered() == {"do": "level", "level": "easy", "on": False}
    assert arena.silent()


def test_a_dark_page_draws_a_dark_table(browser, arena):
    page = Page(browser, arena, viewport={"width": 1280, "height": 720}, color_scheme="dark")
    page.status("play")
    page.show()
    assert page.color(0.4, -0.3).max() < 60
    assert page.color(0.29, 0.2).min() < 100 < page.color(0.29, 0.2).max()  # a yellow puck
    page.tab.emulate_media(color_scheme="light")
    page.show()
    assert page.color(0.4, -0.3).min() > 200
    assert page.errors == []


def test_a_page_states_that_games_are_recorded(browser, arena):
    page = Page(browser, arena, viewport={"width": 1280, "height": 720})
    arena.hears("sit")
    words, name = page.tab.locator("#words"), page.tab.locator("#right-name")
    page.status("ready")
    assert "recorded" not in words.inner_text() + name.inner_text()
    page.tab.evaluate("hello.recorded = true")
    page.status("paused")
    page.status("ready")
    assert "Games are recorded." in words.inner_text()
    page.status("play")
    assert name.inner_text() == "you, recorded"


def test_thoughts_are_drawn_on_request(browser, arena):
    page = Page(browser, arena, viewport={"width": 1280, "height": 720})
    arena.hears("sit")
    page.status("play")
    page.show()
    empty = page.color(-0.4, 0.2)
    page.tab.keyboard.press("t")
    assert arena.ordered()["on"] is True
    thought = {
        "is": "thought",
        "words": "strike 64 %",
        "said": "strike 64 %, in 0.21 s",
        # The first dash of the puck's ring covers the sampled point.
        "meet": [-0.4 - 0.03165 * math.cos(0.18), 0.2 + 0.03165 * math.sin(0.18)],
        "path": [[-0.3, 0.2], [1.1, 0.0]],
        "predicted": [[0.3, 0.2], [-0.3, 0.2]],
    }
    arena.pipe.send_bytes(THOUGHT + json.dumps(thought).encode())
    page.show()
    page.until("document.getElementById('said').textContent.includes('0.21 s')")
    red, green, blue = page.color(-0.4, 0.2)
    assert empty.min() > 200
    assert red > green + 20
    assert blue > green + 10
    assert page.errors == []


def test_the_second_page_watches_until_the_seat_is_free(browser, arena):
    first = Page(browser, arena, viewport={"width": 800, "height": 500})
    second = Page(browser, arena, viewport={"width": 800, "height": 500})
    arena.hears("sit")
    first.status("play")
    second.until("airpuck.status().phase === 'play'")
    assert first.tab.locator("#pause").is_enabled()
    assert not second.tab.locator("#pause").is_enabled()
    assert "you are watching" in second.tab.locator("#right-name").inner_text()
    second.tab.mouse.move(600, 200)
    second.tab.keyboard.press("r")
    second.tab.wait_for_timeout(200)
    assert arena.silent()
    first.tab.close()
    arena.hears("pause", "leave")  # closing a page hides it first
    second.status("waiting")
    assert second.tab.locator("#title").inner_text() == "The seat is free"
    second.tab.click("#go")
    arena.hears("sit")
    second.until("document.getElementById('pause').disabled === false")


@pytest.fixture
def graph() -> Iterator[Arena]:
    """The server of a game on a graph."""
    with closing(Arena(greeting(live_hello), page=GAME_PAGE)) as made:
        yield made


def test_a_live_game_cannot_be_paused_and_shows_what_is_seen(browser, graph):
    page = Page(browser, graph, viewport={"width": 1280, "height": 720})
    graph.hears("sit")
    page.status("starting")
    assert page.tab.locator("#title").inner_text() == "One moment"
    page.status("watch", (2, 1))
    assert not page.tab.locator("#card").is_visible()
    assert page.tab.locator(".score").inner_text().split() == ["airpuck", "2", ":", "1", "human"]
    assert page.tab.locator("nav button:visible").count() == 2  # the eye, and sound
    page.show()
    floor = page.color(0.4, -0.3)
    np.testing.assert_allclose(page.color(0.8, -0.1), VERMILLION, atol=12)
    # Neither craft nor mallet are seen now; nothing else changes.
    nowhere = (math.nan,) * 3
    page.show(mallet=nowhere[:2], craft=nowhere)
    np.testing.assert_allclose(page.color(0.8, -0.1), floor, atol=6)
    np.testing.assert_allclose(page.color(0.29, 0.2), (34, 34, 34), atol=12)
    # With the human at the table, no pointer moves the mallet.
    page.tab.mouse.move(*page.pixel(0.5, 0.25))
    page.tab.keyboard.press("t")
    assert graph.heard()[1]["do"] == "think"
    page.status("play", (2, 1))
    page.show()
    page.tab.mouse.move(*page.pixel(0.4, 0.2))
    _, (_, x, y, _) = graph.heard()
    assert (x, y) == pytest.approx((0.4, 0.2), abs=0.004)
    page.calls("goal", 1, "Goal!")
    page.calls("over", 1, "You win")
    page.calls("foul", -1, "Foul: puck on its side for 15 s")
    page.calls("stuck", 0, "Stuck puck: new serve")
    assert page.errors == []


@pytest.mark.parametrize("kinds", [("craft", "craft"), ("hand", "craft"), ("hand", "hand")])
def test_a_match_shows_who_plays_on_either_side(browser, kinds):
    hello = greeting(live_hello) | {"names": ["one.py:A", "other"], "sides": kinds}
    with closing(Arena(hello, page=GAME_PAGE)) as arena:
        page = Page(browser, arena, viewport={"width": 1280, "height": 720})
        page.status("watch", (1, 0))
        page.show(mallet=(0.8, -0.1), craft=(-0.8, 0.1, 0.0))
        white, blue = (255, 255, 255), (0, 114, 178)
        left, right = (white if kind == "craft" else None for kind in kinds)
        np.testing.assert_allclose(page.color(-0.8, 0.1), left or blue, atol=12)
        np.testing.assert_allclose(page.color(0.8, -0.1), right or VERMILLION, atol=12)
        page.calls("over", -1, "one.py:A wins")
        page.calls("over", 0, "A draw")
        page.calls("foul", 1, "Foul: puck on other's side for 15 s")
        assert page.errors == []


def test_a_page_reports_a_lost_connection(browser, arena):
    page = Page(browser, arena, viewport={"width": 800, "height": 500})
    page.status("play")
    arena.pipe.close()
    page.until("document.getElementById('title').textContent === 'Connection lost'")


def test_a_real_game_runs_at_sixty_frames_a_second(chromium):
    """Run the study for some seconds; pointer-to-pixel latency includes the server."""
    command = [sys.executable, "studies/play_page.py", "--duration", "8"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    figures = json.loads(done.stdout)
    assert figures["frames_per_s"] > 58
    assert figures["pointer_to_pixel_ms_p95"] < 50
    assert figures["behind_real_time_ms"]["p99"] < 1000 / 60
