"""The page of `airpuck play` in headless Chromium: frames, round trip, physics in real time.

    python studies/play_page.py --duration 600
    python studies/play_page.py --screenshot docs/images/play.png  # the craft shoots

A pointer moves over the table all the time. The page measures the time from a pointer event to the
first frame with a server state that includes it; the page's own mallet moves earlier, because the
page predicts it. The command measures how far the physics is
behind real time. The browser draws without a graphics card, on the same cores.
"""

import argparse
import io
import json
import math
import shutil
import socket
import subprocess
import sys
import time

import numpy as np
from one_line import run
from PIL import Image
from playwright.sync_api import sync_playwright

FIGURES = "[airpuck.figures.frames, airpuck.figures.latencies]"


#: State for the screenshot: the craft is about to shoot at a moving puck, with a high chance.
SHOOTS = """(() => { const [now, before] = [airpuck.states.at(-1), airpuck.states.at(-9)];
    return thought?.path && /shot.*: [3-9]\\d/.test(thought.words) && before && !now.hidden
    && /in 0.[4-7]/.test(thought.said) && !document.getElementById("call").getAnimations().length
    && Math.hypot(now.puck[0] - before.puck[0], now.puck[1] - before.puck[1]) > 0.06; })()"""


def play(port: int, duration: float, screenshot: str | None) -> dict[str, float]:
    """Play in a browser; return the page's measurements."""
    with sync_playwright() as playwright:
        path = next(filter(None, map(shutil.which, ("chromium", "chromium-browser"))))
        browser = playwright.chromium.launch(executable_path=path, args=["--no-sandbox"])
        # A small page at a high resolution keeps its text legible in a narrow column.
        page = browser.new_page(viewport={"width": 640, "height": 430}, device_scale_factor=2)
        page.goto(f"http://127.0.0.1:{port}")
        page.click("#go", timeout=120_000)
        if screenshot:
            page.keyboard.press("t")
            page.evaluate("document.getElementById('figures').style.display = 'none'")
        page.evaluate("airpuck.figures.latencies.length = airpuck.figures.frames.length = 0")
        frames, latencies = [], []
        begin = time.monotonic()
        while (now := time.monotonic() - begin) < duration:
            x, y = math.sin(2.3 * now), math.sin(3.1 * now)
            page.mouse.move(480 + 120 * x, 220 + 120 * y)
            if len(frames) + 30 * 60 < 60 * now:  # the page keeps a minute
                taken = page.evaluate(f"{FIGURES}.map(one => one.splice(0))")
                frames, latencies = frames + taken[0], latencies + taken[1]
            if page.locator("#go").is_visible():
                page.click("#go")
            # A busy machine takes the screenshot late, so the page stops drawing at once.
            if screenshot and page.evaluate(f"{SHOOTS} && !!(requestAnimationFrame = () => 0)"):
                picture = Image.open(io.BytesIO(page.screenshot())).convert("RGB")
                picture.quantize(160, dither=Image.Dither.NONE).save(screenshot, optimize=True)
                break
        taken = page.evaluate(FIGURES)
        browser.close()
    frames, latencies = np.array(frames + taken[0]), np.array(latencies + taken[1])
    return {
        "frames_per_s": 1e3 * (len(frames) - 1) / (frames[-1] - frames[0]),
        "frame_ms_p99": float(np.percentile(np.diff(frames), 99)),
        "pointer_to_pixel_ms_p50": float(np.percentile(latencies, 50)),
        "pointer_to_pixel_ms_p95": float(np.percentile(latencies, 95)),
        "wishes": len(latencies),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--duration", type=float, default=600.0)
    parser.add_argument("--level", default="hard")
    parser.add_argument("--screenshot")
    arguments = parser.parse_args()
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    command = [sys.executable, "-m", "airpuck", "play", "--no-browser", "--json", "-"]
    command += ["--level", arguments.level, "--port", str(port), "--quiet"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as game:
        while True:
            time.sleep(0.2)
            with socket.socket() as probe:
                if probe.connect_ex(("127.0.0.1", port)) == 0:
                    break
        figures = play(port, arguments.duration, arguments.screenshot)
        game.terminate()
        figures |= json.loads(game.communicate()[0] or "{}")
    print(json.dumps(figures, indent=2))


if __name__ == "__main__":
    run(main)
