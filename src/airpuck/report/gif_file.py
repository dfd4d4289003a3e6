"""Writing a GIF frame by frame: small, and never more than two frames in memory."""

from __future__ import annotations

import struct
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import UInt8, UInt32
from PIL import GifImagePlugin, Image

#: Colours of a palette, and how many of them are the commonest; the last entry says "as before".
_COLORS, _EXACT, _UNCHANGED = 255, 64, 255
_LOOP_FOREVER = b"!\xff\x0bNETSCAPE2.0\x03\x01\x00\x00\x00"


def write_gif(
    path: Path,
    pictures: Iterable[UInt8[np.ndarray, "height width 3"]],
    samples: Sequence[UInt8[np.ndarray, "height width 3"]],
    colors: Sequence[tuple[int, int, int]],
    frames_per_second: float,
) -> None:
    """Write pictures as an animation that repeats for ever.

    All pictures share one palette, and each holds only what has changed since the one before.
    """
    palette = _Palette(samples, colors)
    with path.open("wb") as file:
        before = None
        for number, picture in enumerate(pictures):
            now = palette.indices(picture)
            if before is None:
                height, width = now.shape
                file.write(b"GIF89a" + struct.pack("<HHBBB", width, height, 0xF7, 0, 0))
                file.write(bytes(palette) + _LOOP_FOREVER)
            ticks = _ticks(number + 1, frames_per_second) - _ticks(number, frames_per_second)
            file.writelines(_block(before, now, 10 * ticks))
            before = now
        file.write(b";")


class _Palette:
    """Up to 255 colours, and for every colour which of them is nearest."""

    def __init__(
        self,
        samples: Sequence[UInt8[np.ndarray, "height width 3"]],
        wanted: Sequence[tuple[int, int, int]],
    ) -> None:
        together = np.concatenate(samples)
        codes, counts = np.unique(_codes(together), return_counts=True)
        common = _unpacked(codes[np.argsort(-counts, kind="stable")[:_EXACT]])
        exact = np.concatenate([np.array(wanted, dtype=np.uint8).reshape(-1, 3), common])
        mixed = Image.fromarray(together).quantize(_COLORS - len(exact), dither=Image.Dither.NONE)
        others = np.array(mixed.getpalette(), dtype=np.uint8).reshape(-1, 3)
        self.colors = np.concatenate([exact, others])[:_COLORS]
        # Pillow looks colours up coarsely, which tints white; this table is exact. It fills as
        # colours come up.
        self._nearest = np.full(2**24, _UNCHANGED, dtype=np.uint8)

    def __bytes__(self) -> bytes:
        return self.colors.tobytes().ljust(3 * 256, b"\0")

    def indices(
        self, picture: UInt8[np.ndarray, "height width 3"]
    ) -> UInt8[np.ndarray, "height width"]:
        """Return the number of the nearest colour for every pixel."""
        codes = _codes(picture)
        indices = self._nearest[codes]
        new = indices == _UNCHANGED
        if new.any():
            unknown = np.unique(codes[new])
            apart = _unpacked(unknown)[:, None].astype(np.int32) - self.colors
            self._nearest[unknown] = (apart**2).sum(axis=2).argmin(axis=1)
            indices = self._nearest[codes]
        return indices


def _codes(
    picture: UInt8[np.ndarray, "height width 3"],
) -> UInt32[np.ndarray, "height width"]:
    """Return one number for the colour of each pixel."""
    red, green, blue = np.moveaxis(picture.astype(np.uint32), 2, 0)
    return (red << 16) | (green << 8) | blue


def _unpacked(codes: UInt32[np.ndarray, " colors"]) -> UInt8[np.ndarray, "colors 3"]:
    """Return red, green, blue of numbers made by `_codes`."""
    return np.stack([codes >> 16, (codes >> 8) & 255, codes & 255], axis=1).astype(np.uint8)


def _ticks(number: int, frames_per_second: float) -> int:
    """Return when a frame appears, in hundredths of a second."""
    return round(100 * number / frames_per_second)


def _block(
    before: UInt8[np.ndarray, "height width"] | None,
    now: UInt8[np.ndarray, "height width"],
    milliseconds: int,
) -> list[bytes]:
    """Return the encoded rectangle around what has changed."""
    left = top = 0
    about: dict[str, Any] = {"duration": milliseconds, "disposal": 1}
    if before is not None:
        changed = now != before
        rows, columns = np.flatnonzero(changed.any(axis=1)), np.flatnonzero(changed.any(axis=0))
        if len(rows) == 0:  # a frame must have some pixel
            rows = columns = np.zeros(1, dtype=int)
        top, left = int(rows[0]), int(columns[0])
        window = slice(top, rows[-1] + 1), slice(left, columns[-1] + 1)
        now = np.where(changed[window], now[window], np.uint8(_UNCHANGED))
        about["transparency"] = _UNCHANGED
    return GifImagePlugin.getdata(Image.fromarray(now, mode="P"), (left, top), **about)
