"""Messages of craft as text: nothing is lost, and garbage is refused."""

import json

import numpy as np
import pytest

import airpuck
from airpuck.fleet.wire import Letter, digest, on_clock

FLEET = airpuck.read_fleet("into_square")
MESSAGE = FLEET.agreement("h0", start=3.0).message(2.5)
LETTER = Letter(MESSAGE, 10**18, 10**18 + 5, True, digest(FLEET.opening))


def test_a_message_survives_the_wire_to_the_bit():
    again = Letter.read(LETTER.text())
    assert (again.epoch_ns, again.start_ns, again.ready) == (10**18, 10**18 + 5, True)
    assert again.opening == LETTER.opening
    path, other = MESSAGE.agreed.path, again.message.agreed.path
    for field in ("begin", "pose", "rate", "durations", "accelerations"):
        np.testing.assert_array_equal(getattr(path, field), getattr(other, field))


def test_on_another_clock_the_same_place_is_reached_at_the_same_moment():
    later = on_clock(MESSAGE, 7.0).agreed.path
    times = np.linspace(3.0, 5.0, 20)
    np.testing.assert_allclose(MESSAGE.agreed.path.places(times), later.places(times + 7.0))


def test_the_digest_tells_paths_of_other_models_apart():
    assert digest(FLEET.opening) == digest(airpuck.read_fleet("into_square").opening)
    assert digest(FLEET.opening) != digest(airpuck.read_fleet("into_line").opening)


@pytest.mark.parametrize(
    "change",
    [
        {"message": None},
        {"message": {}},
        {"epoch_ns": "x"},
        {"message": {**json.loads(LETTER.text())["message"], "time": float("nan")}},
        {"message": {**json.loads(LETTER.text())["message"], "agreed": [0, [0.0, [1.0]]]}},
        {"message": {**json.loads(LETTER.text())["message"], "accepted": ["h1"]}},
        {
            "message": {
                **json.loads(LETTER.text())["message"],
                "agreed": [0, [0.0, [0, 0, 0], [0, 0, 0], [[-1], [0], [0]], [[1], [0], [0]]]],
            }
        },
    ],
)
def test_garbage_is_refused(change):
    with pytest.raises(ValueError, match="not a message of a craft"):
        Letter.read(json.dumps({**json.loads(LETTER.text()), **change}))


@pytest.mark.parametrize("text", ["", "[" * 90_000, "7", "x" * 200_000])
def test_text_that_is_no_message_is_refused(text):
    with pytest.raises(ValueError, match=r"not a message|longer than"):
        Letter.read(text)
