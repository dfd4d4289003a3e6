"""Shortest times from the table equal the times of plans."""

import sys
from dataclasses import replace

import numpy as np
import pytest

import airpuck
from airpuck.boundary.errors import InputError
from airpuck.planning.minimal_time import (
    MinimalTimes,
    craft_of,
    minimal_times_of,
    read_minimal_times,
    shortest_time,
)

from ..apparatus.models import scaled


def table():
    distance, speed, direction = (0.0, 0.25, 1.0), (0.0, 1.0), (0.0, np.pi / 2, np.pi)
    grid = np.meshgrid(np.sqrt(distance), speed, direction, indexing="ij")
    rest = 1.0 + grid[0] * 2 + grid[1] * 0.5 - np.cos(grid[2]) * 0.25
    times = np.stack([rest, rest / 2])
    return MinimalTimes(
        "test", "none", *map(np.array, (distance, speed, direction)), times, {"worst": 0.0}
    )


def test_linear_functions_are_interpolated_exactly():
    found, random = table(), np.random.default_rng(0)
    away, velocity = random.uniform(-0.7, 0.7, (2, 50)), random.uniform(-0.7, 0.7, (2, 50))
    distance, speed = np.hypot(*away), np.hypot(*velocity)
    cosine = (away * velocity).sum(axis=0) / distance / speed
    expected = 1.0 + 2 * np.sqrt(distance) + 0.5 * speed - 0.25 * cosine
    np.testing.assert_allclose(found(away, velocity), expected, rtol=1e-12)
    np.testing.assert_allclose(found(away, velocity, "any"), expected / 2, rtol=1e-12)
    assert found(away[:, 0], velocity[:, 0]) == pytest.approx(expected[0])


def test_the_table_extrapolates_linearly():
    assert table()((4.0, 0.0), (0.0, 1.0)) == pytest.approx(1.0 + 2 * 2.0 + 0.5)
    assert table()((1.0, 0.0), (9.0, 0.0)) == pytest.approx(1.0 + 2.0 + 0.5 * 9 - 0.25)


def test_a_table_round_trips(tmp_path):
    path = tmp_path / "times.toml"
    table().save(path)
    again = read_minimal_times(path)
    np.testing.assert_allclose(again.time, table().time, atol=1e-5)
    np.testing.assert_array_equal(again.direction, table().direction)
    path.write_text(path.read_text().replace("speed_m_s = [0.0, 1.0]", "speed_m_s = [1.0, 0.0]"))
    with pytest.raises(InputError, match="axes"):
        read_minimal_times(path)


@pytest.mark.slow
def test_the_packaged_table_agrees_with_plans_within_its_error():
    found, model = read_minimal_times(), airpuck.read_model("paper:M3")
    planned = shortest_time(model, 0.7, (0.0, 0.7), 1.0, "rest")
    assert abs(float(found((0.7, 0.0), (0.0, 0.7))) - planned) < found.error["worst"]


@pytest.mark.slow
def test_a_table_is_valid_for_one_craft_only(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    model = airpuck.read_model("paper:M3")
    assert minimal_times_of(model).craft == craft_of(model)
    assert minimal_times_of(replace(model, source="renamed")).source == "paper:M3"
    other = scaled(model, 0.41)
    file = tmp_path / "airpuck" / "minimal_times" / f"{craft_of(other)}.toml"
    file.parent.mkdir(parents=True)
    slow = replace(read_minimal_times(), craft=craft_of(other), time=2 * read_minimal_times().time)
    slow.save(file)
    found = minimal_times_of(other)
    assert found.craft == craft_of(other) != craft_of(scaled(model, 0.42))


def test_without_casadi_only_other_craft_are_rejected(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setitem(sys.modules, "casadi", None)
    assert minimal_times_of(airpuck.read_model("paper:M3")).margin == 0
    with pytest.raises(InputError, match=r"cannot be planned: .*pip install 'airpuck\[plan\]'"):
        minimal_times_of(scaled(airpuck.read_model("paper:M3"), 0.43))


def test_an_unusually_large_error_adds_a_margin():
    packaged = read_minimal_times()
    assert replace(packaged, error={"p95": 0.1}).margin == pytest.approx(0.064)
    assert replace(packaged, error={"p95": 0.02}).margin == 0


@pytest.mark.slow
def test_times_of_another_craft_match_its_plans_within_their_error(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    # Fewer plans than for a player, from fewer starts.
    starts = ((0.0, 0.0), (1.8, 0.0), (-1.8, 0.0))
    monkeypatch.setattr("airpuck.planning.search._FREE", starts)
    monkeypatch.setattr("airpuck.planning.minimal_time._FITTED", 3)
    monkeypatch.setattr("airpuck.planning.minimal_time._CHECKED", 3)
    model, told = scaled(airpuck.read_model("paper:M3"), 0.4), []
    found = minimal_times_of(model, lambda done, of: told.append((done, of)))
    assert told[-1][0] == told[-1][1]
    usual = read_minimal_times()
    planned = shortest_time(model, 0.8, (0.3, 0.4), 0.7, "rest")
    assert abs(float(found((0.8, 0.0), (0.3, 0.4))) - planned) < 2 * found.error["worst"]
    assert planned > 1.3 * float(usual((0.8, 0.0), (0.3, 0.4)))
    again = read_minimal_times(next(tmp_path.rglob("*.toml")))
    assert (again.craft, again.error) == (found.craft, found.error)
