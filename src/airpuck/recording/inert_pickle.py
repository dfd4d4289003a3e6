"""Reading the pickle inside a torch file without running anything.

A pickle is a program, and Python's own reader runs it. This one knows only the few instructions
that a dictionary of tensors needs, and only the few names in `_REDUCTIONS`, each of which it turns
into plain data by itself. Nothing is imported or called; every other instruction or name ends the
reading.
"""

from __future__ import annotations

import pickletools
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from airpuck.recording.listing import one_line

# Limits far above what such files need, so that a hostile one cannot ask for much memory.
_LONGEST = 10**5
_DEEPEST = 1000
_MOST_REDUCTIONS = 2000


class Refused(ValueError):
    """The pickle holds something that a dictionary of tensors does not need."""


@dataclass(frozen=True)
class Name:
    """A name that a pickle mentions; it is never looked up."""

    #: Module and name, joined by a dot.
    text: str


@dataclass(frozen=True)
class Storage:
    """A tensor's memory, kept in another member of the torch file."""

    #: ``torch.DoubleStorage`` and the like.
    kind: str
    #: Name of the member.
    key: str
    #: Number of elements it claims to have.
    n: int


@dataclass(frozen=True)
class Tensor:
    """How a tensor lies in its storage."""

    #: The memory.
    storage: Storage
    #: Element at which it begins.
    offset: int
    #: Elements and steps between them, for each dimension.
    shape: tuple[int, ...]
    stride: tuple[int, ...]


@dataclass
class Inert:
    """Any other object: what it is called, and what it was filled with."""

    #: The name in the pickle.
    kind: str
    #: What the pickle fills it with.
    state: tuple[Any, ...] = ()


_MARK = object()


@dataclass
class _Machine:
    """The pickle machine, reduced to data."""

    stack: list[Any] = field(default_factory=list)
    memo: dict[int, Any] = field(default_factory=dict)
    reductions: int = 0

    def push(self, value: Any) -> None:
        if len(self.stack) >= _DEEPEST:
            raise Refused("it is nested too deeply")
        self.stack.append(value)

    def pop(self) -> Any:
        value = self.stack.pop()
        if value is _MARK:
            raise Refused("its instructions are out of order")
        return value

    def pop_to_mark(self) -> list[Any]:
        items: list[Any] = []
        while (value := self.stack.pop()) is not _MARK:
            items.append(value)
        return items[::-1]

    def fill(self, pairs: list[Any]) -> None:
        """Add keys and values to the dictionary on top."""
        target = self.stack[-1]
        if not isinstance(target, dict) or len(pairs) % 2:
            raise Refused("its instructions are out of order")
        for key, value in zip(pairs[::2], pairs[1::2], strict=True):
            if not isinstance(key, str):
                raise Refused("a key is not text")
            target[key] = value


def read_inert(data: bytes) -> Any:
    """Read a pickle of dictionaries of tensors as plain data."""
    if len(data) > _LONGEST:
        raise Refused(f"it is longer than {_LONGEST} bytes")
    machine = _Machine()
    try:
        for opcode, argument, _ in pickletools.genops(data):
            if opcode.name == "STOP":
                (result,) = machine.stack
                return result
            instruction = _INSTRUCTIONS.get(opcode.name)
            if instruction is None:
                raise Refused(f"it uses the instruction {opcode.name}")
            instruction(machine, argument)
    except Refused:
        raise
    except (ValueError, TypeError, IndexError, KeyError, AttributeError, OverflowError) as error:
        raise Refused("it is damaged") from error
    raise Refused("it is damaged")


def _reduce(machine: _Machine, _: Any) -> None:
    arguments, function = machine.pop(), machine.pop()
    reduction = _REDUCTIONS.get(function.text) if isinstance(function, Name) else None
    if reduction is None or not isinstance(arguments, tuple):
        raise Refused("it calls something unknown")
    machine.reductions += 1
    if machine.reductions > _MOST_REDUCTIONS:
        raise Refused("it holds too many objects")
    machine.push(reduction(*arguments))


def _build(machine: _Machine, _: Any) -> None:
    state = machine.pop()
    target = machine.stack[-1]
    if not isinstance(target, Inert) or not isinstance(state, tuple):
        raise Refused("it fills something unknown")
    target.state = state


def _global(machine: _Machine, argument: str) -> None:
    name = argument.replace(" ", ".").replace("numpy._core.", "numpy.core.")
    if name not in _REDUCTIONS and name not in _MENTIONED:
        raise Refused(f"it names {one_line(name)}")
    machine.push(Name(name))


def _persistent(machine: _Machine, _: Any) -> None:
    kind, name, key, _device, n = machine.pop()[:5]
    if kind != "storage" or not isinstance(name, Name):
        raise Refused("it refers to something outside the file")
    if not isinstance(key, str) or not key.isdecimal() or not _is_count(n):
        raise Refused("a storage has a wrong name or size")
    machine.push(Storage(name.text, key, n))


def _is_count(value: object) -> bool:
    return type(value) is int and value >= 0


def _tensor(
    storage: Any, offset: Any, shape: Any, stride: Any, _gradient: Any, _hooks: Any, *_: Any
) -> Tensor:
    if not isinstance(storage, Storage) or not _is_count(offset):
        raise Refused("a tensor has no storage")
    sizes = (shape, stride)
    if not all(isinstance(size, tuple) and all(map(_is_count, size)) for size in sizes):
        raise Refused("a tensor has a wrong shape or stride")
    if len(shape) != len(stride):
        raise Refused("a tensor has a wrong shape or stride")
    return Tensor(storage, offset, shape, stride)


def _encode(text: Any, encoding: Any) -> bytes:
    if not isinstance(text, str) or encoding != "latin1":
        raise Refused("it holds text in an unknown encoding")
    return text.encode("latin1")


def _text_scalar(_dtype: Any, data: Any) -> str:
    """Decode a NumPy string: four bytes a character, filled up with zeros."""
    if not isinstance(data, bytes):
        raise Refused("it holds a NumPy number where text should be")
    return data.decode("utf-32-le").rstrip("\0")


def _empty() -> dict[str, Any]:
    return {}


def _inert(kind: str) -> Callable[..., Inert]:
    return lambda *_: Inert(kind)


#: What each callable name does here; none of the real ones is ever touched.
_REDUCTIONS: dict[str, Callable[..., Any]] = {
    "numpy.core.multiarray._reconstruct": _inert("numpy.ndarray"),
    "numpy.core.multiarray.scalar": _text_scalar,
    "numpy.dtype": _inert("numpy.dtype"),
    "_codecs.encode": _encode,
    "torch._utils._rebuild_tensor_v2": _tensor,
    "collections.OrderedDict": _empty,
}

#: Names that may appear as arguments.
_MENTIONED = (
    "numpy.ndarray",
    *(
        f"torch.{kind}Storage"
        for kind in ("Double", "Float", "Half", "Long", "Int", "Short", "Char", "Byte", "Bool")
    ),
)


def _tuple(n: int) -> Callable[[_Machine, Any], None]:
    def build(machine: _Machine, _: Any) -> None:
        machine.push(tuple([machine.pop() for _ in range(n)][::-1]))

    return build


def _constant(value: Any) -> Callable[[_Machine, Any], None]:
    return lambda machine, _: machine.push(value)


def _argument(machine: _Machine, argument: Any) -> None:
    machine.push(argument)


def _put(machine: _Machine, index: int) -> None:
    machine.memo[index] = machine.stack[-1]


_INSTRUCTIONS: dict[str, Callable[[_Machine, Any], None]] = {
    "PROTO": lambda machine, _: None,
    "FRAME": lambda machine, _: None,
    "MARK": _constant(_MARK),
    "NONE": _constant(None),
    "NEWTRUE": _constant(True),
    "NEWFALSE": _constant(False),
    "BININT": _argument,
    "BININT1": _argument,
    "BININT2": _argument,
    "LONG1": _argument,
    "BINUNICODE": _argument,
    "SHORT_BINUNICODE": _argument,
    "EMPTY_DICT": lambda machine, _: machine.push({}),
    "EMPTY_TUPLE": _constant(()),
    "TUPLE1": _tuple(1),
    "TUPLE2": _tuple(2),
    "TUPLE3": _tuple(3),
    "TUPLE": lambda machine, _: machine.push(tuple(machine.pop_to_mark())),
    "SETITEM": lambda machine, _: machine.fill([machine.pop(), machine.pop()][::-1]),
    "SETITEMS": lambda machine, _: machine.fill(machine.pop_to_mark()),
    "BINPUT": _put,
    "LONG_BINPUT": _put,
    "MEMOIZE": lambda machine, _: _put(machine, len(machine.memo)),
    "BINGET": lambda machine, index: machine.push(machine.memo[index]),
    "LONG_BINGET": lambda machine, index: machine.push(machine.memo[index]),
    "GLOBAL": _global,
    "REDUCE": _reduce,
    "BUILD": _build,
    "BINPERSID": _persistent,
}
