"""Plans flown on the twin: as fast as planned, and twice as fast as a set point."""

import pytest

import airpuck
from airpuck.craft.table import Table

# All courses are on the table; flying each takes minutes.
from airpuck.twin.race import _COURSES, course_plan, race
from airpuck.twin.settings import default_twin_settings

M3 = airpuck.read_model("paper:M3")


@pytest.fixture(scope="module")
def planned():
    return course_plan("straight", M3, default_twin_settings(), reserve=0.1)


@pytest.mark.slow
def test_a_plan_is_flown_in_its_time_and_a_set_point_takes_twice_as_long(planned):
    found = race(planned, M3, seeds=2)
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
    for start, goal, via in _COURSES.values():
        for point in (start, goal, *via):
            assert abs(point[0]) < reach[0] - 0.02
            assert abs(point[1]) < reach[1] - 0.02
