"""The walks of docs/architecture.md: the calls happen, and in the stated order."""

import re
import sys
from pathlib import Path

import pytest

import airpuck

PAGE = Path(__file__).parents[1] / "docs" / "architecture.md"
WALKS = dict(
    re.findall(r"^\* \*([^*]+)\*: ((?:`[\w.]+`(?: →\s+)?)+)", PAGE.read_text("utf-8"), re.MULTILINE)
)


def stated(title):
    """The functions of a walk, in the order of the page."""
    return re.findall(r"`([\w.]+)`", WALKS[title])


def called(names, walk):
    """Run a function, and return which of the named functions it calls, in order of first calls."""
    seen = []

    def note(frame, event, _):
        if event == "call":
            module = frame.f_globals.get("__name__", "").removeprefix("airpuck.")
            name = f"{module}.{frame.f_code.co_qualname}"
            if name in names and name not in seen:
                seen.append(name)

    sys.setprofile(note)
    try:
        walk()
    finally:
        sys.setprofile(None)
    return seen


@pytest.mark.slow
def test_a_recording_becomes_a_verdict_by_the_stated_calls(tmp_path):
    model = airpuck.read_model("paper:M3")
    for seed in (1, 2):
        airpuck.write_bag(airpuck.excite(model, 8.0, seed=seed), tmp_path / f"bag{seed}")
    walk = stated("From a bag to a verdict")
    bag, other = tmp_path / "bag1", tmp_path / "bag2"
    assert called(walk, lambda: airpuck.study(bag, model="M3", validation=other)) == walk


@pytest.mark.slow
def test_a_model_file_becomes_a_command_by_the_stated_calls():
    def fly():
        model = airpuck.read_model("paper:M3")
        target = airpuck.SetPoint(0.2, 0.0, 0.0)
        controller = airpuck.TrackingController(model, target, compiled=False)
        controller.pose(0.0, (0.0, 0.0, 0.0))
        controller.step(0.0)

    walk = stated("From a model file to a motor command")
    assert called(walk, fly) == walk
