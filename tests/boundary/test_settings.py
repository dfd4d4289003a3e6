"""An unknown name is reported with the nearest known one."""

import socket

import pytest

import airpuck
from airpuck.boundary.errors import InputError
from airpuck.control.laws import check_law
from airpuck.live.settings import check_interface
from airpuck.model.model_file import published_model
from airpuck.recording.dataset import dataset

LOOPBACK = socket.if_nameindex()[0][1]


@pytest.mark.parametrize(
    ("call", "given", "near"),
    [
        (airpuck.named_rung, "M33", "M3"),
        (airpuck.named_rung, "M3+inflw", "inflow"),
        (published_model, "M33", "M3"),
        (dataset, "holohver", "holohover"),
        (check_law, "lqrr", "lqr"),
        (check_interface, f"{LOOPBACK}x", LOOPBACK),
    ],
)
def test_an_unknown_name_suggests_the_closest_one(call, given, near):
    with pytest.raises(InputError, match=f"did you mean '{near}'\\?$"):
        call(given)


def test_three_alternatives_are_listed_with_commas():
    with pytest.raises(InputError, match=r"^frame: must be 'body' or 'world', not 'x'$"):
        airpuck.named_rung("M3", frame="x")
    with pytest.raises(InputError, match=r"must be 'lqr', 'mpc', 'plan' or 'FILE.py:NAME', not"):
        check_law("x")
