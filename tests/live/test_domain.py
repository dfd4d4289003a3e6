from __future__ import annotations

import socket
from xml.etree import ElementTree

import pytest

from airpuck.boundary.errors import InputError
from airpuck.live.domain import domain_config, domain_id

LOOPBACK = next(name for _, name in socket.if_nameindex() if name.startswith("lo"))


def test_by_default_only_the_loopback_interface_and_its_address_are_named():
    domain = ElementTree.fromstring(domain_config(None)).find("Domain")
    assert domain is not None
    assert [item.get("name") for item in domain.iter("NetworkInterface")] == [LOOPBACK]
    assert domain.findtext("General/AllowMulticast") == "false"
    assert [peer.get("address") for peer in domain.iter("Peer")] == ["127.0.0.1"]


def test_a_named_interface_takes_its_place():
    other = next((n for _, n in socket.if_nameindex() if n != LOOPBACK), None)
    if other is None:
        pytest.skip("the machine has no other interface")
    domain = ElementTree.fromstring(domain_config(other)).find("Domain")
    assert domain is not None
    assert [item.get("name") for item in domain.iter("NetworkInterface")] == [other]
    assert domain.findtext("General/AllowMulticast") == "true"
    assert not list(domain.iter("Peer"))


def test_an_interface_that_is_not_there_is_refused():
    with pytest.raises(InputError, match=r"--interface: there is no network interface 'wifi<7'"):
        domain_config("wifi<7")


@pytest.mark.parametrize(
    ("given", "environment", "number"),
    [(None, {}, 0), (None, {"ROS_DOMAIN_ID": "42"}, 42), (7, {"ROS_DOMAIN_ID": "42"}, 7)],
)
def test_the_domain_is_that_of_the_option_or_of_ros(given, environment, number):
    assert domain_id(given, environment) == number


@pytest.mark.parametrize("text", ["-1", "233", "four"])
def test_a_domain_that_does_not_exist_is_refused(text):
    with pytest.raises(InputError, match="ROS_DOMAIN_ID: must be a whole number from 0 to 232"):
        domain_id(None, {"ROS_DOMAIN_ID": text})
