"""Messages that a page may send, and rejection of all others."""

import json
import math
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from airpuck.web.messages import LONGEST, Order, Wish, packed_state, packed_wish, read_message


def test_a_wish_as_the_page_writes_it():
    # DataView: Uint32, then Float32 three times, all little-endian.
    data = bytes([7, 0, 0, 0]) + bytes([0, 0, 0, 0x3F]) + bytes([0, 0, 0x80, 0xBE])
    data += bytes([0, 0, 0x80, 0x3F])
    assert read_message(data) == Wish(7, 0.5, -0.25, 1.0)
    assert packed_wish(Wish(7, 0.5, -0.25, 1.0)) == data


@pytest.mark.parametrize(
    ("order", "meant"),
    [
        ({"do": "go"}, Order("go")),
        ({"do": "level", "level": "easy"}, Order("level", level="easy")),
        ({"do": "think", "on": True}, Order("think", on=True)),
    ],
)
def test_orders(order, meant):
    assert read_message(json.dumps(order)) == meant


@pytest.mark.parametrize(
    "message",
    [
        "",
        "go",
        "[]",
        "null",
        '{"do": "leave"}',  # only the server may send this
        '{"do": ["go"]}',
        '{"do": {"do": "go"}}',
        '{"do": "level", "level": 3}',
        '{"do": "think", "on": "yes"}',
        "[" * LONGEST,
        '{"do": "go"}' + " " * LONGEST,
        b"",
        b"\0" * 15,
        b"\0" * 17,
        struct.pack("<Ifff", 1, math.nan, 0.0, 0.0),
        struct.pack("<Ifff", 1, 0.0, math.inf, 0.0),
        struct.pack("<Ifff", 1, 0.0, 0.0, math.nan),
    ],
)
def test_garbage_is_none(message):
    assert read_message(message) is None


@given(st.one_of(st.binary(max_size=80), st.text(max_size=80)))
def test_anything_else_is_none_or_sound(message):
    found = read_message(message)
    if isinstance(found, Wish):
        assert math.isfinite(found.x)
        assert math.isfinite(found.y)


def test_a_state_as_the_page_reads_it():
    state = packed_state(1.5, 9, True, (1, 2, 3, 0, 0, 0), (4, 5, 6, 7), (8, 9, 10, 0), (0.5, 1.0))
    assert len(state) == 16 + 4 * 12
    assert struct.unpack_from("<dIB", state) == (1.5, 9, 1)
    assert struct.unpack_from("<12f", state, 16) == (*range(1, 11), 0.5, 1.0)
