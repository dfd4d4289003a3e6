"""Computations of items."""

from dataclasses import replace

import numpy as np
import pytest

from airpuck import identify, load_trajectory, tracking_study
from airpuck.campaigns.items import Fitting, ShortestTime, Tracking, recovery_errors
from airpuck.model.model_file import published_model
from airpuck.planning.minimal_time import read_minimal_times
from airpuck.recording.csv_folder import write_csv
from airpuck.twin.plant import varied

from ..apparatus.synthetic_flights import record


@pytest.mark.study
@pytest.mark.parametrize(
    ("fields", "options"),
    [
        ({"controller": "full"}, {"controller": "full"}),
        ({"law": "mpc"}, {"controller": "full", "laws": ["mpc"]}),
    ],
)
def test_a_flight_item_matches_the_tracking_study(fields, options):
    (row,) = Tracking(seed=3, dwell_s=0.4, **fields).run()
    model = published_model("M4")
    (flown,) = tracking_study([model], model, dwell=0.4, seed=3, **options)
    worst = np.max([np.abs(r.steady_state_error) for r in flown.results], axis=0)
    names = ("x_m", "y_m", "yaw_rad")
    np.testing.assert_array_equal([row[f"steady_state_error_{n}"] for n in names], worst)
    assert row["not_settled"] == sum(r.settling_time is None for r in flown.results)
    inside = np.abs(flown.twin.pose[:, :2]).max(axis=0)
    half = np.array([2.2, 1.1]) / 2 - model.vehicle.radius_m
    assert row["clearance_m"] == pytest.approx((half - inside).min())


def test_craft_vary_within_the_requested_spread():
    model = published_model("M3")
    assert varied(model, 0.0, 5) is model
    factors = [
        np.log(
            [
                *(v.parameters.thrust / model.parameters.thrust).mean(axis=1),
                v.parameters.inertia / model.parameters.inertia,
                v.parameters.motor_time_constant / model.parameters.motor_time_constant,
            ]
        )
        for v in (varied(model, 0.1, seed) for seed in range(400))
    ]
    # 400 draws: standard errors of 0.005 and 0.0035.
    np.testing.assert_allclose(np.mean(factors, axis=0), 0, atol=0.02)
    np.testing.assert_allclose(np.std(factors, axis=0), 0.1, atol=0.015)
    assert np.abs(np.corrcoef(np.transpose(factors)) - np.eye(8)).max() < 0.25


def test_recovery_errors_match_a_hand_calculation():
    truth = published_model("M3")
    p = truth.parameters
    other = replace(
        p,
        thrust=p.thrust * np.array([1, 1, 1.05, 1, 1, 1])[:, None],
        inertia=p.inertia * 0.9,
        motor_time_constant=p.motor_time_constant * 1.2,
        angle_offset=p.angle_offset + 0.01,
        center_of_mass=p.center_of_mass + np.array([3e-3, -4e-3]),
    )
    found = recovery_errors(replace(truth, parameters=other), truth)
    expected = {
        "thrust": 0.05,
        "motor_time_constant": 0.2,
        "inertia": -0.1,
        "angle_offset_rad": 0.01,
        "center_of_mass_m": 5e-3,
    }
    assert found == pytest.approx(expected)


@pytest.fixture(scope="module")
def flight(tmp_path_factory):
    folder = tmp_path_factory.mktemp("flights") / "one"
    write_csv(record(duration=15.0, noise=1e-4), folder)
    return str(folder)


@pytest.mark.study
def test_fits_from_different_starts_agree(flight):
    plain = identify(load_trajectory(flight), "M2").model.parameters.to_vector()
    for seed in (1, 2):
        (row,) = Fitting(
            recordings=[flight], model="M2", start_spread=0.1, seed=seed, validation=flight
        ).run()
        assert row["converged"] == 1
        assert row["windows"] > 100
        found = np.array([v for k, v in row.items() if k.startswith(("thrust", "motor"))])
        np.testing.assert_allclose(found, [*plain[:18], plain[19]], atol=5e-3)
        assert 0 < row["rmse_x_m"] < 0.02


@pytest.mark.study
def test_resampled_fits_scatter_around_the_fit(tmp_path):
    """A quarter of a minute has eight blocks for nineteen parameters."""
    flight = str(tmp_path / "minute")
    write_csv(record(duration=60.0, noise=1e-4), tmp_path / "minute")
    rows = Fitting(recordings=[flight], model="M2", resamplings=24, seed=4).run()
    fit = identify(load_trajectory(flight), "M2")
    lag = [row["motor_time_constant"] for row in rows]
    centre = float(fit.model.parameters.motor_time_constant)
    error = fit.model.standard_error(lambda m: m.parameters.motor_time_constant)
    assert len(rows) == 24
    assert abs(np.median(lag) - centre) < error
    assert 0.5 < np.std(lag) / error < 1.5
    assert {row["inertia"] for row in rows} == {float(fit.model.parameters.inertia)}


@pytest.mark.slow
def test_a_shortest_time_matches_the_packaged_table():
    item = ShortestTime(distance_m=0.5, speed_m_s=0.5, direction_rad=0.3, seed=1)
    (row,) = item.run()
    velocity = 0.5 * np.array([np.cos(0.3), np.sin(0.3)])
    known = read_minimal_times()((0.5, 0.0), velocity)
    assert row["time_s"] == pytest.approx(float(known), rel=0.1)
