from __future__ import annotations

import os
import pickle
import tempfile
import time
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from airpuck.recording.inert_pickle import Refused, read_inert

executed: list[str] = []


def run(text: str) -> str:
    executed.append(text)
    return text


def text(value: str) -> bytes:
    return b"X" + len(value).to_bytes(4, "little") + value.encode()


class Calls:
    """Pickles as a call of whatever it is given."""

    def __init__(self, function, *arguments) -> None:
        self.call = function, arguments

    def __reduce__(self):
        return self.call


@pytest.mark.parametrize("protocol", [2, 4])
def test_plain_dictionaries(protocol: int):
    content = {"a": {"b": 1, "c": "text"}, "d": (1, 2, 3, 4), "e": None, "f": (True, 70000)}
    assert read_inert(pickle.dumps(content, protocol)) == content


#: Written if a shell ever runs; the folder is ours alone.
REACHED = Path(tempfile.mkdtemp()) / "reached"
HOSTILE = {
    "a shell": Calls(os.system, f"echo > {REACHED}"),
    "eval": Calls(eval, "1"),
    "our own function": Calls(run, "reached"),
    "getattr": Calls(getattr, "", "upper"),
    "a list": [1],
    "a set": {1},
    "a float": 1.5,
    "a class": Calls,
    "within a dictionary": {"T": {"x": Calls(run, "reached")}},
    "as a key": {Calls(run, "reached"): 1},
}


@pytest.mark.parametrize("protocol", [0, 1, 2, 3, 4, 5])
@pytest.mark.parametrize("name", HOSTILE)
def test_anything_else_is_refused_and_not_run(name: str, protocol: int):
    data = pickle.dumps(HOSTILE[name], protocol)
    with pytest.raises(Refused):
        read_inert(data)
    assert executed == []
    assert not REACHED.exists()


def test_the_hostile_ones_would_run_elsewhere():
    pickle.loads(pickle.dumps(HOSTILE["our own function"]))
    assert executed == ["reached"]
    executed.clear()


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (b"cos\nsystem\n(X\x02\x00\x00\x00lstR.", "os.system"),
        (b"cposix\nsystem\n.", "posix.system"),
        (b"cbuiltins\neval\n.", "builtins.eval"),
        (b"cnumpy\nload\n.", "numpy.load"),
        (b"ctorch\nload\n.", "torch.load"),
        (b"cnumpy\nndarray\n)R.", "calls something unknown"),
        (b"ctorch\nDoubleStorage\n)R.", "calls something unknown"),
        (b"ccollections\nOrderedDict\n}R.", "calls something unknown"),
        (b"X\x01\x00\x00\x00a)R.", "calls something unknown"),
        (b"}}b.", "fills something unknown"),
        (b"cnumpy\ndtype\n)R}b.", "fills something unknown"),
        (b"(i__main__\nrun\n.", "INST"),
        (b"\x8c\x02os\x8c\x06system\x93.", "STACK_GLOBAL"),
        (b"\x82\x01.", "EXT1"),
        (b"cnumpy\nndarray\n)\x81.", "NEWOBJ"),
        (b"Pstorage\n.", "PERSID"),
        (b"}(K\x01K\x02u.", "a key is not text"),
        (b"}(X\x01\x00\x00\x00au.", "out of order"),
        (b"K\x01(K\x02K\x03u.", "out of order"),
        (b"c_codecs\nencode\n(X\x01\x00\x00\x00aX\x04\x00\x00\x00zlibtR.", "unknown encoding"),
        (b"", "damaged"),
        (b".", "damaged"),
        (b"}", "damaged"),
        (b"}}.", "damaged"),
        (b"h\x07.", "damaged"),
        (b"u.", "damaged"),
        (b"X\xff\xff\xff\x7fa", "damaged"),
        (b"\x8e\xff\xff\xff\xff\xff\xff\xff\x7f", "damaged"),
        (b"\xff\xfe", "damaged"),
        (b"(" * 5000 + b".", "nested too deeply"),
        (b"}" * 5000 + b".", "nested too deeply"),
        (b"\x80\x02" + b"}0" * 60000 + b".", "longer"),
    ],
)
def test_what_is_refused_says_why(data: bytes, says: str):
    with pytest.raises(Refused, match=says):
        read_inert(data)


def test_a_large_memo_index_asks_for_no_memory():
    start = time.process_time()
    assert read_inert(b"}r\xff\xff\xff\xff.") == {}
    assert time.process_time() - start < 1


def test_nested_tuples_that_double_take_no_time():
    # Sixty thousand levels, each holding the one below twice.
    data = b")" + b"q\x00h\x00\x86" * 15000 + b"."
    start = time.process_time()
    assert isinstance(read_inert(data), tuple)
    assert time.process_time() - start < 5


def test_repeated_calls_are_limited():
    """Each copies a long text, and the memo would keep them all."""
    first = (
        b"c_codecs\nencode\nq\x01" + text("a" * 40000) + b"q\x00" + text("latin1") + b"q\x02\x86R"
    )
    again = b"h\x01h\x00h\x02\x86R\x86"
    assert isinstance(read_inert(first + again * 100 + b"."), tuple)
    with pytest.raises(Refused, match="too many objects"):
        read_inert(first + again * 5000 + b".")


@settings(max_examples=300, deadline=None)
@given(st.binary(max_size=60))
def test_junk_is_refused_or_plain(junk: bytes):
    try:
        read_inert(junk)
    except Refused as refusal:
        assert str(refusal).isprintable()


@settings(max_examples=300, deadline=None)
@given(data=st.data())
def test_changed_pickles_are_refused_or_plain(data: st.DataObject):
    content = bytearray(pickle.dumps({"T": {"x": (1, 2)}, "X": {"y": "text"}}, 2))
    for _ in range(data.draw(st.integers(1, 5))):
        content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    try:
        read_inert(bytes(content))
    except Refused as refusal:
        assert str(refusal).isprintable()
