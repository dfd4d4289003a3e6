"""The referee, with sequences made by hand."""

import pytest

from airpuck.boundary.errors import InputError
from airpuck.craft.table import AirHockey
from airpuck_hockey.game.rules import Referee, Rules


def referee(first=-1, **rules) -> Referee:
    return Referee(Rules(**rules), AirHockey(), first)


def test_the_other_side_scores_and_the_conceding_side_serves_after_a_pause():
    judge = referee(pause_s=1.0)
    assert judge.judge(0.01, -0.3, 0.0, 0) == []
    assert judge.judge(2.0, 1.13, 3.0, 1) == [("goal", -1)]
    assert (judge.score, judge.phase) == ((1, 0), "goal")
    assert judge.judge(2.5, 1.13, 3.0, 1) == []
    assert judge.judge(3.0, 1.13, 3.0, 1) == [("serve", 1)]
    assert judge.phase == "play"
    assert judge.judge(4.0, -1.13, 3.0, -1) == [("goal", 1)]
    assert judge.judge(5.0, -1.13, 3.0, -1) == [("serve", -1)]
    assert judge.score == (1, 1)


def test_the_first_to_seven_goals_wins_and_the_game_is_over():
    judge, time = referee(), 0.0
    for goals in range(1, 8):
        found = judge.judge(time := time + 1.0, 1.13, 3.0, 1)
        assert found[0] == ("goal", -1)
        assert found[1:] == ([("over", -1)] if goals == 7 else [])
        if goals < 7:
            judge.judge(time := time + 1.0, 1.13, 3.0, 1)
    assert (judge.score, judge.phase) == ((7, 0), "over")
    assert judge.judge(time + 5.0, -1.13, 3.0, -1) == []
    assert judge.score == (7, 0)


@pytest.mark.parametrize(("goal", "winner"), [(None, 0), (1, -1), (-1, 1)])
def test_the_leader_wins_at_the_time_limit(goal, winner):
    judge = referee(limit_s=10.0)
    if goal:
        judge.judge(1.0, goal * 1.13, 3.0, goal)
        judge.judge(2.5, goal * 1.13, 3.0, goal)
    assert judge.judge(9.99, 0.2, 1.0, 0) == []
    assert judge.judge(10.0, 0.2, 1.0, 0) == [("over", winner)]


def test_a_goal_at_the_last_moment_counts():
    judge = referee(limit_s=10.0)
    assert judge.judge(10.0, 1.13, 3.0, 1) == [("goal", -1), ("over", -1)]


FOUL, OTHER = [("foul", -1), ("serve", 1)], [("foul", 1), ("serve", -1)]


@pytest.mark.parametrize(
    ("first", "seen"),
    [
        # Crossing the line in time restarts the clock.
        (-1, [(14.99, -0.5, []), (15.0, -0.5, FOUL), (29.0, 0.5, []), (29.5, -0.1, []),
              (31.0, 0.1, []), (45.9, 0.5, []), (46.0, 0.5, OTHER)]),
        # Exactly on the line it is on nobody's side; the next half again has fifteen seconds.
        (1, [(0.1, 0.0, []), (16.0, 0.0, []), (20.0, 0.2, []), (34.9, 0.2, []),
             (35.0, 0.2, OTHER)]),
    ],
)  # fmt: skip
def test_fifteen_seconds_on_one_side_give_the_puck_to_the_other(first, seen):
    judge = referee(first=first)
    for time, x, said in seen:
        assert judge.judge(time, x, 1.0, 0) == said


def test_the_side_that_serves_has_fifteen_seconds():
    judge = referee(first=-1)
    judge.serve(10.0, 1)
    assert judge.judge(24.9, 0.5, 1.0, 0) == []
    assert judge.judge(25.0, 0.5, 1.0, 0) == OTHER


def test_a_puck_resting_on_the_centre_line_is_served_to_alternating_sides():
    judge = referee(first=-1)
    steps = [round(1.0 + 0.1 * k, 3) for k in range(31)]
    assert [judge.judge(t, 0.01, 0.0, 0) for t in steps[:-1]] == [[]] * 30
    assert judge.judge(steps[-1], 0.01, 0.0, 0) == [("stuck", 0), ("serve", 1)]
    for t in steps:
        found = judge.judge(t + 10.0, -0.01, 0.0, 0)
    assert found == [("stuck", 0), ("serve", -1)]


def test_a_moving_puck_is_not_stuck():
    judge = referee()
    for k in range(100):
        # Touched once in two seconds.
        assert judge.judge(1.0 + 0.1 * k, 0.01, 0.3 if k % 20 == 0 else 0.0, 0) == []


@pytest.mark.parametrize("goals", [0, -1, 1001])
def test_invalid_numbers_of_goals_are_rejected(goals):
    with pytest.raises(InputError, match="goals"):
        Rules(goals=goals)


def test_a_puck_is_stuck_within_its_radius_of_the_centre_line():
    radius = AirHockey().puck.radius_m
    for x, speed, stuck in ((0.99, 0.04, True), (1.01, 0.04, False), (0.5, 0.06, False)):
        judge = referee(first=1)
        assert judge.judge(1.0, x * radius, speed, 0) == []
        assert bool(judge.judge(4.01, x * radius, speed, 0)) == stuck


def test_a_game_lasts_five_minutes_with_a_second_of_pause_after_goals():
    judge = referee()
    assert judge.judge(1.0, 1.13, 3.0, 1) == [("goal", -1)]
    assert judge.judge(1.99, 1.13, 3.0, 1) == []
    assert judge.judge(2.0, 1.13, 3.0, 1) == [("serve", 1)]
    # Alternate the sides, so that there is no foul.
    for k in (*range(3, 300), 299.9):
        assert judge.judge(float(k), 0.5 * (-1) ** int(k), 1.0, 0) == []
    assert judge.judge(300.0, 0.5, 1.0, 0) == [("over", -1)]
