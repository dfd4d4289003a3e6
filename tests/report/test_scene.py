"""Frames of an animation show only recorded data; arrows, propellers, names."""

from dataclasses import replace

import numpy as np
import pytest

from airpuck import AirHockey, Recording, Stream, Vehicle
from airpuck.report.animation import animate
from airpuck.report.scene import (
    arrow_shapes,
    frame_times,
    frames_at,
    read_scene,
    round_thrust,
    short_names,
    thinned,
    thrust_arrows,
    trail,
)
from airpuck.report.style import propeller_size

from ..apparatus.drawn_flights import CRAFT, EPOCH, flight, with_pose
from ..apparatus.models import VEHICLES, four_propellers


@pytest.mark.parametrize("name", VEHICLES)
def test_frames_interpolate_the_recording(name):
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


def test_set_points_are_held_and_unwrapped_near_the_yaw():
    frames = frames_at(read_scene(flight(), CRAFT), np.array([0.4, 0.6, 1.1, 1.3]))
    assert np.isnan(frames.reference[0]).all()
    np.testing.assert_allclose(frames.reference[1:3, :2], [[0.0, 0.1]] * 2)
    np.testing.assert_allclose(frames.reference[3, :2], [0.2, -0.1])
    assert np.all(np.abs(frames.reference[1:, 2] - frames.pose[1:, 2]) <= np.pi)
    np.testing.assert_allclose(np.cos(frames.reference[1:, 2]), np.cos([0, 0, -3.0]), atol=1e-12)


def test_commands_are_in_propeller_order():
    recording = flight()
    command = recording["command"]
    turned = Stream(
        command.stamp_ns, command.received_ns, command.values[:, ::-1], command.columns[::-1]
    )
    other = Recording({**recording.streams, "command": turned}, "x")
    np.testing.assert_array_equal(
        read_scene(recording, CRAFT).command, read_scene(other, CRAFT).command
    )


def test_nothing_is_interpolated_across_a_gap():
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


def test_non_finite_poses_are_a_gap():
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


def test_a_command_is_not_held_indefinitely():
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


def test_thinning_keeps_the_ends_of_every_segment():
    scene = read_scene(flight(left_out=(0.8, 1.0)), CRAFT)
    less = thinned(scene, 60.0)
    assert len(less.time) < 0.3 * len(scene.time)
    jump = int(np.flatnonzero(np.diff(scene.time) > 0.1)[0])
    assert {scene.time[k] for k in (0, jump, jump + 1, -1)} <= set(less.time)
    assert set(less.time) <= set(scene.time)
    assert thinned(scene, 1e4).time.tolist() == scene.time.tolist()


def test_the_table_is_drawn_only_if_the_flight_is_on_it():
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


def test_a_game_is_shown_on_its_table_wherever_the_set_points_are():
    recording = flight()
    asked = recording["reference"]
    far = replace(asked, values=asked.values + np.array([-3.0, 0, 0, 0, 0, 0]))
    streams = {**recording.streams, "reference": far}
    assert read_scene(replace(recording, streams=streams), CRAFT).table is None
    game = replace(recording, streams={**streams, "puck": recording["pose"]})
    assert read_scene(game, CRAFT).table == (2.2, 1.1)


def test_frames_are_evenly_spaced():
    times = frame_times(10.0, 12.0, 0.5, 25.0)
    assert len(times) == 101
    np.testing.assert_allclose([times[0], times[-1]], [10, 12])
    assert len(frame_times(0.0, 0.1, 100.0, 25.0)) == 1


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
        place = [0.3 + np.cos(yaw) * x - np.sin(yaw) * y, -0.2 + np.sin(yaw) * x + np.cos(yaw) * y]
        np.testing.assert_allclose(start, place, atol=1e-12)
        others = np.delete(thrust_arrows(vehicle, np.zeros((1, 3)), command)[0], i, axis=0)
        np.testing.assert_array_equal(others[:, 0], others[:, 1])


def test_arrow_lengths_are_proportional_to_thrust():
    command = np.tile([[0.2], [0.4], [1.0]], 6)
    arrows = thrust_arrows(CRAFT, np.zeros((3, 3)), command)
    length = np.hypot(*(arrows[:, 0, 1] - arrows[:, 0, 0]).T)
    a, b, c = CRAFT.nominal_thrust[0]
    force = [a * u + b * u**2 + c * u**3 for u in (0.2, 0.4, 1.0)]
    np.testing.assert_allclose(length / length[2], np.array(force) / force[2])
    assert 0.1 < length[2] < 0.5  # visible, and on the table


def test_an_outline_ends_at_the_tip_for_any_length():
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


def test_names_in_pictures_are_shortened():
    assert short_names(("motor_a_1", "motor_a_2", "motor_b_1")) == ["a 1", "a 2", "b 1"]
    assert short_names(("front", "left")) == ["front", "left"]
    assert short_names(("m_1",)) == ["m 1"]
    assert short_names(("m_a", "m")) == ["m a", "m"]


def test_the_legend_shows_a_round_thrust():
    assert round_thrust(CRAFT) == pytest.approx(0.2)  # 0.644 N at full command
    fields = CRAFT.model_dump()
    strong = Vehicle.model_validate(fields | {"nominal": fields["nominal"] | {"thrust_N": (11.0,)}})
    assert round_thrust(strong) == pytest.approx(5)


def test_a_game_on_a_table_of_another_size_is_drawn_to_scale(tmp_path):
    recording = flight()
    game = replace(recording, streams={**recording.streams, "puck": recording["pose"]})
    table = {"length_m": 2.4, "width_m": 1.2, "goal_width_m": 0.3}
    play = AirHockey.model_validate({"table": table, "puck": {"radius_m": 0.05}})
    scene = read_scene(game, CRAFT, play=play)
    assert scene.table == (2.4, 1.2)
    assert scene.game is not None
    assert scene.game.play == play
    text = animate(game, tmp_path / "a.html", table=play).read_text(encoding="utf-8")
    assert '"goal":0.3' in text.replace(" ", "")
