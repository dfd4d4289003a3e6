"""Agreed paths keep their distance, whatever happens to the messages."""

import itertools
import json

import numpy as np
import pytest

import airpuck
from airpuck.fleet.agreement import SILENT, Agreement, Letter, digest, on_clock
from airpuck.fleet.path import Reach, Route, braked
from airpuck.fleet.search import Search

REACH = Reach(push=2.0, turn=10.0, speed=1.0, spin=6.0, radius=0.07, margin=0.01)
BORDER = np.array([0.5, 0.3])
STARTS = {"a": (-0.4, 0.0, 0.0), "b": (0.4, 0.0, 0.0), "c": (0.0, 0.2, 0.0)}


def parts():
    """Return the parts of three craft in the agreement."""
    paths = {name: (REACH, Route.at_rest(0.0, pose)) for name, pose in STARTS.items()}
    return {
        name: Agreement(name, *paths[name], {k: v for k, v in paths.items() if k != name})
        for name in paths
    }


def straight(start, goal, begin):
    """Return a path from rest to rest."""
    durations, accelerations = braked(
        np.subtract(start, goal), np.zeros(3), np.array([2.0, 2.0, 10.0]), 1.0
    )
    return Route(begin, np.array(start), np.zeros(3), durations, accelerations)


def least_distance(one, other, since):
    """Sample two paths densely, independently of the package's bound."""
    times = np.linspace(since, max(one.end, other.end, since) + 0.1, 2000)
    apart = one.moved(times).pose[:, :2] - other.moved(times).pose[:, :2]
    return np.hypot(*apart.T).min()


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_agreed_paths_keep_apart_despite_late_lost_and_repeated_messages(seed):
    random = np.random.default_rng(seed)
    craft = parts()
    searches = {name: Search(REACH, BORDER, k) for k, name in enumerate(craft)}
    coming, changes = [], 0
    for now in np.arange(0.0, 4.0, 0.02):
        for name, part in craft.items():
            changes += part.settle(now, 0.02)
            if part.proposal is None and random.random() < 0.2:
                goal = np.append(random.uniform(-1, 1, 2) * BORDER, 0.0)
                path = part.agreed.path
                found = searches[name].path(path, now + 0.5, goal, part.taken(), keeps=np.inf)
                if found is not None:
                    part.propose(found, now + 0.5)
            for other in craft:
                if other != name and random.random() > 0.4:
                    copies = 1 + (random.random() < 0.1)
                    message = part.message(now)
                    arrivals = now + random.exponential(0.05, copies)
                    coming += [(at, other, message) for at in arrivals]
        due = [one for one in coming if one[0] <= now]
        coming = [one for one in coming if one[0] > now]
        for _, other, message in due:
            craft[other].receive(message, now)
        for one, other in itertools.combinations(craft.values(), 2):
            gap = least_distance(one.agreed.path, other.agreed.path, now)
            assert gap >= 2 * REACH.room - 1e-9, (one.name, other.name, now)
    assert changes > 10  # they do not keep their distance by standing still


def test_a_proposal_is_flown_only_after_all_others_accepted_it():
    craft = parts()
    a, b, c = craft.values()
    a.propose(straight(STARTS["a"], (-0.4, 0.2, 0.0), 1.0), 1.0)
    b.receive(a.message(0.0), 0.01)
    a.receive(b.message(0.01), 0.02)
    assert not a.settle(0.02, 0.02)
    c.receive(a.message(0.02), 0.03)
    a.receive(c.message(0.03), 0.04)
    assert a.settle(0.04, 0.02)
    assert a.agreed.number == 1


def test_a_late_acceptance_is_ignored():
    craft = parts()
    a, b, c = craft.values()
    a.propose(straight(STARTS["a"], (-0.4, 0.2, 0.0), 0.3), 0.3)
    for other in (b, c):
        other.receive(a.message(0.0), 0.01)
        a.receive(other.message(0.01), 0.29)
    assert not a.settle(0.29, 0.02)
    assert a.proposal is None


def test_of_two_conflicting_proposals_the_later_arrival_wins():
    craft = parts()
    a, b, _ = craft.values()
    a.arrival, b.arrival = 3.0, 5.0
    a.propose(straight(STARTS["a"], (0.1, -0.1, 0.0), 1.0), 1.0)
    b.propose(straight(STARTS["b"], (-0.1, -0.1, 0.0), 1.0), 1.0)
    from_a, from_b = a.message(0.0), b.message(0.0)
    a.receive(from_b, 0.01)
    b.receive(from_a, 0.01)
    assert a.proposal is None
    assert b.proposal is not None
    assert a.message(0.02).accepted == {"b": 1}
    assert b.message(0.02).refused == {"a": 1}


def test_a_withdrawn_proposal_frees_its_space():
    a, b, _ = parts().values()
    a.propose(straight(STARTS["a"], (0.0, 0.0, 0.0), 1.0), 1.0)
    b.receive(a.message(0.0), 0.01)
    assert len(b.taken()) == 3
    a.withdraw()
    b.receive(a.message(0.05), 0.06)
    assert len(b.taken()) == 2


def test_an_old_message_that_arrives_late_changes_nothing():
    a, b, _ = parts().values()
    old = a.message(0.0)
    a.propose(straight(STARTS["a"], (0.0, 0.0, 0.0), 1.0), 1.0)
    b.receive(a.message(0.1), 0.11)
    b.receive(old, 0.2)
    assert b.message(0.3).accepted == {"a": 1}


def test_a_dead_craft_does_not_block_the_others():
    a, b, _ = parts().values()
    a.propose(straight(STARTS["a"], (-0.4, 0.2, 0.0), 2.0), 2.0)
    b.receive(a.message(0.9), 0.9)
    a.receive(b.message(0.9), 0.9)
    assert a.silent(SILENT + 0.1) == {"c"}
    assert a.settle(1.0, 0.02)


FLEET = airpuck.read_fleet("into_square")
MESSAGE = FLEET.agreement("h0", start=3.0).message(2.5)
LETTER = Letter(MESSAGE, 10**18, 10**18 + 5, True, digest(FLEET.opening))
FIELDS = json.loads(LETTER.text())["message"]
PATH = FIELDS["agreed"][1]
BACKWARDS = {key: [[-1], [0], [0]] for key in ("durations", "accelerations")}


def test_a_message_round_trips_exactly():
    again = Letter.read(LETTER.text())
    assert (again.epoch_ns, again.start_ns, again.ready) == (10**18, 10**18 + 5, True)
    assert again.opening == LETTER.opening
    path, other = MESSAGE.agreed.path, again.message.agreed.path
    for field in ("begin", "pose", "rate", "durations", "accelerations"):
        np.testing.assert_array_equal(getattr(path, field), getattr(other, field))


def test_craft_with_different_clocks_arrive_at_the_same_moment():
    later = on_clock(MESSAGE, 7.0).agreed.path
    times = np.linspace(3.0, 5.0, 20)
    np.testing.assert_allclose(MESSAGE.agreed.path.places(times), later.places(times + 7.0))


def test_the_digest_distinguishes_paths_of_different_models():
    assert digest(FLEET.opening) == digest(airpuck.read_fleet("into_square").opening)
    assert digest(FLEET.opening) != digest(airpuck.read_fleet("into_line").opening)


@pytest.mark.parametrize(
    "change",
    [
        {"message": None},
        {"message": {}},
        {"epoch_ns": "x"},
        {"message": {**FIELDS, "time": float("nan")}},
        {"message": {**FIELDS, "agreed": [0, {**PATH, "pose": [1.0]}]}},
        {"message": {**FIELDS, "agreed": [0, {**PATH, "durations": 1.0}]}},
        {"message": {**FIELDS, "accepted": ["h1"]}},
        {"message": {**FIELDS, "agreed": [0, PATH | BACKWARDS]}},
    ],
)
def test_garbage_is_rejected(change):
    with pytest.raises(ValueError, match="not a message of a craft"):
        Letter.read(json.dumps({**json.loads(LETTER.text()), **change}))


@pytest.mark.parametrize("text", ["", "[" * 90_000, "7", "x" * 200_000])
def test_malformed_messages_are_rejected(text):
    with pytest.raises(ValueError, match=r"not a message|longer than"):
        Letter.read(text)
