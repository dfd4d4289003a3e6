"""Other sites can neither show our pages nor act on them."""

import socket

import pytest

from airpuck.web.address import refusal

PORT = "8080"


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
def test_who_is_refused(host, origin, served, allowed):
    origins = [] if origin is None else [origin]
    assert (refusal([host], origins, served) is None) == allowed


def test_headers_given_twice_or_not_at_all():
    ours = "127.0.0.1:8080"
    assert refusal([], [], "127.0.0.1")
    assert refusal([ours, "evil.example"], [], "127.0.0.1")
    assert refusal([ours], [f"http://{ours}", "http://evil.example"], "127.0.0.1")
