"""Plans flown on the twin: as fast as planned, and twice as fast as a set point."""

from dataclasses import replace
from pathlib import Path

import pytest

import airpuck
from airpuck.boundary.errors import InputError
from airpuck.craft.table import Table
from airpuck.model.model_file import nominal_model
from airpuck.twin import race as module

# All courses are on the table; flying each takes minutes.
from airpuck.twin.race import COURSES, course_plan, race
from airpuck.twin.settings import default_twin_settings

M3 = airpuck.read_model("paper:M3")
COARSE = {"intervals": 20}


@pytest.fixture(scope="module")
def planned():
    # A grid half as fine as a user's.
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "plan", lambda *what, **how: airpuck.plan(*what, **how | COARSE))
        # Further starts do not make it faster.
        patch.setattr("airpuck.planning.plan._DOUBTFUL", 0.0)
        return course_plan("straight", M3, default_twin_settings())


@pytest.mark.slow
def test_a_plan_is_flown_in_its_time_and_a_set_point_takes_twice_as_long(planned):
    found = race(planned, M3, seeds=1)
    assert found.contacts == 0
    for flown, alone in zip(found.flown, found.set_point, strict=True):
        assert planned.lower_bound < flown < 1.1 * planned.duration
        assert alone > 1.6 * flown
    figures = found.to_json()
    assert figures["planned_s"] == planned.duration
    assert figures["flown_s"] == list(found.flown)
    assert figures["lower_bound_s"] == planned.lower_bound


def test_courses_are_on_the_table():
    reach = Table().reach(M3.vehicle.radius_m)
    for start, goal, via in COURSES.values():
        for point in (start, goal, *via):
            assert abs(point[0]) < reach[0] - 0.02
            assert abs(point[1]) < reach[1] - 0.02


@pytest.mark.slow
def test_plans_with_way_points_or_a_moving_start_have_no_set_point_flight(planned):
    states = planned.samples[1]
    x, y = states[len(states) // 2, :2].tolist()  # the plan passes there
    past = replace(planned, via=((x, y),), keep_out=((x, y, 0.05),))
    found = race(past, M3)
    assert found.set_point is None
    assert found.to_json()["set_point_s"] is None
    assert found.flown[0] == pytest.approx(planned.duration, rel=0.1)
    assert found.touches == 1
    missed = race(replace(planned, via=((x, y + 0.3),)), M3)
    assert missed.flown == (None,)
    states = planned.states.copy()
    states[0, 3] = 0.5
    with pytest.raises(InputError, match="starts in motion"):
        race(replace(planned, states=states), M3)


def test_a_twin_of_another_craft_is_refused(planned):
    examples = Path(__file__).parents[2] / "examples"
    other = nominal_model(airpuck.read_vehicle(examples / "free_flyers/atmos.toml"))
    with pytest.raises(InputError, match="has 6 propellers, the twin 8"):
        race(planned, other)
