"""The tracking study: its reports, and its reproduction of a flight."""

import json
from dataclasses import replace

import numpy as np
import pytest

import airpuck
from airpuck import InputError, SetPoints
from airpuck.cli.output import write_json
from airpuck.control.laws import PAPERS
from airpuck.model.model_file import published_model
from airpuck.report.tables import tracking_tables
from airpuck.twin.experiments import track
from airpuck.twin.plant import build_plant
from airpuck.twin.settings import default_twin_settings
from airpuck.twin.tracking_study import SET_POINTS, compare_controllers, tracking_study

from ..apparatus.changes import changed

M4 = published_model("M4")
#: One more than the paper's: the start, and four moves.
TIMES = [0.0, 0.9, 1.9, 2.9, 3.9]
POSES = [(0.2, -0.1, 1.0), (0.5, 0.1, 1.5), (0.2, -0.2, 0.5), (0.0, 0.0, 0.0), (0.3, 0.0, 0.3)]


@pytest.fixture(scope="module")
def imitated():
    start = POSES[0]
    flight = track(
        M4, SetPoints(TIMES, POSES), 5.0, seed=3, pose=start, plant=build_plant(M4)
    ).recording
    (tracked,) = tracking_study([M4], M4, flights=[flight], seed=4)
    return tracked


@pytest.mark.slow
def test_a_simulation_starts_where_the_real_flight_did(imitated):
    real, twin = imitated.real, imitated.twin
    np.testing.assert_allclose(twin.pose[0], POSES[0], atol=5e-3)
    np.testing.assert_allclose(twin.set_points.times, real.set_points.times, atol=0.011)
    np.testing.assert_array_equal(twin.set_points.poses, real.set_points.poses)
    assert twin.time[-1] == pytest.approx(real.time[-1], abs=0.02)
    # They differ only by noise and the fitted gains.
    assert (imitated.rmse < [0.02, 0.02, 0.1]).all()


@pytest.mark.slow
def test_all_moves_of_a_flight_are_reported(imitated):
    content = imitated.to_json()
    for key in ("setpoints", "flight_setpoints"):
        found = [list(result["set_point"].values()) for result in content[key]]
        np.testing.assert_allclose(found, POSES[1:])
    assert content["against_flight"]["span_s"] == [0.5, 6.5]
    assert content["against_flight"]["origin_s"] == pytest.approx(0.4, abs=0.011)


@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_missing_poses_at_the_end_of_a_dwell_are_reported(tmp_path):
    settings = changed(default_twin_settings(), motion_capture={"gaps_s": ((1.2, 1.45),)})
    flown = tracking_study([M4], M4, dwell=0.5, settings=settings)
    # Against a flight beside it; errors of yaw are those of the shorter rotation.
    off = np.array([0.01, -0.02, 0.1])
    aside = replace(flown[0].twin, pose=flown[0].twin.pose + off + [0.0, 0.0, 2 * np.pi])
    np.testing.assert_allclose(replace(flown[0], real=aside).rmse, np.abs(off), rtol=1e-9)
    results = flown[0].results
    assert [r.pose for r in results] == list(SET_POINTS[1:])
    assert [r.steady_state_error is None for r in results] == [True, False, False]
    write_json(tmp_path / "track.json", flown[0].to_json())
    content = json.loads((tmp_path / "track.json").read_text(), parse_constant=pytest.fail)
    assert content["setpoints"][0]["steady_state_error"] is None
    (table,) = tracking_tables(flown)
    assert table.rows[0][4] == "no poses"


@pytest.mark.slow
def test_both_laws_fly_the_same_task_and_the_predictive_one_is_faster():
    points = SetPoints([0.0, 0.3], [(0.0, 0.0, 0.0), (0.5, 0.2, 1.0)])
    lqr, mpc = tracking_study([M4], M4, set_points=points, dwell=1.4, seed=2, laws=("lqr", "mpc"))
    assert [flight.label for flight in (lqr, mpc)] == ["M4 lqr", "M4 mpc"]
    assert lqr.gains is not None and mpc.gains is None
    # The same truth and noise: until the first command acts, both see the same.
    first = lqr.twin.time < 0.005
    np.testing.assert_array_equal(lqr.twin.pose[first], mpc.twin.pose[: first.sum()])
    ((slow,), (fast,)) = lqr.results, mpc.results
    assert fast.settling_time < 0.8 * (slow.settling_time or np.inf)
    assert set(mpc.outcomes) <= {"no pose", "optimal"} and "optimal" not in lqr.outcomes
    assert mpc.saturated.mean() > lqr.saturated.mean()
    plan = mpc.log.predictions[50]
    then = np.argmin(np.abs(mpc.twin.time - (mpc.log.time[50] + M4.transport_delay + 0.3)))
    np.testing.assert_allclose(plan.states[14, :2], mpc.twin.pose[then, :2], atol=0.03)
    assert not lqr.log.predictions
    content = mpc.to_json()
    assert (content["law"], content["gains"]) == ("mpc", None)
    assert 0 < content["step_ms"]["p50"] <= content["step_ms"]["p99"]


def test_a_larger_craft_is_not_sent_into_a_rail():
    wide = replace(M4, vehicle=M4.vehicle.model_copy(update={"radius_m": 0.12}))
    (flown,) = tracking_study([wide], wide, flights=(None,), dwell=0.1)
    reach = np.array(default_twin_settings().table.reach(0.12))
    places = np.abs(np.array(flown.twin.set_points.poses)[:, :2])
    np.testing.assert_allclose(places.max(axis=0), np.minimum(reach - 0.03, [1.0, 0.3]))
    (flown,) = tracking_study([M4], M4, flights=(None,), dwell=0.1)
    np.testing.assert_array_equal(flown.twin.set_points.poses, SET_POINTS)


def test_json_has_null_for_nan(capsys):
    from pathlib import Path

    write_json(Path("-"), {"a": [np.nan, (float("inf"), 1.0)], "b": {"c": 2, "d": None}})
    assert json.loads(capsys.readouterr().out) == {
        "a": [None, [None, 1.0]],
        "b": {"c": 2, "d": None},
    }


@pytest.mark.slow
def test_controllers_are_compared_on_the_same_craft_and_noise():
    points = SetPoints([0.0, 0.2], [(0.0, 0.0, 0.0), (0.3, 0.1, 0.0)])
    found = compare_controllers(M4, ["lqr", "lqr"], flights=2, dwell=1.5, set_points=points)
    settled = found.figures["settling_time_s"]
    np.testing.assert_array_equal(settled[0], settled[1])
    assert settled[0, 0] != settled[0, 1]  # another craft
    assert found.differences["effort"] == [(0.0, 0.0, 0.0)]
    mean, low, high = found.means["settling_time_s"][0]
    # Student's t of one degree of freedom: 12.706.
    assert high - mean == pytest.approx(12.706 * settled[0].std(ddof=1) / np.sqrt(2), rel=1e-4)
    assert (low + high) / 2 == pytest.approx(mean)
    assert len(repr(found).splitlines()) == 4


def test_comparison_figures_match_single_flights():
    points = SetPoints([0.0, 0.2], [(0.0, 0.0, 0.0), (0.3, 0.1, 0.0)])
    found = compare_controllers(M4, ["lqr"], flights=1, spread=0.0, dwell=1.5, set_points=points)
    (flown,) = tracking_study([M4], M4, set_points=points, dwell=1.5, controller="full")
    assert found.figures["settling_time_s"][0, 0] == flown.results[-1].settling_time
    assert found.figures["effort"][0, 0] == flown.results[-1].effort


def test_a_law_flies_the_same_given_by_name_class_or_object():
    points = SetPoints([0.0, 0.1], [(0.0, 0.0, 0.0), (0.1, 0.0, 0.0)])
    laws = ["lqr", airpuck.LQR, airpuck.LQR(M4, airpuck.default_tuning())]
    found = compare_controllers(M4, laws, flights=1, dwell=0.3, set_points=points)
    assert found.laws == ("lqr", "LQR 1", "LQR 2")
    for name, rows in found.figures.items():
        np.testing.assert_array_equal(rows, np.tile(rows[0], (3, 1)), err_msg=name)


def test_file_names_of_flights_distinguish_laws():
    points = SetPoints([0.0, 0.1], [(0.0, 0.0, 0.0)] * 2)
    (flown,) = tracking_study([M4], M4, set_points=points, dwell=0.2, controller="full")
    names = [replace(flown, law=law).file_name for law in (None, PAPERS, "mpc")]
    assert names == ["M4", "M4", "M4_mpc"]


@pytest.mark.slow
def test_a_flight_that_misses_a_set_point_has_no_settling_time():
    points = SetPoints([0.0, 0.2, 2.2], [(0.0, 0.0, 0.0), (0.1, 0.0, 0.0), (0.9, 0.3, 0.0)])
    options = {"set_points": points, "dwell": 0.2}
    (flown,) = tracking_study([M4], M4, controller="full", **options)
    assert [one.settling_time is None for one in flown.results] == [False, True]
    found = compare_controllers(M4, ["lqr"], flights=1, spread=0.0, **options)
    assert found.figures["not_settled"][0, 0] == 1
    assert np.isnan(found.figures["settling_time_s"][0, 0])


def test_a_comparison_names_laws_that_did_not_settle():
    figures = {
        "settling_time_s": np.array([[1.0, 2.0], [np.nan, np.nan], [np.nan, 2.5]]),
        "not_settled": np.array([[0.0, 0.0], [1.0, 3.0], [1.0, 0.0]]),
        "effort": np.array([[1.0, 1.0], [1.5, 1.5], [0.5, 0.5]]),
    }
    found = airpuck.ControllerComparison(("lqr", "/home/me/pid.py:PID", "mpc"), figures)
    assert repr(found).splitlines()[1:] == [
        "settling time: lqr 1.5 s; PID never settled; mpc +0.5 s",
        "flights that did not settle: lqr 0; PID 2 of 2; mpc 1 of 2",
        "effort: lqr 1; PID +0.5 (+0.5 to +0.5); mpc -0.5 (-0.5 to -0.5)",
    ]
    turned = {name: rows[[1, 0, 2]] for name, rows in figures.items()}
    found = airpuck.ControllerComparison(("pid.py:PID", "lqr", "mpc"), turned)
    assert "PID never settled; lqr 1.5 s; mpc 2.5 s" in repr(found)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"flights": 0}, "flights: must be from 1 to 1000"),
        ({"flights": -1}, "flights: must be from 1 to 1000"),
        ({"spread": -1}, "spread: must be from 0 to 1"),
        ({"laws": []}, "laws: must name at least one law"),
        ({"laws": "lqr"}, "laws: must be a sequence of a text, a subclass of Law or Law, not"),
        (
            {"laws": ["lqr", 3]},
            "must be a sequence of a text, a subclass of Law or Law, but contains 3",
        ),
        ({"laws": [int]}, "laws: must be .*, but contains the class int$"),
        ({"laws": [airpuck.Law]}, "law: must inherit from airpuck.Law"),
        ({"laws": ["lqr", "mcp"]}, "law: must be 'lqr', 'mpc', .*did you mean 'mpc'"),
    ],
)
def test_invalid_comparison_options_are_rejected(options, words):
    with pytest.raises(InputError, match=words):
        airpuck.compare_controllers(M4, **options)
