"""Other sites can neither show our pages nor act on them; pages send only known messages."""

import json
import math
import socket
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from airpuck.web.requests import (
    LONGEST,
    Order,
    Wish,
    packed_state,
    packed_wish,
    read_message,
    refusal,
)


@pytest.mark.parametrize(
    ("host", "origin", "served", "allowed"),
    [
        # The page itself, by any name of loopback, through a tunnel, behind a proxy with TLS.
        ("127.0.0.1:8080", "http://127.0.0.1:8080", "127.0.0.1", True),
        ("localhost:8080", "http://localhost:8080", "127.0.0.1", True),
        ("[::1]:8080", "http://[::1]:8080", "127.0.0.1", True),
        ("LocalHost:9000", "http://localhost:9000", "127.0.0.1", True),
        ("localhost", "https://localhost", "127.0.0.1", True),
        ("lab.example:8080", "http://lab.example:8080", "lab.example", True),
        ("192.168.1.7:8080", "http://192.168.1.7:8080", "0.0.0.0", True),
        (f"{socket.gethostname()}:80", None, "0.0.0.0", True),
        # No browser.
        ("127.0.0.1:8080", None, "127.0.0.1", True),
        # Another site, another port of this machine, a file, a frame without an origin.
        ("127.0.0.1:8080", "http://evil.example", "127.0.0.1", False),
        ("127.0.0.1:8080", "http://127.0.0.1:9000", "127.0.0.1", False),
        ("127.0.0.1:8080", "http://localhost:8080", "127.0.0.1", False),
        ("127.0.0.1:8080", "http://127.0.0.1:8080.evil.example", "127.0.0.1", False),
        ("127.0.0.1:8080", "null", "127.0.0.1", False),
        ("127.0.0.1:8080", "", "127.0.0.1", False),
        # A name that resolves to loopback: host and origin agree.
        ("evil.example:8080", "http://evil.example:8080", "127.0.0.1", False),
        ("evil.example:8080", None, "127.0.0.1", False),
        ("evil.example:8080", "http://evil.example:8080", "0.0.0.0", False),
        ("127.0.0.1.evil.example", None, "127.0.0.1", False),
        ("localhost.evil.example", None, "127.0.0.1", False),
        ("", None, "0.0.0.0", False),
        ("[::1", None, "127.0.0.1", False),
        # Names that only begin like an address, or contain one.
        ("[::1].evil", None, "127.0.0.1", False),
        ("[::1].evil.example:8080", "http://[::1].evil.example:8080", "127.0.0.1", False),
        ("[::1]evil.example", None, "127.0.0.1", False),
        ("evil.example[::1]", None, "127.0.0.1", False),
        ("[127.0.0.1]@evil.example", None, "127.0.0.1", False),
        ("127.0.0.1@evil.example", None, "127.0.0.1", False),
        ("127.0.0.1:80:evil.example", None, "127.0.0.1", False),
        ("127.0.0.1:x", None, "127.0.0.1", False),
        ("127.0.0.1/evil.example", None, "127.0.0.1", False),
        ("127.0.0.1 evil.example", None, "127.0.0.1", False),
        ("[localhost]", None, "127.0.0.1", False),
        ("[::1]", None, "127.0.0.1", True),
        ("[2001:db8::7]:8080", None, "::", True),
    ],
)
def test_requests_from_other_sites_are_rejected(host, origin, served, allowed):
    origins = [] if origin is None else [origin]
    assert (refusal([host], origins, served) is None) == allowed


def test_duplicate_and_missing_headers_are_rejected():
    ours = "127.0.0.1:8080"
    assert refusal([], [], "127.0.0.1")
    assert refusal([ours, "evil.example"], [], "127.0.0.1")
    assert refusal([ours], [f"http://{ours}", "http://evil.example"], "127.0.0.1")


def test_a_mallet_target_has_the_page_format():
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
def test_orders_of_a_page_are_read(order, meant):
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
def test_invalid_messages_are_ignored(message):
    assert read_message(message) is None


@given(st.one_of(st.binary(max_size=80), st.text(max_size=80)))
def test_any_message_is_ignored_or_has_finite_numbers(message):
    found = read_message(message)
    assert not isinstance(found, Wish) or all(map(math.isfinite, found))


def test_a_state_has_the_page_format():
    state = packed_state(1.5, 9, True, (1, 2, 3, 0, 0, 0), (4, 5, 6, 7), (8, 9, 10, 0), (0.5, 1.0))
    assert len(state) == 16 + 4 * 12
    assert struct.unpack_from("<dIB", state) == (1.5, 9, 1)
    assert struct.unpack_from("<12f", state, 16) == (*range(1, 11), 0.5, 1.0)
