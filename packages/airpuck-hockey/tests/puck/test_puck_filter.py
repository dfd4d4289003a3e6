"""The puck's filter and its predictions, against pucks with known truth."""

import math
from operator import attrgetter

import numpy as np
import pytest

from airpuck.boundary.errors import InputError
from airpuck.craft.table import AirHockey, Contact, Puck
from airpuck.physics.puck import PuckState
from airpuck.physics.puck_on_table import PuckOnTable
from airpuck_hockey.puck.prediction import (
    PuckBelief,
    PuckModel,
    drawn_path,
    drawn_puck,
    predict_crossing,
    predict_path,
    predict_puck,
)
from airpuck_hockey.puck.puck_filter import PuckFilter, PuckNoise
from tests.apparatus.changes import changed


def learned(true: Puck, bounces: int = 4, learns: bool = True) -> PuckFilter:
    """Show a filter with the default table some flights between the side rails."""
    puck, random = PuckOnTable(AirHockey(puck=true), PuckState(0.0, 0.0)), np.random.default_rng(0)
    found, noise = PuckFilter(AirHockey(), learns=learns), PuckNoise()
    deviations = np.array([noise.position_m, noise.position_m, noise.yaw_rad])
    start = 0.0
    for k in range(bounces):
        puck.run(start)
        puck.place(PuckState(-0.3, 0.0, 0.0, 1.0, (-1) ** k * 2.0, 0.0))
        for time in start + np.arange(1, 130) / 240:
            puck.run(float(time))
            found.pose(float(time), np.array(puck.state[:3]) + random.normal(0.0, deviations))
        start = float(puck.time) + 1.0
    return found


@pytest.mark.parametrize(("restitution", "drag"), [(0.65, 0.1), (0.9, 0.3)])
def test_other_rails_and_drag_are_learned(restitution, drag):
    true = Puck(rail=Contact(restitution=restitution), drag_1_s=drag)
    puck = learned(true).model.equipment.puck
    # The table file counts like one bounce.
    expected = (0.79 + 4 * restitution) / 5
    assert puck.rail.restitution == pytest.approx(expected, abs=0.01)
    assert abs(puck.drag_1_s - drag) < 0.02
    assert puck.standard_error["rail.restitution"] < 0.08
    assert puck.standard_error["drag_1_s"] < 0.02


def test_learning_can_be_disabled():
    puck = learned(Puck(rail=Contact(restitution=0.65)), learns=False).model.equipment.puck
    assert puck == Puck()


PLAY = AirHockey()
NOISE = PuckNoise()
SIGMA = np.array([NOISE.position_m, NOISE.position_m, NOISE.yaw_rad])
#: All numbers of the puck are known: only noise remains.
KNOWN = AirHockey(
    puck=Puck(
        standard_error=dict.fromkeys(
            ("drag_1_s", "spin_drag_1_s", "rail.restitution", "rail.grip"), 1e-6
        )
    )
)


def watched(found, puck, stop, rng, *, start=0.0, dropped=0.0, jitter=0.0):
    """Feed a filter with poses of a puck; return the errors of its belief."""
    errors = []
    for k in range(1, round((stop - start) * 240) + 1):
        time = start + k / 240 + jitter * rng.uniform()
        puck.run(time)
        if rng.random() < dropped or puck.goal:
            continue
        found.pose(time, np.array(puck.state[:3]) + SIGMA * rng.standard_normal(3))
        error = found.belief.mean - puck.state
        error[2] = math.remainder(error[2], 2 * math.pi)
        errors.append(error)
    return np.array(errors)


def shot(rng, speed=4.0):
    angle = rng.uniform(-math.pi, math.pi)
    place = rng.uniform([-0.7, -0.35], [0.7, 0.35]).tolist()
    way = speed * math.cos(angle), speed * math.sin(angle)
    return PuckState(*place, 0.0, *way, float(rng.normal(0, 10)))


def test_the_estimate_is_as_accurate_as_stated():
    # Normalised errors of the whole state: 6 on average, after a third of a second and bounces.
    rng, normalised = np.random.default_rng(1), []
    for _ in range(40):
        found, puck = PuckFilter(KNOWN), PuckOnTable(KNOWN, shot(rng))
        error = watched(found, puck, 0.35, rng, dropped=0.1, jitter=1e-3)[-1]
        normalised.append(error @ np.linalg.solve(found.belief.covariance, error))
        assert not [e for e in found.events if e.kind == "hit"]
    # The filter allows for air currents that the simulation lacks: errors may be smaller.
    assert 1.0 < np.mean(normalised) < 7.5


def test_bounces_off_rails_are_detected_on_time():
    puck, found = PuckOnTable(PLAY, PuckState(0.2, 0.3, 0, 2.0, 2.5)), PuckFilter(PLAY)
    watched(found, puck, 1.5, np.random.default_rng(2))
    bounces = [t.time for t in puck.touches if t.met == "rail"]
    noticed = [e.time for e in found.events if e.kind == "rail"]
    assert len(bounces) >= 3
    assert noticed == pytest.approx(bounces, abs=1e-3)


@pytest.mark.parametrize("moment", [0.5001, 0.5017, 0.5040])
def test_a_hit_is_detected_on_time_and_absorbed_within_some_frames(moment):
    rng = np.random.default_rng(3)
    puck, found = PuckOnTable(PLAY, PuckState(0.0, 0.0, 0, -0.7, 0.2)), PuckFilter(PLAY)
    watched(found, puck, 0.5, rng)
    puck.run(moment)
    puck.place(puck.state._replace(vx=6.0, vy=-1.0, spin=20.0))
    errors = watched(found, puck, 0.55, rng, start=0.5)
    hits = [e.time for e in found.events if e.kind == "hit"]
    assert hits == pytest.approx([moment], abs=2e-4)
    # Three frames later velocity is known to a percent.
    assert np.hypot(*errors[4, 3:5]) < 0.06


def test_an_outlier_is_not_a_hit():
    rng = np.random.default_rng(4)
    puck, found = PuckOnTable(PLAY, PuckState(0.0, 0.0, 0, 0.7, 0.2)), PuckFilter(PLAY)
    watched(found, puck, 0.3, rng)
    wrong = np.array(puck.state[:3]) + np.array([0.1, 0.0, 0.0])
    found.pose(0.303, wrong)
    errors = watched(found, puck, 0.5, rng, start=0.3 + 1 / 240)
    assert found.outliers == 1
    assert not [e for e in found.events if e.kind == "hit"]
    assert np.hypot(*errors[0, 3:5]) < 0.05


def test_outdated_and_invalid_poses_are_ignored():
    found = PuckFilter(PLAY)
    found.pose(1.0, np.zeros(3))
    before = found.belief
    for time, pose in ((0.9, np.ones(3)), (1.0, np.ones(3)), (1.1, np.full(3, np.nan))):
        found.pose(time, pose)
    assert found.belief is before
    with pytest.raises(InputError, match="times"):
        found.predict([0.5])
    with pytest.raises(InputError, match="no pose"):
        PuckFilter(PLAY).predict([0.5])


def test_after_a_long_gap_it_restarts():
    found = PuckFilter(PLAY)
    found.pose(0.0, np.zeros(3))
    found.pose(1.0, np.array([0.5, 0.1, 0.0]))
    assert [e.kind for e in found.events] == ["seen", "seen"]


def test_an_exact_state_predicts_the_exact_flight():
    start = PuckState(0.1, 0.2, 0.3, 4.0, 2.0, 5.0)
    times = np.linspace(0.1, 1.0, 10)
    puck = PuckOnTable(KNOWN, start)
    found = predict_puck(
        PuckModel(KNOWN), PuckBelief(0.0, np.array(start), np.zeros((6, 6))), list(times)
    )
    for time, mean in zip(times, found.mean, strict=True):
        puck.run(float(time))
        np.testing.assert_allclose(mean, puck.state, atol=1e-12)
    assert [t.met for t in found.touches] == [t.met for t in puck.touches]
    assert len(found.touches) >= 2


def test_prediction_bands_across_bounces_have_their_stated_coverage():
    # Pucks whose numbers deviate as `PuckModel` assumes, seen for 0.2 s, predicted for 0.5 s.
    rng, inside, total, bounces = np.random.default_rng(5), 0, 0, 0
    names = ("drag_1_s", "spin_drag_1_s")
    for _ in range(60):
        puck = Puck()
        rail = {
            "restitution": puck.rail.restitution + 0.03 * rng.normal(),
            "grip": puck.rail.grip + 0.1 * rng.normal(),
        }
        off = {
            name: max(getattr(puck, name) + spread * rng.normal(), 0)
            for name, spread in zip(names, (0.05, 0.1), strict=True)
        }
        truth = AirHockey(puck=changed(puck, **off, rail=rail))
        flown, found = PuckOnTable(truth, shot(rng)), PuckFilter(PLAY)
        watched(found, flown, 0.2, rng)
        prediction = found.predict([0.45, 0.7])
        if flown.goal or prediction.goal or any(t.met == "post" for t in prediction.touches):
            continue
        bounces += len(prediction.touches)
        for time, mean, covariance in zip(
            prediction.time, prediction.mean, prediction.covariance, strict=True
        ):
            flown.run(float(time))
            error = (mean - flown.state)[:2]
            # 95 % of the plane's normal distribution.
            inside += error @ np.linalg.solve(covariance[:2, :2], error) < 5.99
            total += 1
    assert bounces > 40
    assert 0.88 <= inside / total <= 0.995


def test_identified_parameters_narrow_the_bands():
    belief = PuckBelief(0.0, np.array([0.0, 0.3, 0, 4.0, 1.0, 0]), np.diag([1e-8] * 3 + [1e-4] * 3))
    wide, narrow = (predict_puck(PuckModel(play), belief, [0.5]) for play in (PLAY, KNOWN))
    assert narrow.covariance[0, 0, 0] < 0.3 * wide.covariance[0, 0, 0]


def test_a_crossing_is_where_the_puck_crosses_a_line():
    # Along x at 2 m/s with a drag of 0.2 1/s; then after a bounce off the right rail.
    belief = PuckBelief(1.0, np.array([0.0, 0.3, 0, 2.0, 0.5, 0]), np.zeros((6, 6)))
    found = predict_crossing(PuckModel(KNOWN), belief, 0.4)
    assert found is not None
    assert found.time == pytest.approx(1.0 - math.log(1 - 0.2 * 0.4 / 2.0) / 0.2)
    assert (found.state.x, found.state.y) == pytest.approx((0.4, 0.3 + 0.5 * 0.2))
    back = predict_crossing(PuckModel(KNOWN), belief, -0.2, 3.0)
    assert back is not None
    puck = PuckOnTable(KNOWN, PuckState(*belief.mean.tolist()), 1.0)
    puck.run(back.time)
    assert puck.state.vx < 0
    np.testing.assert_allclose(back.state, puck.state, atol=1e-7)
    assert predict_crossing(PuckModel(KNOWN), belief, -0.2, 0.5) is None


def test_a_drawn_path_has_its_corners_at_the_rails():
    play = AirHockey()
    mean = np.array([-0.2, 0.31, 0.0, 1.1, 2.7, 3.0])
    path = drawn_path(play, PuckBelief(5.0, mean, np.zeros((6, 6))))
    _, reach = play.table.reach(play.puck.radius_m)
    legs = np.diff(path, axis=0)
    turned = np.abs(legs[1:, 0] * legs[:-1, 1] - legs[1:, 1] * legs[:-1, 0])
    corners = path[1:-1][turned > 1e-9 + 1e-3 * np.hypot(*legs[1:].T) * np.hypot(*legs[:-1].T)]
    assert len(corners) >= 2
    np.testing.assert_allclose(np.abs(corners[:, 1]), reach, atol=1e-6)


def test_the_uncertainty_of_a_crossing_matches_many_pucks():
    rng = np.random.default_rng(8)
    mean = np.array([0.0, 0.0, 0, 2.0, 1.5, 0])
    deviation = np.array([1e-3, 1e-3, 1e-3, 0.02, 0.02, 0.5])
    belief = PuckBelief(0.0, mean, np.diag(deviation**2))
    found = predict_crossing(PuckModel(KNOWN), belief, 0.8)
    assert found is not None
    drawn = []
    for _ in range(400):
        one = PuckBelief(0.0, mean + deviation * rng.normal(size=6), np.zeros((6, 6)))
        other = predict_crossing(PuckModel(KNOWN), one, 0.8)
        assert other is not None
        drawn.append((other.time, other.state.y))
    # There is one bounce on the path.
    assert found.state.vy < 0
    np.testing.assert_allclose(found.covariance, np.cov(np.transpose(drawn)), rtol=0.3, atol=1e-6)


def test_a_puck_that_does_not_cross_in_time_has_no_crossing():
    nothing = np.zeros((6, 6))
    for mean in ((0, 0.1, 0, 0, 0, 0), (0, 0.1, 0, 0, 1.0, 0), (0, 0.1, 0, -0.2, 0, 0)):
        belief = PuckBelief(0.0, np.array(mean, dtype=float), nothing)
        assert predict_crossing(PuckModel(KNOWN), belief, 0.4, 1.0) is None
        assert mean[3] or predict_crossing(PuckModel(KNOWN), belief, 0.4, 60.0) is None
    # 0.5 m at 0.25 m/s with the drag take 2.55 s: beyond two seconds, but not three.
    belief = PuckBelief(0.0, np.array([0, 0.1, 0, 0.25, 0, 0]), nothing)
    assert predict_crossing(PuckModel(KNOWN), belief, 0.5) is None
    found = predict_crossing(PuckModel(KNOWN), belief, 0.5, 3.0)
    assert found is not None
    assert found.time == pytest.approx(-math.log(1 - 0.2 * 0.5 / 0.25) / 0.2)


def test_the_spin_of_a_puck_reveals_nothing_about_its_path():
    found = []
    for spin in (0.0, 30.0):
        one = PuckFilter(PLAY)
        for k in range(30):
            one.pose(k / 240, np.array([0.1 + 0.5 * k / 240, 0.0, spin * k / 240]))
        assert one.belief is not None
        assert one.belief.mean[5] == pytest.approx(spin, abs=0.5)
        found.append(one.belief.covariance[:2, :2])
    np.testing.assert_allclose(found[0], found[1], rtol=1e-6)


def test_paths_match_the_twins_puck_even_into_the_goal():
    rng = np.random.default_rng(9)
    times = np.linspace(0.0, 2.0, 41)
    for play in (PLAY, AirHockey(puck=Puck(drag_1_s=0.0, spin_drag_1_s=0.0))):
        for _ in range(6):
            start = shot(rng, 3.0)
            puck = PuckOnTable(play, start, 5.0)
            found = predict_path(play, PuckBelief(5.0, np.array(start), np.eye(6)), 5.0 + times)
            for time, state in zip(times, found, strict=True):
                puck.run(5.0 + float(time))
                np.testing.assert_allclose(state[:5], puck.state[:5], atol=1e-6)


def test_predictions_do_not_depend_on_the_time_origin():
    # Stamps count from 1970: their resolution is coarser than the time offset after a bounce.
    random, times = np.random.default_rng(3), np.arange(0.0, 2.0, 0.004)
    began = 1.7e9 + 0.1811554
    for _ in range(40):
        mean = random.uniform(-1, 1, 6) * (0.9, 0.4, 3.0, 2.5, 2.5, 20.0)
        now, long_after = (PuckBelief(start, mean, 1e-6 * np.eye(6)) for start in (0.0, began))
        found = predict_path(AirHockey(), long_after, began + times)
        np.testing.assert_allclose(found, predict_path(AirHockey(), now, times), atol=1e-4)


def test_a_sampled_puck_deviates_as_the_filter_assumes():
    random = np.random.default_rng(0)
    play = AirHockey(puck=Puck(standard_error={"drag_1_s": 0.01}))
    assert PuckModel(play).spread["drag_1_s"] == 0.01
    drawn = [drawn_puck(play.puck, random) for _ in range(400)]
    for name, spread in PuckModel(play).spread.items():
        values = [attrgetter(name)(puck) for puck in drawn]
        assert np.mean(values) == pytest.approx(attrgetter(name)(play.puck), abs=spread / 4)
        assert np.std(values) == pytest.approx(spread, rel=0.15)
