"""Limits on input from outside, each with its reason, and the functions that enforce them.

A file can claim any size, and a small one can unpack to any size. So sizes, counts and depth are
bounded before anything is allocated, and unpacked bytes are counted while they stream, whatever a
header says. Every limit lies several times above an hour of flight (864 000 poses, 216 000
commands).
"""

from __future__ import annotations

import codecs
import contextlib
import csv
import hashlib
import io
import os
import stat
import zipfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, TextIO

from airpuck.boundary.errors import InputError, explained

MIB = 2**20

#: Maximum size of a TOML or JSON file [bytes]. A model of 20 propellers with its covariance takes
#: 0.4 MB.
TEXT_BYTES = 2 * MIB
#: Maximum size of a recorder's metadata.yaml [bytes]; its parser reads 30 kB/s at worst. 100 topics
#: take 70 kB.
YAML_BYTES = 128 * 1024
#: Maximum number of keys in a text file. A model file has 100; with 100 propellers it has 500.
KEYS = 10_000
#: Maximum number of values in a text file. A covariance of 300 parameters has 90 000.
VALUES = 200_000
#: Largest nesting depth of tables and arrays, and of dotted names. Ours are four deep.
DEPTH = 32
#: Size of whole numbers that NumPy and other readers of TOML and JSON can hold [bits].
INTEGER_BITS = 64

#: Maximum number of files and folders in a hashed folder: a recording has a few, a user's package
#: hundreds.
FOLDER_FILES = 5_000

#: Maximum number of propellers: model matrices grow with its square.
PROPELLERS = 256

#: Maximum unpacked size of a .npz or .pt archive [bytes]: a few hours of flight.
ARCHIVE_BYTES = 2**30
#: Maximum size of an archive's directory, and of the part read at once [bytes]. Ours have seven
#: members.
ARCHIVE_READ = MIB
#: Maximum size of text inside an archive [bytes].
ABOUT_BYTES = 4 * MIB
#: Maximum number of excluded spans of a trajectory; one fault a second makes 3600 an hour.
SPANS = 100_000

#: Largest unpacked size of a chunk in a bag [bytes]. Recorders close chunks at 0.8 to 8 MB, but a
#: larger message has its own chunk.
CHUNK_BYTES = 256 * MIB
#: Largest unpacked size of all chunks in a bag: a constant [bytes] plus a multiple of the file's
#: size. Zstandard compresses poses and commands by a factor of 3 to 10.
UNPACKED_BYTES = 256 * MIB
UNPACKED_RATIO = 100
#: Every record counts for at least this size [bytes], since handling it takes time and memory.
RECORD_BYTES = 256
#: Maximum size of a message [bytes]; an odometry message has 720.
MESSAGE_BYTES = MIB
#: Maximum size of a bag's index [bytes]; 100 GB in chunks of 0.8 MB have an index of 11 MB.
INDEX_BYTES = 16 * MIB
#: Maximum number of topics in a bag. The largest robots have a few hundred.
TOPICS = 10_000
#: Maximum number of definitions of one topic; each publisher may have its own.
DEFINITIONS = 100

#: Maximum size of a message definition with all nested types [bytes]. Odometry takes 3 kB.
DEFINITION_BYTES = 32 * 1024
#: Maximum number of fields in a definition: rosbags generates code for each, in 2 ms.
DEFINITION_SIZE = 2_000
#: Maximum number of fields in a message, including nested types; repeated fields count each time.
FIELDS = 10_000

#: Maximum number of columns in a CSV file. Motion capture with all markers has up to a few
#: thousand.
COLUMNS = 10_000
#: Maximum number of characters in a row of a CSV file.
ROW_LENGTH = MIB
#: Maximum size of a file in a public data set [bytes]; a download cannot be hashed before its end.
DOWNLOAD_BYTES = 2**30
#: Maximum number of cells in a CSV file: two hours of poses in the authors' 13 columns.
CELLS = 24_000_000
#: Maximum size of a CSV file [bytes]; an hour of poses takes 0.2 GB.
CSV_BYTES = 2**30


def refused(
    what: str,
    most: float,
    remedy: str,
    *,
    file: str | os.PathLike[str] | None = None,
    field: str | None = None,
) -> InputError:
    """Return the error for something above a limit."""
    limit = f"{most / MIB:g} MiB" if most >= MIB and most % MIB == 0 else f"{most:,}"
    return InputError(f"{what}, more than the limit of {limit}; {remedy}", file=file, field=field)


@contextlib.contextmanager
def within_means(file: str | os.PathLike[str]) -> Iterator[None]:
    """Convert errors that a hostile file within the limits can cause into a one-line InputError."""
    too_large = "needs more memory than is available; split it into parts, or free some memory"
    too_deep = f"is nested more than {DEPTH} deep; flatten it"
    with (
        explained(MemoryError, too_large, file=file),
        explained(RecursionError, too_deep, file=file),
    ):
        yield


@contextlib.contextmanager
def _reading(path: str | os.PathLike[str]) -> Iterator[None]:
    """Convert errors of the file system into a one-line InputError."""
    # A name with a null byte is a ValueError.
    with explained((OSError, ValueError), "cannot be read ({error})", file=path):
        try:
            yield
        except FileNotFoundError:
            raise InputError("there is no such file", file=path) from None
        except IsADirectoryError:
            raise InputError("is a folder; a file is expected", file=path) from None


def sha256(path: str | os.PathLike[str]) -> str:
    """Return the SHA-256 of a file, which traces results back to their data."""
    with _reading(path):
        if not stat.S_ISREG(Path(path).stat().st_mode):
            raise InputError("cannot be read (it is not a regular file)", file=path)
        with Path(path).open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()


def read_bytes(path: str | os.PathLike[str], most: int) -> bytes:
    """Read a whole file up to a maximum length, which also cuts off devices and pipes."""
    with _reading(path), Path(path).open("rb") as file:
        content = file.read(most + 1)
    if len(content) > most:
        raise refused("is too long", most, "is it the right file?", file=path)
    return content


def read_text(path: str | os.PathLike[str], most: int = TEXT_BYTES) -> str:
    """Read a whole text file up to a maximum length, skipping a byte-order mark."""
    try:
        return read_bytes(path, most).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(_not_utf8(error), file=path) from error


def text_encoding(path: Path) -> str:
    """Return the encoding of a table: UTF-16, as Excel's "Unicode text", or UTF-8."""
    with path.open("rb") as file:
        start = file.read(4)
    if start.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return "utf-16"
    nulls = tuple(place for place, byte in enumerate(start) if not byte)
    if nulls in ((1, 3), (0, 2)):
        return "utf-16-be" if nulls[0] == 0 else "utf-16-le"
    return "utf-8-sig"


def _not_utf8(error: UnicodeError) -> str:
    """Describe a file that is not UTF-8 text."""
    reason = getattr(error, "reason", error)
    return f"is not UTF-8 text ({reason}); save it as UTF-8, or is it the right file?"


def check_tree(content: Any, *, file: str | os.PathLike[str]) -> None:
    """Raise InputError if tables and arrays are too many or too deep, or an integer is too long."""
    values = keys = 0
    level = [content]
    # Breadth first: no recursion, and repeated aliases are counted each time.
    for _ in range(DEPTH):
        below = []
        for value in level:
            if isinstance(value, Mapping):
                keys += len(value)
                below += value.values()
            elif isinstance(value, list | tuple):
                below += value
            elif isinstance(value, int) and value.bit_length() > INTEGER_BITS:
                raise InputError(
                    f"contains a whole number of more than {INTEGER_BITS} bits; is it damaged?",
                    file=file,
                )
            if len(below) + values > VALUES:
                raise refused(
                    "contains too many values", VALUES, "is it the right file?", file=file
                )
        if keys > KEYS:
            raise refused("contains too many keys", KEYS, "is it the right file?", file=file)
        values += len(below)
        level = below
        if not level:
            return
    raise InputError(f"is nested more than {DEPTH} deep; flatten it", file=file)


class _ShortReads(io.FileIO):
    """A file that refuses to read long stretches at once."""

    def read(self, size: int | None = -1, /) -> bytes:
        """Read some bytes."""
        if size is not None and size > ARCHIVE_READ + zipfile.ZipExtFile.MIN_READ_SIZE:
            raise ValueError("its list of members is too long")
        return super().read(-1 if size is None else size)


class Archive:
    """A zip file whose members are read in blocks, up to a limit for all of them together."""

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self._path = path
        self._left = ARCHIVE_BYTES
        # Python's reader loads the whole directory of members; only that is bounded by this.
        self._file = _ShortReads(path)
        try:
            self._zip = zipfile.ZipFile(self._file)
        except BaseException:
            self._file.close()
            raise
        self.names = self._zip.namelist()

    def __enter__(self) -> Archive:
        return self

    def __exit__(self, *_: object) -> None:
        self._zip.close()
        self._file.close()

    def read(self, name: str, most: int = ARCHIVE_BYTES) -> bytearray:
        """Read a member, counting unpacked bytes; KeyError for an unknown name."""
        member = self._zip.getinfo(name)
        if member.flag_bits & 1:
            raise InputError("is encrypted; store it decrypted", file=self._path, field=name)
        if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            raise InputError(
                "is packed by a method other than deflate; store it again",
                file=self._path,
                field=name,
            )
        content = bytearray()
        # Python's reader stops where the directory says that the member ends.
        if member.file_size <= min(most, self._left):
            with self._zip.open(member) as stream:
                while block := stream.read(ARCHIVE_READ):
                    content += block
        if max(member.file_size, len(content)) > min(most, self._left):
            remedy = "cut the recording into parts"
            raise refused("unpacks to too much", most, remedy, file=self._path, field=name)
        self._left -= len(content)
        return content

    def is_packed(self) -> bool:
        """Return whether any member is compressed."""
        return any(info.compress_type != zipfile.ZIP_STORED for info in self._zip.infolist())


class Unpacking:
    """Counts the unpacked bytes and the records of a bag."""

    def __init__(self, path: str | os.PathLike[str], size: int) -> None:
        self._path = path
        self._most = UNPACKED_BYTES + UNPACKED_RATIO * size
        self._spent = 0

    @property
    def records_left(self) -> int:
        """Number of records that may still be handled."""
        return (self._most - self._spent) // RECORD_BYTES

    def spend(self, n_bytes: int, n_records: int = 0) -> None:
        """Count unpacked bytes or handled records; raise InputError beyond the limit."""
        self._spent += max(n_bytes, RECORD_BYTES * n_records)
        if self._spent > self._most:
            raise refused(
                f"unpacks to more than {UNPACKED_RATIO} times its size, or to too many records",
                self._most // MIB * MIB,
                "record it again, or split it",
                file=self._path,
            )


def csv_rows(path: Path, separator: str = ",") -> Iterator[tuple[int, list[str]]]:
    """Yield the non-empty lines of a CSV file, each with its line number."""
    unfinished = cells = 0

    def lines(file: TextIO) -> Iterator[str]:
        nonlocal unfinished
        while line := file.readline(ROW_LENGTH + 1):
            # Quoted text may contain line breaks, so a row can span any number of lines.
            unfinished += len(line)
            if unfinished > ROW_LENGTH:
                raise refused("has too long a line", ROW_LENGTH, "is it the right file?", file=path)
            yield line

    try:
        if path.stat().st_size > CSV_BYTES:
            raise refused("is too long", CSV_BYTES, "cut it into parts", file=path)
        with path.open(encoding=text_encoding(path), newline="") as file:
            reader = csv.reader(lines(file), delimiter=separator)
            try:
                for row in reader:
                    unfinished = 0
                    cells += len(row)
                    if len(row) > COLUMNS:
                        remedy = "keep only those that are needed"
                        raise refused("has too many columns", COLUMNS, remedy, file=path)
                    if cells > CELLS:
                        raise refused("has too many cells", CELLS, "cut it into parts", file=path)
                    if row:
                        yield reader.line_num, row
            except csv.Error as error:
                raise InputError(f"line {reader.line_num}: {error}", file=path) from error
    # A byte-order mark may be missing in a damaged file.
    except UnicodeError as error:
        raise InputError(_not_utf8(error), file=path) from error
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror})", file=path) from error
