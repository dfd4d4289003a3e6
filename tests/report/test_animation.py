"""An animation shows what was recorded: poses, thrusts, set points, gaps; and nothing made up."""

import json
import os
import re
import subprocess
import sys

import numpy as np
import pytest
from PIL import Image

from airpuck.errors import InputError
from airpuck.recording.read import read_recording
from airpuck.recording.stream import COLUMNS, Recording, Stream
from airpuck.report.animation import animate
from airpuck.report.animation_frames import (
    frame_times,
    frames_at,
    read_scene,
    thinned,
    trail,
)
from airpuck.report.animation_shapes import (
    arrow_shapes,
    propeller_size,
    round_thrust,
    short_names,
    thrust_arrows,
)
from airpuck.vehicle import Vehicle, default_vehicle

from .conftest import VEHICLES, four_propellers

CRAFT = default_vehicle()
EPOCH = 1_700_000_000_000_000_000


def stream(time, values, columns) -> Stream:
    stamp = EPOCH + np.rint(1e9 * np.asarray(time)).astype(np.int64)
    return Stream(stamp, stamp, np.asarray(values, dtype=float), tuple(columns))


def flight(
    vehicle: Vehicle = CRAFT,
    *,
    duration: float = 2.0,
    left_out: tuple[float, float] = (0.0, 0.0),
    reference: bool = True,
) -> Recording:
    """A spiral at 240 Hz with a wrapped yaw, a command that changes at 100 Hz, two set points."""
    t = np.arange(0, duration, 1 / 240)
    t = t[(t <= left_out[0]) | (t >= left_out[1])]
    radius = 0.3 * t / duration
    yaw = (2.5 * t + 3 + np.pi) % (2 * np.pi) - np.pi
    pose = np.stack([radius * np.cos(3 * t), radius * np.sin(3 * t), yaw], axis=1)
    k = np.arange(0.1, duration, 0.01)
    n = vehicle.n_propellers
    command = 0.5 + 0.5 * np.sin(k[:, None] + np.arange(n))
    streams = {
        "pose": stream(t, pose, COLUMNS["pose"]),
        "command": stream(k, command, vehicle.propeller_names),
    }
    if reference:
        asked = [[0.0, 0.1, 0, 0, 0, 0], [0.2, -0.1, -3.0, 0, 0, 0]]
        streams["reference"] = stream([0.5, 1.2], asked, COLUMNS["reference"])
    return Recording(streams, "folder/flight_07")


def with_pose(recording: Recording, values) -> Recording:
    pose = recording["pose"]
    changed = Stream(pose.stamp_ns, pose.received_ns, np.array(values, float), pose.columns)
    return Recording({**recording.streams, "pose": changed}, recording.source)


# What is where ------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", VEHICLES)
def test_frames_are_the_recording_interpolated(name):
    vehicle = VEHICLES[name]()
    recording = flight(vehicle)
    scene = read_scene(recording, vehicle)
    at = np.array([0.0, 0.3333, 1.004, 1.904])
    frames = frames_at(scene, at)
    pose, command = recording["pose"], recording["command"]
    t = (pose.stamp_ns - EPOCH) * 1e-9
    for i in range(2):
        np.testing.assert_allclose(
            frames.pose[:, i], np.interp(at, t, pose.values[:, i]), atol=1e-6
        )
    np.testing.assert_allclose(frames.pose[:, 2], 2.5 * at + 3, atol=1e-5)  # not wrapped
    assert frames.known.all()
    k = (command.stamp_ns - EPOCH) * 1e-9
    assert np.isnan(frames.command[0]).all()  # nothing had been commanded yet
    for row, moment in zip(frames.command[1:], at[1:], strict=True):
        np.testing.assert_array_equal(row, command.values[np.flatnonzero(k <= moment)[-1]])


def test_set_points_hold_and_are_near_the_yaw():
    frames = frames_at(read_scene(flight(), CRAFT), np.array([0.4, 0.6, 1.1, 1.3]))
    assert np.isnan(frames.reference[0]).all()
    np.testing.assert_allclose(frames.reference[1:3, :2], [[0.0, 0.1]] * 2)
    np.testing.assert_allclose(frames.reference[3, :2], [0.2, -0.1])
    assert np.all(np.abs(frames.reference[1:, 2] - frames.pose[1:, 2]) <= np.pi)
    np.testing.assert_allclose(np.cos(frames.reference[1:, 2]), np.cos([0, 0, -3.0]), atol=1e-12)


def test_commands_are_in_the_order_of_the_propellers():
    recording = flight()
    command = recording["command"]
    turned = Stream(
        command.stamp_ns, command.received_ns, command.values[:, ::-1], command.columns[::-1]
    )
    other = Recording({**recording.streams, "command": turned}, "x")
    np.testing.assert_array_equal(
        read_scene(recording, CRAFT).command, read_scene(other, CRAFT).command
    )


@pytest.mark.parametrize("yaw", [0.0, 0.7, -2.5, 9.0])
@pytest.mark.parametrize("name", VEHICLES)
def test_an_arrow_points_where_its_propeller_pushes(name, yaw):
    vehicle = VEHICLES[name]()
    for i, propeller in enumerate(vehicle.propellers):
        command = np.zeros((1, vehicle.n_propellers))
        command[0, i] = 0.8
        start, tip = thrust_arrows(vehicle, np.array([[0.3, -0.2, yaw]]), command)[0, i]
        angle = np.deg2rad(propeller.direction_deg) + yaw
        along = tip - start
        np.testing.assert_allclose(
            along / np.hypot(*along), [np.cos(angle), np.sin(angle)], atol=1e-12
        )
        x, y = propeller.position_m
        place = [
            0.3 + np.cos(yaw) * x - np.sin(yaw) * y,
            -0.2 + np.sin(yaw) * x + np.cos(yaw) * y,
        ]
        np.testing.assert_allclose(start, place, atol=1e-12)
        others = np.delete(thrust_arrows(vehicle, np.zeros((1, 3)), command)[0], i, axis=0)
        np.testing.assert_array_equal(others[:, 0], others[:, 1])


def test_arrows_are_as_long_as_thrust_is_large():
    command = np.tile([[0.2], [0.4], [1.0]], 6)
    arrows = thrust_arrows(CRAFT, np.zeros((3, 3)), command)
    length = np.hypot(*(arrows[:, 0, 1] - arrows[:, 0, 0]).T)
    a, b, c = CRAFT.nominal_thrust[0]
    force = [a * u + b * u**2 + c * u**3 for u in (0.2, 0.4, 1.0)]
    np.testing.assert_allclose(length / length[2], np.array(force) / force[2])
    assert 0.1 < length[2] < 0.5  # visible, and on the table


def test_an_outline_ends_at_the_tip_whatever_the_length():
    arrows = np.array([[[0.0, 0.0], [0.3, 0.4]], [[1.0, 1.0], [1.0, 1.001]], [[2.0, 2.0]] * 2])
    shapes = arrow_shapes(arrows, 0.07)
    np.testing.assert_allclose(shapes[:, 3], arrows[:, 1], atol=1e-12)
    np.testing.assert_allclose((shapes[:, 0] + shapes[:, 6]) / 2, arrows[:, 0], atol=1e-12)
    assert np.isfinite(shapes).all()


def test_propellers_do_not_overlap_and_a_single_one_is_drawn():
    for vehicle in (CRAFT, four_propellers()):
        x, y = vehicle.positions.T
        apart = np.hypot(x[:, None] - x, y[:, None] - y)[np.triu_indices(len(x), 1)]
        assert 0 < 2 * propeller_size(vehicle) < apart.min()
    one = CRAFT.model_copy(update={"propellers": CRAFT.propellers[:1], "pairs": ()})
    assert 0 < propeller_size(one) < one.radius_m


def test_names_in_pictures_are_short():
    assert short_names(("motor_a_1", "motor_a_2", "motor_b_1")) == ["a 1", "a 2", "b 1"]
    assert short_names(("front", "left")) == ["front", "left"]
    assert short_names(("m_1",)) == ["m 1"]
    assert short_names(("m_a", "m")) == ["m a", "m"]


def test_the_thrust_of_the_key_is_round():
    assert round_thrust(CRAFT) == pytest.approx(0.2)  # 0.644 N at full command
    fields = CRAFT.model_dump()
    strong = Vehicle.model_validate(
        fields | {"nominal": fields["nominal"] | {"thrust_N": (110.0,)}}
    )
    assert round_thrust(strong) == pytest.approx(50)


# Gaps ---------------------------------------------------------------------------------------------


def test_nothing_is_made_up_in_a_gap():
    recording = flight(left_out=(0.8, 1.0))
    scene = read_scene(recording, CRAFT)
    t = (recording["pose"].stamp_ns - EPOCH) * 1e-9
    before = recording["pose"].values[t <= 0.8 + 1e-9][-1, :2]
    frames = frames_at(scene, np.array([0.79, 0.85, 0.99, 1.01]))
    assert frames.known.tolist() == [True, False, False, True]
    np.testing.assert_array_equal(frames.pose[1:3, :2], [before] * 2)  # where it was last seen
    for until in (0.9, 1.0, 1.3, 1.9):
        lines, age = trail(scene, until, 0.7)
        # The craft is never faster than 1 m/s: a line across the gap would be longer.
        assert np.hypot(*(lines[:, 1] - lines[:, 0]).T).max() < 0.01
        assert np.all((age >= 0) & (age <= 1))


def test_poses_that_are_not_finite_are_a_gap():
    values = flight()["pose"].values.copy()
    values[100:150, 1] = np.nan
    values[300, 2] = np.inf
    scene = read_scene(with_pose(flight(), values), CRAFT)
    assert np.isfinite(scene.pose).all()
    frames = frames_at(scene, np.array([125, 300]) / 240)
    assert frames.known.tolist() == [False, True]  # one missing sample is bridged


def test_a_frozen_pose_is_a_gap():
    values = flight()["pose"].values.copy()
    values[100:150] = values[100]
    frames = frames_at(read_scene(with_pose(flight(), values), CRAFT), np.array([99, 125]) / 240)
    assert frames.known.tolist() == [True, False]


def test_a_command_does_not_hold_for_ever():
    recording = flight()
    command = recording["command"]
    cut = Stream(
        command.stamp_ns[:50], command.received_ns[:50], command.values[:50], command.columns
    )
    scene = read_scene(Recording({**recording.streams, "command": cut}, "x"), CRAFT)
    last = 0.1 + 49 * 0.01
    frames = frames_at(scene, np.array([last + 0.05, last + 0.2]))
    assert np.isfinite(frames.command[0]).all()
    assert np.isnan(frames.command[1]).all()


def test_the_trail_follows_the_craft():
    recording = flight()
    lines, age = trail(read_scene(recording, CRAFT), 1.5003, 0.5)
    t = (recording["pose"].stamp_ns - EPOCH) * 1e-9
    for end, moment in ((lines[0, 0], 1.0003), (lines[-1, 1], 1.5003)):
        expected = [np.interp(moment, t, recording["pose"].values[:, i]) for i in range(2)]
        np.testing.assert_allclose(end, expected, atol=1e-6)
    np.testing.assert_array_equal(lines[1:, 0], lines[:-1, 1])
    assert np.all(np.diff(age) < 0)


def test_thinning_keeps_the_ends_of_every_stretch():
    scene = read_scene(flight(left_out=(0.8, 1.0)), CRAFT)
    less = thinned(scene, 60.0)
    assert len(less.time) < 0.3 * len(scene.time)
    jump = int(np.flatnonzero(np.diff(scene.time) > 0.1)[0])
    assert {scene.time[k] for k in (0, jump, jump + 1, -1)} <= set(less.time)
    assert set(less.time) <= set(scene.time)
    assert thinned(scene, 1e4).time.tolist() == scene.time.tolist()


def test_the_table_is_drawn_only_around_a_flight_on_it():
    on = read_scene(flight(), CRAFT)
    assert on.table == (2.2, 1.1)
    assert on.view == (-1.1, 1.1, -0.55, 0.55)
    away = flight()["pose"].values + np.array([3.0, 1.0, 0.0])
    off = read_scene(with_pose(flight(), away), CRAFT)
    assert off.table is None
    x0, x1, y0, y1 = off.view
    radius = CRAFT.radius_m
    assert x0 < off.pose[:, 0].min() - radius
    assert x1 > off.pose[:, 0].max() + radius
    assert y0 < min(off.pose[:, 1].min(), -0.1) - radius  # the set points are in view too
    assert y1 > off.pose[:, 1].max() + radius


def test_frames_are_evenly_spaced():
    times = frame_times(10.0, 12.0, 0.5, 25.0)
    assert len(times) == 101
    np.testing.assert_allclose([times[0], times[-1]], [10, 12])
    assert len(frame_times(0.0, 0.1, 100.0, 25.0)) == 1


# The files ----------------------------------------------------------------------------------------


def milliseconds(image: Image.Image) -> list[int]:
    durations = []
    for k in range(image.n_frames):
        image.seek(k)
        durations.append(image.info["duration"])
    return durations


@pytest.mark.parametrize(("speed", "rate"), [(1.0, 25.0), (2.0, 12.0), (0.5, 30.0)])
def test_a_gif_has_its_frames_and_takes_its_time(tmp_path, speed, rate):
    recording = flight(duration=1.0)
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


def test_the_craft_is_drawn_where_it_was(tmp_path):
    """A craft with one unmistakable propeller in its middle: find its colour in the picture."""
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
        found.append([columns.mean(), rows.mean()])
    (x0, y0), (x1, y1), (x2, y2) = found
    assert x1 - x0 == pytest.approx(x2 - x1, abs=1.5)
    assert y1 - y0 == pytest.approx(y2 - y1, abs=1.5)
    # 1.6 m to the right and 0.6 m down, at one scale.
    assert (x2 - x0) / (y2 - y0) == pytest.approx(1.6 / 0.6, rel=0.02)
    assert (x2 - x0) / (0.96 * 1.6) == pytest.approx(pixels.shape[1] * 0.83 / 2.2, rel=0.15)


def test_frames_of_a_gif_do_not_leave_traces(tmp_path):
    """Each frame holds only changes; put together they are what was drawn."""
    recording = flight(duration=1.0)
    whole = animate(recording, tmp_path / "a.gif")
    # The last frame of the flight, drawn alone: it has no earlier ones to be mixed up with.
    pose = recording["pose"]
    t = (pose.stamp_ns - EPOCH) * 1e-9
    start = float(24 / 25 / t[-1])
    late = animate(recording, tmp_path / "b.gif", span=(start, 1.0))
    one, other = table_pixels(whole, 24), table_pixels(late, 0)
    assert one.shape == other.shape
    # Below the table the panels show different spans, and the view's trail begins later.
    background = (one[:80] != other[:80]).any(axis=2)
    assert background.mean() < 0.02
    first = table_pixels(whole, 0)
    cleared = np.abs(first - one).sum(axis=2) > 200
    assert 0.0005 < cleared.mean() < 0.05  # the craft is gone from where it was


def page_data(path) -> dict:
    text = path.read_text(encoding="utf-8")
    match = re.search(r'<script type="application/json" id="flight">(.*?)</script>', text, re.S)
    assert match
    return json.loads(match[1])


@pytest.mark.parametrize("name", VEHICLES)
def test_a_page_holds_the_flight(tmp_path, name):
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


def test_a_page_needs_nothing_from_outside_and_runs_nothing_foreign(tmp_path):
    hostile = CRAFT.model_copy(
        update={"name": "</script><script src=//evil>alert(1)</script>"},
    )
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
    names = tuple(f"</script>{i}" for i in range(6))
    propellers = tuple(
        p.model_copy(update={"name": n}) for p, n in zip(CRAFT.propellers, names, strict=True)
    )
    craft = CRAFT.model_copy(update={"propellers": propellers, "pairs": ()})
    page = animate(flight(craft), tmp_path / "b.html", vehicle=craft)
    assert page_data(page)["craft"]["names"] == list(names)


def test_pages_are_small(tmp_path):
    path = animate(flight(duration=60.0), tmp_path / "a.html")
    assert path.stat().st_size < 400_000


def test_a_recording_without_set_points_has_none_in_its_page(tmp_path):
    path = animate(flight(reference=False), tmp_path / "a.html", speed=0.3)
    assert page_data(path)["reference"]["time"] == []
    text = path.read_text(encoding="utf-8")
    assert "set point</li>" not in text
    assert re.search(r'<option value="0.3" selected', text)


def test_the_same_flight_gives_the_same_bytes(tmp_path):
    for suffix in (".gif", ".html"):
        files = [
            animate(flight(duration=0.4), tmp_path / f"{k}{suffix}").read_bytes() for k in "ab"
        ]
        assert files[0] == files[1]


def test_pages_need_no_drawing_library_state():
    code = (
        "import sys, airpuck.report.animation, airpuck.report.animation_gif, "
        "airpuck.report.animation_page; print('matplotlib.pyplot' in sys.modules)"
    )
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert ran.stdout.strip() == "False"


# What cannot be shown -----------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["a.mp4", "a", "a.png", ".gif"])
def test_unknown_suffixes_are_refused(tmp_path, name):
    with pytest.raises(InputError, match=r"neither \.gif nor \.html"):
        animate(flight(), tmp_path / name)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("suffix", [".gif", ".html"])
@pytest.mark.parametrize(
    "span", [(0.5, 0.5), (0.6, 0.4), (-0.1, 1.0), (0.0, 1.1), (np.nan, 1.0), (0.5, 0.5001)]
)
def test_empty_spans_are_refused(tmp_path, suffix, span):
    with pytest.raises(InputError, match="span"):
        animate(flight(), tmp_path / f"a{suffix}", span=span)


@pytest.mark.parametrize(
    "settings",
    [
        {"speed": 0.0},
        {"speed": -1.0},
        {"speed": np.nan},
        {"frames_per_second": 0.0},
        {"frames_per_second": np.inf},
        {"frames_per_second": 60.0},
        {"table": (0.0, 1.0)},
        {"speed": 1e-6},
    ],
)
def test_numbers_out_of_range_are_refused(tmp_path, settings):
    with pytest.raises(InputError):
        animate(flight(), tmp_path / "a.gif", **settings)


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
def test_what_cannot_be_used_is_refused_and_the_old_file_kept(tmp_path, problem, suffix):
    path = tmp_path / f"a{suffix}"
    path.write_text("old")
    with pytest.raises(InputError, match=problem):
        animate(broken()[problem], path)
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_an_interrupted_animation_leaves_the_old_file(tmp_path, monkeypatch):
    def interrupt(*_args, **_settings):
        raise KeyboardInterrupt

    monkeypatch.setattr("airpuck.report.animation_gif.frames_at", interrupt)
    path = tmp_path / "a.gif"
    path.write_text("old")
    with pytest.raises(KeyboardInterrupt):
        animate(flight(), path)
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_a_folder_that_cannot_be_written_is_said(tmp_path):
    tmp_path.chmod(0o500)
    with pytest.raises(InputError, match="cannot be written"):
        animate(flight(), tmp_path / "a.html")


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


def test_a_set_point_far_away_is_no_trouble(tmp_path):
    recording = flight(duration=0.3)
    far = stream([0.0], [[1e7, -2e6, 1.0, 0, 0, 0]], COLUMNS["reference"])
    odd = Recording({**recording.streams, "reference": far}, "x")
    for suffix in (".gif", ".html"):
        assert animate(odd, tmp_path / f"a{suffix}").stat().st_size < 300_000


@pytest.mark.data
@pytest.mark.parametrize("flown", ["control_experiment/data_M4", "control_experiment/data_M0"])
def test_real_flights(data, tmp_path, flown):
    recording = read_recording(data / flown)
    path = animate(recording, tmp_path / "a.gif", span=(0.2, 0.5))
    assert path.stat().st_size < 1_500_000
    page = page_data(animate(recording, tmp_path / "a.html"))
    assert len(page["reference"]["time"]) == 4
    assert page["table"] == [2.2, 1.1]
