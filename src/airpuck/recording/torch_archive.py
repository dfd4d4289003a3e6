"""The authors' preprocessed experiments: a torch file, read without torch."""

from __future__ import annotations

import math
import os
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from airpuck.boundary.errors import InputError
from airpuck.data.trajectory import Trajectory
from airpuck.recording.fingerprint import sha256
from airpuck.recording.inert_pickle import Refused, Tensor, read_inert
from airpuck.recording.listing import listing
from airpuck.recording.message_types import HOLOHOVER_MOTORS

_TENSORS = ("T", "X", "U", "dX")
#: A command may lie outside [0, 1] by rounding.
_ROUNDING = 1e-9


def read_authors_experiment(path: str | os.PathLike[str], *, name: str | None = None) -> Trajectory:
    """Read a ``data.pt`` of the authors.

    The pickle inside is interpreted as data; nothing that it contains is run.

    Parameters
    ----------
    path : path-like
        The file, or the folder that holds it as ``data.pt``.
    name : str, optional
        Which experiment, where the file holds several.

    Returns
    -------
    Trajectory
        The authors' smoothed states and accelerations. Their commands are already held at the pose
        times and shifted by the transport delay, so that `delay` is zero and `delay_known` false.

    Raises
    ------
    InputError
        If it is no such file, or holds anything but the expected float64 tensors of matching
        shapes, with finite values, increasing times and commands in [0, 1].
    """
    file = Path(path)
    if file.is_dir():
        file = file / "data.pt"
    fingerprint = sha256(file)
    try:
        tensors = _read(file, name)
    except Refused as error:
        raise InputError(f"is not an experiment of the authors: {error}", file=file) from error
    # zipfile raises all of these on damaged files; nothing else of ours can.
    except (
        zipfile.BadZipFile,
        zlib.error,
        OSError,
        EOFError,
        ValueError,
        KeyError,
        IndexError,
        NotImplementedError,
        RuntimeError,
        OverflowError,
    ) as error:
        raise InputError("is not a readable torch file; is it damaged?", file=file) from error
    time, state, command, derivative = (tensors[key] for key in _TENSORS)
    _check(file, time, state, command, derivative)
    yaw = state[:, 2]
    if np.abs(np.diff(yaw)).max() > np.pi:
        state[:, 2] = np.unwrap(yaw)
    return Trajectory(
        time=time,
        state=state,
        acceleration=np.ascontiguousarray(derivative[:, 3:]),
        command_time=time,
        command=command,
        propellers=HOLOHOVER_MOTORS,
        delay=0.0,
        delay_known=False,
        source=str(file),
        hashes={file.name: fingerprint},
    )


def _read(file: Path, name: str | None) -> dict[str, Float[np.ndarray, "..."]]:
    """Return the tensors of one experiment."""
    with zipfile.ZipFile(file) as archive:
        members = {member.filename: member for member in archive.infolist()}
        pickles = [member for member in members if member.endswith("/data.pkl")]
        if len(pickles) != 1:
            raise Refused("a torch file has one data.pkl inside")
        # Torch never compresses; stored members cannot be larger than the file.
        if any(member.compress_type != zipfile.ZIP_STORED for member in members.values()):
            raise Refused("its content is compressed")
        root = pickles[0].removesuffix("data.pkl")
        order = "little"
        if f"{root}byteorder" in members:
            order = archive.read(f"{root}byteorder").decode("ascii", "replace").strip()
        if order not in ("little", "big"):
            raise Refused("its byte order is unknown")
        content = read_inert(archive.read(pickles[0]))
        described = _choose(content, name)
        return {
            key: _tensor(archive, f"{root}data/", order, key, tensor)
            for key, tensor in described.items()
        }


def _choose(content: Any, name: str | None) -> dict[str, Tensor]:
    """Pick one experiment out of the file's dictionary."""
    for key in ("exps", *_TENSORS):
        if not isinstance(content, dict) or key not in content:
            raise Refused(f"it has no {key!r}")
        if key != "exps" and not isinstance(content[key], dict):
            raise Refused(f"{key!r} is not a dictionary of experiments")
    names = list(content["T"])
    shown = listing(names)
    if any(set(content[key]) != set(names) for key in _TENSORS):
        raise Refused("its tensors are not of the same experiments")
    if name is None and len(names) != 1:
        raise Refused(f"it holds {len(names)} experiments; choose one by name ({shown})")
    if name is not None and name not in names:
        raise Refused(f"it holds no experiment {name!r} ({shown})")
    chosen = names[0] if name is None else name
    tensors = {key: content[key][chosen] for key in _TENSORS}
    for key, tensor in tensors.items():
        if not isinstance(tensor, Tensor):
            raise Refused(f"{key!r} holds something else than a tensor")
    return tensors


def _tensor(
    archive: zipfile.ZipFile, folder: str, order: str, key: str, tensor: Tensor
) -> Float[np.ndarray, "..."]:
    """Read one tensor's numbers."""
    storage = tensor.storage
    if storage.kind != "torch.DoubleStorage":
        raise Refused(f"{key!r} is a {storage.kind}, not torch.DoubleStorage")
    member = archive.NameToInfo.get(folder + storage.key)
    if member is None or member.file_size != 8 * storage.n:
        raise Refused(f"the storage of {key!r} is missing or has a wrong length")
    elements = math.prod(tensor.shape)
    reach = tensor.offset + sum(
        (size - 1) * step for size, step in zip(tensor.shape, tensor.stride, strict=True)
    )
    # An expanded tensor (stride 0) would claim more elements than there are bytes for.
    if elements == 0 or elements > storage.n or reach >= storage.n:
        raise Refused(f"{key!r} is empty or reaches beyond its storage")
    dtype = "<f8" if order == "little" else ">f8"
    flat = np.frombuffer(archive.read(member), dtype).astype(np.float64)
    strides = tuple(8 * step for step in tensor.stride)
    # A copy, because the trajectory must own what the strides only point to.
    view = np.lib.stride_tricks.as_strided(flat[tensor.offset :], tensor.shape, strides)
    return view.copy()


def _check(
    file: Path,
    time: np.ndarray,
    state: np.ndarray,
    command: np.ndarray,
    derivative: np.ndarray,
) -> None:
    """Refuse tensors that cannot be a flight."""
    n = len(time)
    if time.ndim != 1 or n < 2:
        raise InputError(f"has the shape {time.shape}, not (N,)", file=file, field="T")
    widths = (("X", state, 6), ("U", command, len(HOLOHOVER_MOTORS)), ("dX", derivative, 6))
    for key, values, width in widths:
        if values.shape != (n, width):
            raise InputError(
                f"has the shape {values.shape}, not ({n}, {width})", file=file, field=key
            )
    for key, values in (("T", time), ("X", state), ("U", command), ("dX", derivative)):
        if not np.isfinite(values).all():
            row = int(np.argwhere(~np.isfinite(values))[0][0])
            raise InputError(f"row {row} is not a finite number", file=file, field=key)
    if not (np.diff(time) > 0).all():
        row = int(np.argmin(np.diff(time) > 0)) + 1
        raise InputError(f"time does not increase at row {row}", file=file, field="T")
    if command.min() < -_ROUNDING or command.max() > 1 + _ROUNDING:
        raise InputError(
            f"commands reach from {command.min():g} to {command.max():g}, not within [0, 1]",
            file=file,
            field="U",
        )
