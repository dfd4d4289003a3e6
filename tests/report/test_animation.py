"""Animation files: their contents, their size, and rejected input."""

import json
import math
import re
import shutil
import subprocess
from xml.etree.ElementTree import fromstring

import numpy as np
import pytest
from PIL import Image

from airpuck import InputError, Recording, Vehicle
from airpuck.recording.read import read_recording
from airpuck.recording.stream import COLUMNS
from airpuck.report.animation import Mover, animate, moving_drawing
from airpuck.report.scene import TABLE

from ..apparatus.changes import with_propellers
from ..apparatus.drawn_flights import CRAFT, EPOCH, flight, stream, with_pose
from ..apparatus.models import VEHICLES, four_propellers


def milliseconds(image: Image.Image) -> list[int]:
    durations = []
    for k in range(image.n_frames):
        image.seek(k)
        durations.append(image.info["duration"])
    return durations


@pytest.mark.slow
@pytest.mark.parametrize(("speed", "rate"), [(2.0, 12.0), (0.5, 30.0)])
def test_a_gif_has_the_expected_frames_and_duration(tmp_path, speed, rate):
    recording = flight(duration=0.5)
    path = animate(recording, tmp_path / "a.gif", speed=speed, frames_per_second=rate)
    with Image.open(path) as image:
        assert image.format == "GIF"
        pose = recording["pose"]
        shown = (pose.stamp_ns[-1] - pose.stamp_ns[0]) * 1e-9
        assert image.n_frames == int(shown * rate / speed) + 1
        assert image.info["loop"] == 0
        durations = milliseconds(image)
        assert sum(durations) == pytest.approx(1e3 * len(durations) / rate, abs=5)
        assert max(durations) - min(durations) <= 10


def table_pixels(path, k) -> np.ndarray:
    with Image.open(path) as image:
        image.seek(k)
        return np.asarray(image.convert("RGB")).astype(int)


@pytest.mark.slow
def test_the_craft_is_drawn_at_its_recorded_place(tmp_path):
    """A craft with a distinctive propeller in its centre: find its colour in the picture."""
    vehicle = Vehicle.model_validate(
        {
            "name": "one",
            "mass_kg": 0.1,
            "radius_m": 0.07,
            "propellers": [{"name": "m", "position_m": (0.0, 0.0), "direction_deg": 0}],
            "nominal": {"thrust_N": (1.0,), "inertia_kg_m2": 1e-4},
        }
    )
    t = np.arange(0, 1, 1 / 240)
    pose = np.stack([-0.8 + 1.6 * t, 0.3 - 0.6 * t, 0 * t], axis=1)
    streams = {
        "pose": stream(t, pose, COLUMNS["pose"]),
        "command": stream(t, np.zeros((len(t), 1)), ["m"]),
    }
    path = animate(Recording(streams, "x"), tmp_path / "a.gif", vehicle=vehicle)
    found = []
    for k in (0, 12, 24):
        pixels = table_pixels(path, k)
        upper = pixels[: int(0.68 * len(pixels))]  # the table; the panels are below
        blue = np.abs(upper - [0, 114, 178]).sum(axis=2) < 60
        rows, columns = np.nonzero(blue)
        assert len(rows) > 20
        assert (pixels[0] == 255).all()  # white stays white
        found.append([columns.mean(), rows.mean()])
    (x0, y0), (x1, y1), (x2, y2) = found
    assert x1 - x0 == pytest.approx(x2 - x1, abs=1.5)
    assert y1 - y0 == pytest.approx(y2 - y1, abs=1.5)
    # 1.6 m to the right and 0.6 m down, at one scale.
    assert (x2 - x0) / (y2 - y0) == pytest.approx(1.6 / 0.6, rel=0.02)
    assert (x2 - x0) / (0.96 * 1.6) == pytest.approx(pixels.shape[1] * 0.83 / 2.2, rel=0.15)


def page_data(path) -> dict:
    text = path.read_text(encoding="utf-8")
    match = re.search(r'<script type="application/json" id="flight">(.*?)</script>', text, re.S)
    assert match
    return json.loads(match[1])


@pytest.mark.parametrize("name", VEHICLES)
def test_a_page_contains_the_flight(tmp_path, name):
    vehicle = VEHICLES[name]()
    recording = flight(vehicle, left_out=(0.8, 1.0))
    data = page_data(animate(recording, tmp_path / "a.html", vehicle=vehicle))
    pose, command = recording["pose"], recording["command"]
    times = 1e-4 * np.cumsum(data["pose"]["time"])
    t = (pose.stamp_ns - EPOCH) * 1e-9
    assert len(times) >= len(t) // 2
    for i, column in enumerate(("x", "y")):
        values = 1e-4 * np.cumsum(data["pose"][column])
        np.testing.assert_allclose(values, np.interp(times, t, pose.values[:, i]), atol=2e-4)
    np.testing.assert_allclose(1e-4 * np.cumsum(data["pose"]["yaw"]), 2.5 * times + 3, atol=4e-4)
    k = (command.stamp_ns - EPOCH) * 1e-9
    np.testing.assert_allclose(1e-4 * np.cumsum(data["command"]["time"]), k, atol=1e-4)
    motors = 1e-3 * np.cumsum(data["command"]["motors"], axis=1)
    np.testing.assert_allclose(motors.T, command.values, atol=6e-4)
    np.testing.assert_allclose(1e-4 * np.cumsum(data["reference"]["time"]), [0.5, 1.2], atol=1e-4)
    assert len(data["craft"]["positions"]) == vehicle.n_propellers


def test_a_page_loads_nothing_external_and_escapes_names(tmp_path):
    hostile = CRAFT.model_copy(update={"name": "</script><script src=//evil>alert(1)</script>"})
    recording = flight()
    source = "folder/<img src=x onerror=alert(2)>"
    path = animate(Recording(recording.streams, source), tmp_path / "a.html", vehicle=hostile)
    text = path.read_text(encoding="utf-8")
    assert "http" not in text
    assert not re.search(r"<[^>]+\s(src|href)\s*=", text)
    assert "@import" not in text
    assert "url(" not in text.replace("url(#fade)", "")
    assert text.count("<script") == 2
    assert "<img" not in text
    craft = with_propellers(CRAFT, lambda k, _: {"name": f"</script>{k}"})
    craft = craft.model_copy(update={"pairs": ()})
    page = animate(flight(craft), tmp_path / "b.html", vehicle=craft)
    assert page_data(page)["craft"]["names"] == list(craft.propeller_names)


@pytest.mark.skipif(shutil.which("node") is None, reason="needs Node.js")
def test_the_script_of_a_page_is_valid_javascript(tmp_path):
    text = animate(flight(), tmp_path / "a.html").read_text(encoding="utf-8")
    script = tmp_path / "a.js"
    script.write_text(text.rpartition("<script>")[2].partition("</script>")[0], encoding="utf-8")
    subprocess.run(["node", "--check", str(script)], check=True)


def test_pages_are_small(tmp_path):
    path = animate(flight(duration=60.0), tmp_path / "a.html")
    assert path.stat().st_size < 400_000


def test_a_recording_without_set_points_gives_a_page_without_them(tmp_path):
    path = animate(flight(reference=False), tmp_path / "a.html", speed=0.3)
    assert page_data(path)["reference"]["time"] == []
    text = path.read_text(encoding="utf-8")
    assert "set point</li>" not in text
    assert re.search(r'<option value="0.3" selected', text)


@pytest.mark.slow
def test_the_same_flight_gives_the_same_bytes(tmp_path):
    for suffix in (".gif", ".html"):
        files = [
            animate(flight(duration=0.2), tmp_path / f"{k}{suffix}").read_bytes() for k in "ab"
        ]
        assert files[0] == files[1]


EMPTY = [(0.5, 0.5), (0.6, 0.4), (-0.1, 1.0), (0.0, 1.1), (np.nan, 1.0), (0.5, 0.5001)]


@pytest.mark.parametrize(
    ("name", "settings", "says"),
    [
        *((name, {}, r"neither \.gif nor \.html") for name in ("a.mp4", "a", "a.png", ".gif")),
        *((name, {"span": span}, "span") for span in EMPTY for name in ("a.gif", "a.html")),
        *(("a.gif", {"speed": speed}, None) for speed in (0.0, -1.0, np.nan, 1e-6)),
        *(("a.gif", {"frames_per_second": rate}, None) for rate in (0.0, np.inf, 60.0)),
        ("a.gif", {"table": (0.0, 1.0)}, None),
    ],
)
def test_invalid_animation_settings_are_rejected(tmp_path, name, settings, says):
    with pytest.raises(InputError, match=says):
        animate(flight(), tmp_path / name, **settings)
    assert not list(tmp_path.iterdir())


def broken() -> dict[str, Recording]:
    good = flight()
    empty = stream([], np.zeros((0, 3)), COLUMNS["pose"])
    values = good["pose"].values
    return {
        "has no pose": Recording({"command": good["command"]}, "x"),
        "has no command": Recording({"pose": good["pose"]}, "x"),
        "pose stream is empty": Recording({**good.streams, "pose": empty}, "x"),
        "fewer than two finite poses": with_pose(good, np.full_like(values, np.nan)),
        "millimetres": with_pose(good, values * [1000, 1000, 1]),
        "outside": Recording(
            {
                **good.streams,
                "command": stream([0, 1], np.full((2, 6), 9.0), CRAFT.propeller_names),
            },
            "x",
        ),
        "vehicle": flight(four_propellers()),
    }


@pytest.mark.parametrize("problem", broken())
@pytest.mark.parametrize("suffix", [".gif", ".html"])
def test_unusable_recordings_are_rejected_and_old_files_kept(tmp_path, problem, suffix):
    path = tmp_path / f"a{suffix}"
    path.write_text("old")
    with pytest.raises(InputError, match=problem):
        animate(broken()[problem], path)
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["one", "twelve", "silent"])
def test_any_vehicle_can_be_drawn(tmp_path, name):
    fields = CRAFT.model_dump()
    nominal = CRAFT.nominal.model_dump()
    if name == "one":
        fields |= {"propellers": fields["propellers"][:1], "pairs": ()}
    elif name == "twelve":
        more = [
            {**p, "name": p["name"] + "_b", "position_m": tuple(2 * x for x in p["position_m"])}
            for p in fields["propellers"]
        ]
        fields |= {"propellers": (*fields["propellers"], *more)}
    else:
        fields |= {"nominal": {**nominal, "thrust_N": (0.0,)}}
    vehicle = Vehicle.model_validate(fields)
    for suffix in (".gif", ".html"):
        path = animate(flight(vehicle, duration=0.3), tmp_path / f"a{suffix}", vehicle=vehicle)
        assert path.stat().st_size > 5_000


@pytest.mark.slow
def test_a_distant_set_point_can_be_drawn(tmp_path):
    recording = flight(duration=0.3)
    far = stream([0.0], [[1e7, -2e6, 1.0, 0, 0, 0]], COLUMNS["reference"])
    odd = Recording({**recording.streams, "reference": far}, "x")
    for suffix in (".gif", ".html"):
        assert animate(odd, tmp_path / f"a{suffix}").stat().st_size < 300_000


@pytest.mark.slow
@pytest.mark.data
def test_a_real_flight_can_be_animated(data, tmp_path):
    recording = read_recording(data / "control_experiment" / "data_M4")
    path = animate(recording, tmp_path / "a.gif", span=(0.2, 0.3))
    assert path.stat().st_size < 500_000
    page = page_data(animate(recording, tmp_path / "a.html"))
    assert len(page["reference"]["time"]) == 4
    assert page["table"] == [2.2, 1.1]


def test_an_animation_starts_and_ends_with_the_flight():
    time = np.linspace(0.0, 2.0, 201)
    pose = np.column_stack([0.3 * time, 0.2 * time - 0.1, 0.5 * time])
    drawn = moving_drawing(TABLE.table, [Mover("a <craft>", "#0072b2", 0.07, time, pose)])
    root, svg = fromstring(drawn), "{http://www.w3.org/2000/svg}"
    assert [name.text for name in root.iter(f"{svg}text")] == ["a <craft>"] * 2
    moves, turns = (one.get("values").split(";") for one in root.iter(f"{svg}animateTransform"))
    # y points down, and angles are clockwise.
    assert (moves[0], moves[20], moves[-1]) == ("0.000 0.100", "0.300 -0.100", "0.600 -0.300")
    assert float(turns[-1]) == round(-math.degrees(1.0))
    assert len(moves) == len(turns) == 20 * 2 + 30  # then it rests for 1.5 s
