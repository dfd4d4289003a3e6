"""Zstandard and LZ4 within limits: what is unpacked is counted, whatever its header says."""

from __future__ import annotations

import contextlib
import tempfile
from collections.abc import Iterator
from pathlib import Path

from airpuck.boundary.errors import InputError
from airpuck.boundary.limits import CHUNK_BYTES, MESSAGE_BYTES, MIB, Unpacking


def unpacked(data: bytes, compression: str, size: int) -> bytes:
    """Unpack a chunk to its size; ValueError where it has another one or is damaged."""
    if compression == "zstd":
        import zstandard

        # A decompressor takes as much memory as its window, up to the size of what it unpacks.
        decompressor = zstandard.ZstdDecompressor(max_window_size=CHUNK_BYTES)
        try:
            content = decompressor.stream_reader(data).read(size + 1)
        except zstandard.ZstdError as error:
            raise ValueError("it is damaged") from error
    elif compression == "lz4":
        import lz4.frame

        try:
            content = lz4.frame.LZ4FrameDecompressor().decompress(data, size + 1)
        except RuntimeError as error:
            raise ValueError("it is damaged") from error
    elif compression:
        raise ValueError("it is packed by an unknown method")
    else:
        content = data
    if len(content) != size:
        raise ValueError("its size is not the one it names")
    return content


def unpacked_message(data: bytes) -> bytes:
    """Unpack a message that rosbag2 compressed on its own."""
    import zstandard

    try:
        content = zstandard.ZstdDecompressor().stream_reader(data).read(MESSAGE_BYTES + 1)
    except zstandard.ZstdError as error:
        raise ValueError("it holds a message that cannot be unpacked") from error
    if len(content) > MESSAGE_BYTES:
        raise ValueError(f"it holds a message that unpacks to more than {MESSAGE_BYTES:,} bytes")
    return content


@contextlib.contextmanager
def unpacked_file(path: Path) -> Iterator[Path]:
    """Unpack a storage file that rosbag2 compressed whole, for as long as the block lasts."""
    import zstandard

    budget = Unpacking(path, path.stat().st_size)
    with tempfile.TemporaryDirectory() as folder:
        plain = Path(folder, path.stem)
        try:
            with path.open("rb") as source, plain.open("wb") as target:
                stream = zstandard.ZstdDecompressor().stream_reader(source, read_across_frames=True)
                while block := stream.read(MIB):
                    budget.spend(len(block))
                    target.write(block)
        except zstandard.ZstdError as error:
            raise InputError(f"is not a readable recording ({error})", file=path) from error
        yield plain
