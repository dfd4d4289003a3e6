import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from airpuck.recording.message import (
    HOLOHOVER_CONTROL,
    HOLOHOVER_MOTORS,
    MessageCodec,
    StreamCodec,
    definitions,
)

from ..apparatus.bags import stamped
from ..apparatus.examples import examples

NUMBERS = st.floats(-1e3, 1e3)
CODECS = {name: StreamCodec(name) for name in ("pose", "reference", "estimate", "imu", "mouse")}


@pytest.mark.parametrize("stream", CODECS)
@given(data=st.data())
@examples(20)
def test_streams_round_trip(stream, data):
    codec = CODECS[stream]
    values = data.draw(st.lists(NUMBERS, min_size=len(codec.columns), max_size=len(codec.columns)))
    if stream == "pose":
        values[2] = data.draw(st.floats(-3.14, 3.14))
    stamp, decoded = codec.decode(codec.encode(1_700_000_000_000_000_007, values))
    # The table's references carry no header.
    assert stamp == (None if stream == "reference" else 1_700_000_000_000_000_007)
    np.testing.assert_allclose(decoded, values, rtol=0, atol=1e-14)


def test_a_command_has_the_expected_bytes():
    codec = StreamCodec("command", HOLOHOVER_MOTORS)
    assert codec.msgtype == HOLOHOVER_CONTROL
    command = np.array([0.03, 0.5, 1.0, 0.25, 0.0, 0.75])
    expected = stamped(12_000_000_345, "body", command)
    assert codec.encode(12_000_000_345, command) == expected
    # Nothing of the previous message remains.
    codec.encode(99, np.ones(6))
    assert codec.encode(12_000_000_345, command) == expected
    both = codec.encode_all(np.array([99, 12_000_000_345]), np.stack([np.ones(6), command]))
    assert both == [stamped(99, "body", np.ones(6)), expected]


@pytest.mark.parametrize(
    "damage",
    [lambda m: m[:-8], lambda m: m + bytes(16), lambda m: b"", lambda m: b"\xff" * len(m)],
    ids=["cut", "too long", "empty", "noise"],
)
def test_malformed_messages_raise_value_error(damage):
    codec = StreamCodec("pose")
    with pytest.raises(ValueError, match="are not a valid geometry_msgs/msg/PoseStamped"):
        codec.decode(damage(codec.encode(0, (1.0, 2.0, 3.0))))


def test_messages_with_sequences_round_trip():
    codec = MessageCodec("diagnostic_msgs/msg/DiagnosticArray")
    message = codec.message()
    value = codec.message("diagnostic_msgs/msg/KeyValue", key="jitter", value="0.2 ms")
    message.status = [
        codec.message("diagnostic_msgs/msg/DiagnosticStatus", name="fly", level=1, values=[value])
    ]
    (status,) = codec.decode(codec.encode(message)).status
    assert (status.name, status.level, status.message) == ("fly", 1, "")
    assert (status.values[0].key, status.values[0].value) == ("jitter", "0.2 ms")


def test_an_unknown_type_raises_value_error():
    with pytest.raises(ValueError, match="nobody_msgs/msg/Thing is missing"):
        MessageCodec("nobody_msgs/msg/Thing")


@pytest.mark.parametrize("kind", ["string", "std_msgs/Header"])
def test_arrays_that_would_expand_into_code_are_rejected(kind):
    assert definitions("a/msg/B", f"{kind}[9] names") and definitions("a/msg/B", "float64[9999] x")
    with pytest.raises(ValueError, match="is defined with more than 2,000 elements"):
        definitions("a/msg/B", f"{kind}[1001] names")


def test_a_type_with_thousands_of_fields_is_rejected():
    fields = [f"float64 a{k}\n" for k in range(2001)]
    assert definitions("a/msg/B", "".join(fields[:1900]))
    with pytest.raises(ValueError, match="is defined with more than 2,000 elements"):
        definitions("a/msg/B", "".join(fields))
