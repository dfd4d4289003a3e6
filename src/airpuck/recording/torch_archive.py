"""The authors' preprocessed experiments: a torch file, read without torch and without trusting it.

A torch file contains a pickle: a program that Python's unpickler would run. Here it can only build
dictionaries, strings, whole numbers and tuples. It runs on Python's own pure-Python unpickler, with
most instructions removed: the one in C hashes any key and reserves memory for any index of its
memo.
"""

from __future__ import annotations

import io
import math
import os
import pickle
import pickletools
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from airpuck.boundary.errors import explained, listing, nearest, shortened
from airpuck.boundary.limits import Archive, sha256, within_means
from airpuck.data.trajectory import Trajectory
from airpuck.recording.message import HOLOHOVER_MOTORS

#: Shape of a sample of each tensor.
_SHAPES = {"T": (), "X": (6,), "U": (len(HOLOHOVER_MOTORS),), "dX": (6,)}
#: Longest pickle that is read [bytes]; the authors' have 1.3 kB.
_LONGEST = 10**5
#: Longest string that is converted to bytes; each call makes a new copy.
_LONGEST_TEXT = 2000


class Refused(ValueError):
    """The file contains something that the authors' experiments do not need."""


class _Storage(NamedTuple):
    """A tensor's memory, stored in another member of the torch file."""

    #: ``torch.DoubleStorage`` and the like.
    kind: str
    #: Name of the member.
    key: str
    #: Number of elements that the pickle claims.
    n: int


class _Tensor(NamedTuple):
    """Layout of a tensor in its storage, counted in elements."""

    storage: _Storage
    offset: int
    shape: tuple[int, ...]
    stride: tuple[int, ...]


class _Texts(dict[str, Any]):
    """A dictionary that allows only strings as keys: hashing nested tuples can take forever."""

    def __setitem__(self, key: Any, value: Any) -> None:
        if type(key) is not str:
            raise Refused("a key is not text")
        super().__setitem__(key, value)


def _is_count(value: object) -> bool:
    return type(value) is int and 0 <= value < 2**63


def _rebuilt_tensor(storage: Any, offset: Any, shape: Any, stride: Any, *_: Any) -> _Tensor:
    if not isinstance(storage, _Storage):
        raise Refused("a tensor has no storage")
    # Two dimensions at most, checked before anything reads the elements.
    fits = isinstance(shape, tuple) and isinstance(stride, tuple) and len(shape) == len(stride) <= 2
    if not fits or not all(map(_is_count, (offset, *shape, *stride))):
        raise Refused("a tensor has a wrong offset, shape or stride")
    return _Tensor(storage, offset, shape, stride)


def _encoded(text: Any, encoding: Any) -> bytes:
    if not isinstance(text, str) or len(text) > _LONGEST_TEXT or encoding != "latin1":
        raise Refused("it contains text that is too long or in an unknown encoding")
    return text.encode("latin1")


def _numpy_text(_dtype: Any, data: Any) -> str:
    """Decode a NumPy string: four bytes a character, padded with zeros."""
    if not isinstance(data, bytes):
        raise Refused("it contains a NumPy number where text should be")
    return data.decode("utf-32-le").rstrip("\0")


def _nothing(*_: Any) -> None:
    """Stand in for an unused object."""


#: Functions that a name in the pickle calls here. The real functions are never looked up.
_CALLS: Mapping[str, Callable[..., Any]] = {
    "torch._utils._rebuild_tensor_v2": _rebuilt_tensor,
    "_codecs.encode": _encoded,
    "numpy.core.multiarray.scalar": _numpy_text,
    "numpy.core.multiarray._reconstruct": _nothing,
    "numpy.dtype": _nothing,
    "collections.OrderedDict": _nothing,
}
#: Names that are only referred to.
_MENTIONED = re.compile(r"numpy\.ndarray|torch\.[A-Z][a-z]+Storage")

_INSTRUCTIONS = (
    "PROTO FRAME STOP MARK NONE NEWTRUE NEWFALSE BININT BININT1 BININT2 LONG1 BINUNICODE "
    "SHORT_BINUNICODE EMPTY_TUPLE TUPLE1 TUPLE2 TUPLE3 TUPLE SETITEM SETITEMS BINPUT LONG_BINPUT "
    "MEMOIZE BINGET LONG_BINGET GLOBAL REDUCE BINPERSID"
)


class _Instructions(dict[int, Callable[[Any], None]]):
    """Opcode -> its action; any other opcode ends the reading."""

    def __missing__(self, code: int) -> Callable[[Any], None]:
        names = [opcode.name for opcode in pickletools.opcodes if opcode.code == chr(code)]
        raise Refused(f"it uses the instruction {names[0]}" if names else "it is damaged")


class _Unpickler(pickle._Unpickler):
    """Python's unpickler, reduced to what builds dictionaries of tensors."""

    dispatch = _Instructions(
        (code, pickle._Unpickler.dispatch[code])
        for code in (getattr(pickle, name)[0] for name in _INSTRUCTIONS.split())
    )
    dispatch[pickle.EMPTY_DICT[0]] = lambda self: self.append(_Texts())
    # The contents of NumPy objects are not needed, and setting them could change anything.
    dispatch[pickle.BUILD[0]] = lambda self: self.stack.pop()

    def find_class(self, module: str, name: str) -> Any:
        """Return the stand-in for a name: a function of ours, or its own text."""
        full = f"{module}.{name}".replace("numpy._core.", "numpy.core.")
        if full in _CALLS:
            return _CALLS[full]
        if _MENTIONED.fullmatch(full):
            return full
        raise Refused(f"it names {shortened(full)}")

    def persistent_load(self, pid: Any) -> _Storage:
        """Record which member contains a storage."""
        kind, name, key, _device, n = pid
        if kind != "storage" or not isinstance(name, str):
            raise Refused("it refers to something outside the file")
        if not isinstance(key, str) or not key.isdecimal() or not _is_count(n):
            raise Refused("a storage has a wrong name or size")
        return _Storage(name, key, n)


def read_inert(data: bytes) -> Any:
    """Read a pickle of dictionaries of tensors as plain data, without running it."""
    if len(data) > _LONGEST:
        raise Refused(f"its pickle is longer than {_LONGEST} bytes")
    try:
        return _Unpickler(io.BytesIO(data)).load()
    except Refused:
        raise
    # Damage can make the unpickler fail in any way.
    except Exception as error:
        raise Refused("it is damaged") from error


def read_authors_experiment(path: str | os.PathLike[str], *, name: str | None = None) -> Trajectory:
    """Read a ``data.pt`` of the authors; the pickle inside is never run.

    Parameters
    ----------
    path : path-like
        The file, or the folder that contains ``data.pt``.
    name : str, optional
        Name of the experiment, if the file contains several.

    Returns
    -------
    Trajectory
        The authors' smoothed states and accelerations. Their commands are already held at the pose
        times and shifted by the transport delay, so `delay` is zero and `delay_known` false.

    Raises
    ------
    InputError
        If the file is not of this kind, or contains anything but the expected float64 tensors of
        matching shapes, with finite values, increasing times and commands in [0, 1].
    """
    file = Path(path)
    if file.is_dir():
        file = file / "data.pt"
    fingerprint = sha256(file)
    with (
        # A damaged archive can make zipfile fail in any way.
        explained(Exception, "is not a readable torch file; is it damaged?", file=file),
        explained(Refused, "is not an experiment of the authors: {error}", file=file),
        within_means(file),
    ):
        tensors = _read(file, name)
    time, state = tensors["T"], tensors["X"]
    with np.errstate(invalid="ignore"):  # the trajectory checks its numbers
        state[:, 2] = np.unwrap(state[:, 2])
    return Trajectory(
        time=time,
        state=state,
        acceleration=np.ascontiguousarray(tensors["dX"][:, 3:]),
        command_time=time,
        command=tensors["U"],
        propellers=HOLOHOVER_MOTORS,
        delay_known=False,
        source=str(file),
        hashes={file.name: fingerprint},
    )


def _read(file: Path, name: str | None) -> dict[str, Float[np.ndarray, "..."]]:
    """Return the tensors of one experiment."""
    with Archive(file) as archive:
        pickles = [name for name in set(archive.names) if name.endswith("/data.pkl")]
        if len(pickles) != 1:
            raise Refused("a torch file has one data.pkl inside")
        # Torch never compresses; uncompressed members cannot exceed the file's size.
        if archive.is_packed():
            raise Refused("its content is compressed")
        root = pickles[0].removesuffix("data.pkl")
        order = b"little"
        if f"{root}byteorder" in archive.names:
            order = bytes(archive.read(f"{root}byteorder", _LONGEST)).strip()
        dtype = {b"little": "<f8", b"big": ">f8"}.get(order)
        if dtype is None:
            raise Refused("its byte order is unknown")
        described = _choose(read_inert(bytes(archive.read(pickles[0], _LONGEST))), name)
        return {
            key: _tensor(archive, f"{root}data/", dtype, key, tensor)
            for key, tensor in described.items()
        }


def _choose(content: Any, name: str | None) -> dict[str, _Tensor]:
    """Choose one experiment from the file's dictionary."""
    for key in ("exps", *_SHAPES):
        if not isinstance(content, dict) or key not in content:
            raise Refused(f"it has no {key!r}")
        if key != "exps" and not isinstance(content[key], dict):
            raise Refused(f"{key!r} is not a dictionary of experiments")
    names = list(content["T"])
    if any(set(content[key]) != set(names) for key in _SHAPES):
        raise Refused("its tensors are not of the same experiments")
    if name is None and len(names) != 1:
        raise Refused(
            f"it contains {len(names)} experiments; choose one by name ({listing(names)})"
        )
    if name is not None and name not in names:
        problem = f"it contains no experiment {name!r} ({listing(names)})"
        raise Refused(problem + nearest(name, names))
    tensors = {key: content[key][name or names[0]] for key in _SHAPES}
    for key, tensor in tensors.items():
        if not isinstance(tensor, _Tensor):
            raise Refused(f"{key!r} holds something other than a tensor")
        if not tensor.shape or tensor.shape != tensors["T"].shape[:1] + _SHAPES[key]:
            raise Refused(f"{key!r} has the shape {tensor.shape}")
    return tensors


def _tensor(
    archive: Archive, folder: str, dtype: str, key: str, tensor: _Tensor
) -> Float[np.ndarray, "..."]:
    """Read one tensor's numbers."""
    storage, offset, shape, stride = tensor
    if storage.kind != "torch.DoubleStorage":
        raise Refused(f"{key!r} is a {storage.kind}, not torch.DoubleStorage")
    if folder + storage.key not in archive.names:
        raise Refused(f"the storage of {key!r} is missing")
    content = archive.read(folder + storage.key)
    if len(content) != 8 * storage.n:
        raise Refused(f"the storage of {key!r} has a wrong length")
    elements = math.prod(shape)
    reach = offset + sum((size - 1) * step for size, step in zip(shape, stride, strict=True))
    # An expanded tensor (stride 0) would claim more elements than there are bytes for.
    if elements == 0 or elements > storage.n or reach >= storage.n:
        raise Refused(f"{key!r} is empty or reaches beyond its storage")
    flat = np.frombuffer(content, dtype).astype(np.float64, copy=False)
    strides = tuple(8 * step for step in stride)
    # A copy, because the trajectory must own the numbers, and the strides refer to shared memory.
    return np.lib.stride_tricks.as_strided(flat[offset:], shape, strides).copy()
