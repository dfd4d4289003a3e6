"""Archives as torch writes them, instruction by instruction, without torch."""

import struct
import zipfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np

NAME = "experiments/sysid_h1"


def text(value: str) -> bytes:
    data = value.encode()
    return b"X" + struct.pack("<I", len(data)) + data


def integer(value: int) -> bytes:
    raw = value.to_bytes(9, "little", signed=True)
    return b"\x8a" + bytes([len(raw)]) + raw


def integers(values) -> bytes:
    return b"(" + b"".join(integer(value) for value in values) + b"t"


def tensor(key: str, n: int, shape, stride=None, *, offset: int = 0, kind: str = "Double") -> bytes:
    """A tensor as torch pickles it, instruction by instruction."""
    if stride is None:
        stride = [int(np.prod(shape[i + 1 :])) for i in range(len(shape))]
    storage = b"(" + text("storage") + f"ctorch\n{kind}Storage\n".encode() + text(key)
    storage += text("cpu") + integer(n) + b"tQ"
    arguments = b"(" + storage + integer(offset) + integers(shape) + integers(stride)
    arguments += b"\x89ccollections\nOrderedDict\n)Rt"
    return b"ctorch._utils\n_rebuild_tensor_v2\n" + arguments + b"R"


def dictionary(items: Mapping[str, bytes]) -> bytes:
    return b"}(" + b"".join(text(key) + value for key, value in items.items()) + b"u"


def good_arrays(n: int = 50) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(1)
    return {
        "T": 0.004166 * np.arange(n),
        "X": rng.uniform(-1, 1, (n, 6)),
        "U": rng.uniform(0, 1, (n, 6)),
        "dX": rng.normal(size=(n, 6)),
    }


def archive(
    path: Path,
    arrays: Mapping[str, np.ndarray] | None = None,
    *,
    tensors: Mapping[str, bytes] | None = None,
    without: str = "",
    members: Mapping[str, bytes] | None = None,
    data_pickle: bytes | None = None,
    compression: int = zipfile.ZIP_STORED,
    names: tuple[str, ...] = (NAME,),
) -> Path:
    """A file as torch writes it, without torch; any part of it can be replaced."""
    arrays = good_arrays() if arrays is None else arrays
    parts = {
        key: tensor(str(index), array.size, array.shape)
        for index, (key, array) in enumerate(arrays.items())
    }
    parts.update(tensors or {})
    content = {"exps": text("names")}
    content |= {key: dictionary(dict.fromkeys(names, part)) for key, part in parts.items()}
    content.pop(without, None)
    files = {"data/data.pkl": b"\x80\x02" + dictionary(content) + b"."}
    if data_pickle is not None:
        files["data/data.pkl"] = data_pickle
    files["data/byteorder"] = b"little"
    for index, array in enumerate(arrays.values()):
        files[f"data/data/{index}"] = array.astype("<f8").tobytes()
    files |= members or {}
    with zipfile.ZipFile(path, "w", compression) as target:
        for name, data in files.items():
            target.writestr(name, data)
    return path
