"""The walks of docs/architecture.md: the calls happen, and in the stated order."""

import re
import sys
from pathlib import Path

import pytest

import airpuck
import airpuck_hockey

PAGE = Path(__file__).parents[1] / "docs" / "architecture.md"
WALKS = dict(
    re.findall(
        r"^\* \*([^*]+)\*[^:]*: ((?:`[\w.]+`(?: →\s+)?)+)", PAGE.read_text("utf-8"), re.MULTILINE
    )
)


def stated(title):
    """The functions of a walk, in the order of the page."""
    return re.findall(r"`([\w.]+)`", WALKS[title])


def called(names, walk):
    """Run a function, and return which of the named functions it calls, in order of first calls."""
    seen = []

    def note(frame, event, _):
        if event == "call":
            module = re.sub(r"^airpuck(_hockey)?\.", "", frame.f_globals.get("__name__", ""))
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
def test_the_stated_calls_turn_a_recording_into_a_verdict(tmp_path):
    model = airpuck.read_model("paper:M3")
    for seed in (1, 2):
        airpuck.write_bag(airpuck.excite(model, 8.0, seed=seed), tmp_path / f"bag{seed}")
    walk = stated("From a bag to a verdict")
    bag, other = tmp_path / "bag1", tmp_path / "bag2"
    assert called(walk, lambda: airpuck.study(bag, model="M3", validation=other)) == walk


@pytest.mark.slow
def test_the_stated_calls_turn_a_model_file_into_a_command():
    def fly():
        model = airpuck.read_model("paper:M3")
        target = airpuck.SetPoint(0.2, 0.0, 0.0)
        controller = airpuck.TrackingController(model, target, compiled=False)
        controller.pose(0.0, (0.0, 0.0, 0.0))
        controller.step(0.0)

    walk = stated("From a model file to a motor command")
    assert called(walk, fly) == walk


@pytest.mark.slow
def test_the_stated_calls_turn_the_first_puck_pose_into_a_command():
    players = map(airpuck_hockey.contestant, ("airpuck", "human"))
    game = airpuck_hockey.Game(*players, seed=1)
    walk = stated("From the first pose of the puck to a motor command")
    periods = (called(walk, game.step) for _ in range(10))
    assert next(seen for seen in periods if "puck.puck_filter.PuckFilter.pose" in seen) == walk


@pytest.mark.slow
def test_the_stated_calls_turn_the_authors_data_into_the_papers_table(data, tmp_path):
    def stop(line):
        if line.startswith("identified"):
            raise InterruptedError  # one fit makes all of the calls

    def study():
        with pytest.raises(InterruptedError):
            airpuck.reproduce(data, tmp_path, progress=stop)

    walk = stated("From the authors' prepared data to the paper's Table 2")
    assert called(walk, study) == walk
