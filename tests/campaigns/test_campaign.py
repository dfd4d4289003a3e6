"""Campaigns as a whole: resumed, interrupted, from the command line; what items compute."""

import os
import signal
import subprocess
import sys
import time
from dataclasses import replace

import numpy as np
import pytest

from airpuck import campaign, identify, load_trajectory, tracking_study
from airpuck.campaigns import campaign as module
from airpuck.campaigns.dispatch import compute
from airpuck.campaigns.fitting import Fitting
from airpuck.campaigns.fleet import Fleet
from airpuck.campaigns.item import varied
from airpuck.campaigns.recovery import recovery_errors
from airpuck.campaigns.tracking import Tracking
from airpuck.model.model_file import published_model
from airpuck.recording import write_csv

from ..command_line import airpuck, refused
from ..synthetic import record

SPEC = 'kind = "tracking"\nseeds = {seeds}\nbase.dwell_s = 0.2\n'


@pytest.fixture
def here(monkeypatch):
    """Compute in this process, and note the seeds."""
    seeds = []

    def dispatch(entries, done, **_):
        for entry in entries:
            seeds.append(entry.item.seed)
            done(entry, compute(entry.item))

    monkeypatch.setattr(module, "dispatch", dispatch)
    return seeds


@pytest.fixture
def spec(tmp_path):
    def written(seeds, text=SPEC):
        (tmp_path / "spec.toml").write_text(text.format(seeds=seeds))
        return tmp_path / "spec.toml"

    return written


def test_only_what_is_missing_is_computed(here, spec, tmp_path):
    told = []
    first = campaign(spec(2), tmp_path, progress=lambda *state: told.append(state))
    assert told == [(0, 2, 0), (1, 2, 0), (2, 2, 0)]
    again = campaign(spec(2), tmp_path)
    assert again.computed == 0
    for one, other in zip(again.results, first.results, strict=True):
        assert one.rows[0] == pytest.approx(other.rows[0], rel=0, abs=0, nan_ok=True)
    files = sorted((tmp_path / "items").iterdir())
    content = [file.read_bytes() for file in files]
    more = campaign(spec("[1, 4, 0]"), tmp_path)
    assert (more.computed, here) == (1, [0, 1, 4])
    assert [file.read_bytes() for file in files] == content
    assert len(more.results) == 3
    assert len((tmp_path / "results.csv").read_text().splitlines()) == 4


def test_failures_are_kept_and_run_again_when_asked(here, spec, tmp_path):
    # 0.01 s of flight hold fewer poses than an identification needs.
    text = 'kind = "recovery"\nseeds = {seeds}\nbase.duration_s = 0.02\n'
    found = campaign(spec(1, text), tmp_path)
    assert len(found.failures) == 1
    assert campaign(spec(1, text), tmp_path).computed == 0
    assert campaign(spec(1, text), tmp_path, retry=True).computed == 1
    assert found.to_json()["failures"][0]["reason"]


def test_a_campaign_of_failures_only_does_not_end_well(here, spec, tmp_path):
    text = 'kind = "recovery"\nseeds = {seeds}\nbase.duration_s = 0.02\n'
    process = airpuck("campaign", spec(2, text), "-o", tmp_path, "--quiet")
    assert refused(process, "every item failed")
    assert "2 failed" in process.stdout


def test_interrupted_and_resumed(here, spec, tmp_path):
    dwells = 'kind = "tracking"\nseeds = {seeds}\ngrid.dwell_s = '
    script = tmp_path / "airpuck_command.py"
    script.write_text("from airpuck.cli import main\nif __name__ == '__main__':\n    main()\n")
    # The second item takes minutes: the campaign cannot have ended before it is interrupted.
    long = spec(1, dwells + "[0.1, 1000]")
    process = subprocess.Popen(
        [sys.executable, script, "campaign", long, "-o", tmp_path / "out", "--workers", "1"],
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    items = tmp_path / "out" / "items"
    while not (items.exists() and list(items.glob("[!.]*.json"))):
        assert process.poll() is None
        time.sleep(0.05)
    # As a terminal does: to the worker, too.
    os.killpg(process.pid, signal.SIGINT)
    _, told = process.communicate(timeout=180)
    assert process.returncode == 130
    assert told.splitlines()[-1] == "airpuck: interrupted; run it again for what is missing"
    assert "Traceback" not in told
    (done,) = items.iterdir()
    content = done.read_bytes()
    again = campaign(spec(1, dwells + "[0.1, 0.2]"), tmp_path / "out")
    assert (again.computed, here) == (1, [0])
    assert done.read_bytes() == content
    assert len(again.results) == 2


@pytest.mark.study
def test_a_flight_is_the_tracking_studys():
    (row,) = Tracking(seed=3, controller="full", dwell_s=0.4).run()
    model = published_model("M4")
    (flown,) = tracking_study([model], model, dwell=0.4, seed=3, full_controller=True)
    worst = np.max([np.abs(r.steady_state_error) for r in flown.results], axis=0)
    names = ("x_m", "y_m", "yaw_rad")
    np.testing.assert_array_equal([row[f"steady_state_error_{n}"] for n in names], worst)
    assert row["not_settled"] == sum(r.settling_time is None for r in flown.results)
    inside = np.abs(flown.twin.pose[:, :2]).max(axis=0)
    half = np.array([2.2, 1.1]) / 2 - model.vehicle.radius_m
    assert row["clearance_m"] == pytest.approx((half - inside).min())


def test_craft_vary_as_asked():
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


def test_recovery_errors_by_hand():
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


def test_craft_of_a_fleet_come_apart_as_much_as_they_differ():
    item = Fleet(craft=64, duration_s=0.3, hold_s=0.3, twin={"radio": {"jitter_s": 0.0}}, seed=2)
    same, near, far = (
        np.array([list(row.values()) for row in item.model_copy(update={"spread": s}).run()])
        for s in (0.0, 0.01, 0.02)
    )
    assert (same == 0).all()
    # The same factors, twice as far: to first order twice as far apart.
    np.testing.assert_allclose(far.std(axis=0), 2 * near.std(axis=0), rtol=0.1)


@pytest.fixture(scope="module")
def flight(tmp_path_factory):
    folder = tmp_path_factory.mktemp("flights") / "one"
    write_csv(record(duration=15.0, noise=1e-4), folder)
    return str(folder)


@pytest.mark.study
def test_fits_from_anywhere_end_at_the_same_place(flight):
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
def test_resampled_fits_surround_the_fit(flight):
    rows = Fitting(recordings=[flight], model="M2", resamplings=12, seed=4).run()
    fit = identify(load_trajectory(flight), "M2")
    lag = [row["motor_time_constant"] for row in rows]
    centre = float(fit.model.parameters.motor_time_constant)
    error = fit.model.standard_error(lambda m: m.parameters.motor_time_constant)
    assert 10 <= len(rows) <= 12
    assert abs(np.median(lag) - centre) < 3 * error
    assert 0.3 < np.std(lag) / error < 3
    assert {row["inertia"] for row in rows} == {float(fit.model.parameters.inertia)}
