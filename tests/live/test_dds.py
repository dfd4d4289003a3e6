import socket
from xml.etree import ElementTree

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from airpuck.boundary.errors import InputError
from airpuck.live import graph, settings
from airpuck.recording.message import HOLOHOVER_CONTROL, command_type, definitions

from ..apparatus.examples import examples

pytest.importorskip("cyclonedds")

TYPES = {**definitions(""), **command_type(("left", "right"))[1]}
SENT = (
    "geometry_msgs/msg/PoseStamped",
    HOLOHOVER_CONTROL,
    "airpuck_msgs/msg/Command2Stamped",
    "holohover_msgs/msg/HolohoverState",
    "holohover_msgs/msg/HolohoverStateStamped",
    "holohover_msgs/msg/HolohoverIMUStamped",
    "holohover_msgs/msg/HolohoverMouseStamped",
    "rcl_interfaces/msg/Log",
    "diagnostic_msgs/msg/DiagnosticArray",
    "sensor_msgs/msg/Imu",
)
STRUCTS: dict = {}
INTEGERS = {"int32": (-(2**31), 2**31 - 1), "uint32": (0, 2**32 - 1)}


@pytest.fixture(scope="module")
def store():
    made = get_typestore(Stores.EMPTY)
    made.register({k: v for k, v in TYPES.items() if not k.startswith("service_msgs")})
    return made


def values(draw, node, description):
    """Values that a field may hold, as plain lists and dictionaries."""
    if node == Nodetype.NAME:
        return {name: values(draw, *field) for name, field in TYPES[description][1]}
    if node in (Nodetype.ARRAY, Nodetype.SEQUENCE):
        element, count = description
        n = count if node == Nodetype.ARRAY else draw(st.integers(0, 3))
        return [values(draw, *element) for _ in range(n)]
    kind = description[0]
    if kind == "string":
        letters = st.characters(codec="utf-8", exclude_characters="\0", exclude_categories=["Cs"])
        return draw(st.text(letters, max_size=9))
    if kind == "float64":
        return draw(st.floats(allow_nan=False))
    return draw(st.integers(*INTEGERS.get(kind, (0, 127))))


def build(given_values, node, description, make, array):
    """Put plain values into message objects of either library."""
    if node == Nodetype.NAME:
        fields = {
            name: build(given_values[name], *field, make, array)
            for name, field in TYPES[description][1]
        }
        return make(description)(**fields)
    if node in (Nodetype.ARRAY, Nodetype.SEQUENCE):
        (inner, of), _ = description
        made = [build(value, inner, of, make, array) for value in given_values]
        return array(made) if inner == Nodetype.BASE else made
    return given_values


@pytest.mark.parametrize("msgtype", SENT)
@given(data=st.data())
@examples(8)
def test_cyclone_and_rosbags_write_the_same_bytes(store, msgtype, data):
    plain = values(data.draw, Nodetype.NAME, msgtype)
    root = (Nodetype.NAME, msgtype)
    ours = build(plain, *root, lambda name: graph.idl_struct(TYPES, name, STRUCTS), list)
    theirs = build(plain, *root, store.types.__getitem__, np.array)
    sent = ours.serialize(use_version_2=False)
    assert sent[:4] == b"\x00\x01\x00\x00"
    assert sent == bytes(store.serialize_cdr(theirs, msgtype))
    assert type(ours).deserialize(sent) == ours


def test_names_are_mangled_as_in_ros_2():
    # As `ddsls` lists the topics of the real table.
    assert graph.dds_topic("/optitrack/drone/pose") == "rt/optitrack/drone/pose"
    assert (
        graph.dds_type("geometry_msgs/msg/PoseStamped") == "geometry_msgs::msg::dds_::PoseStamped_"
    )
    pose = graph.idl_struct(TYPES, "geometry_msgs/msg/PoseStamped", STRUCTS)
    assert pose.__idl_typename__ == "geometry_msgs::msg::dds_::PoseStamped_"


def test_names_are_demangled_and_foreign_names_unchanged():
    for topic in ("/rosout", "/drone/control"):
        assert graph.ros_topic(graph.dds_topic(topic)) == topic
    assert graph.ros_type(graph.dds_type(HOLOHOVER_CONTROL)) == HOLOHOVER_CONTROL
    for name in ("rq/add_two_intsRequest", "DCPSParticipant", "rtx/pose"):
        assert graph.ros_topic(name) is None
    assert graph.ros_type("HelloWorldData::Msg") == "HelloWorldData::Msg"


def test_a_missing_definition_raises_value_error():
    with pytest.raises(ValueError, match="other_msgs/msg/Thing is missing"):
        graph.idl_struct(get_types_from_msg("other_msgs/Thing thing", "a/msg/A"), "a/msg/A")


# Domains ------------------------------------------------------------------------------------------

LOOPBACK = next(name for _, name in socket.if_nameindex() if name.startswith("lo"))


def test_by_default_only_the_loopback_interface_is_used():
    domain = ElementTree.fromstring(settings.domain_config(None)).find("Domain")
    assert domain is not None
    assert [item.get("name") for item in domain.iter("NetworkInterface")] == [LOOPBACK]
    assert domain.findtext("General/AllowMulticast") == "false"
    assert [peer.get("address") for peer in domain.iter("Peer")] == ["127.0.0.1"]


def test_a_named_interface_replaces_the_loopback():
    other = next((n for _, n in socket.if_nameindex() if n != LOOPBACK), None)
    if other is None:
        pytest.skip("the machine has no other interface")
    domain = ElementTree.fromstring(settings.domain_config(other)).find("Domain")
    assert domain is not None
    assert [item.get("name") for item in domain.iter("NetworkInterface")] == [other]
    assert domain.findtext("General/AllowMulticast") == "true"
    assert not list(domain.iter("Peer"))


def test_an_unknown_interface_is_rejected():
    with pytest.raises(InputError, match=r"--interface: there is no network interface 'wifi<7'"):
        settings.domain_config("wifi<7")


@pytest.mark.parametrize(
    ("given", "environment", "number"),
    [(None, {}, 0), (None, {"ROS_DOMAIN_ID": "42"}, 42), (7, {"ROS_DOMAIN_ID": "42"}, 7)],
)
def test_the_domain_comes_from_the_option_or_from_ros(monkeypatch, given, environment, number):
    monkeypatch.delenv("ROS_DOMAIN_ID", raising=False)
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    assert settings.domain_id(given) == number


@pytest.mark.parametrize("text", ["-1", "233", "four"])
def test_a_nonexistent_domain_is_rejected(monkeypatch, text):
    monkeypatch.setenv("ROS_DOMAIN_ID", text)
    with pytest.raises(InputError, match="ROS_DOMAIN_ID: must be from 0 to 232"):
        settings.domain_id(None)
