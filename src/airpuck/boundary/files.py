"""Checked TOML files, and files that are replaced in one step: never half written."""

from __future__ import annotations

import contextlib
import json
import os
import re
import secrets
import stat
import tempfile
from collections.abc import Iterator, Mapping
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import pydantic

from airpuck.boundary.errors import InputError
from airpuck.boundary.parsing import load_toml

Schema = TypeVar("Schema", bound=pydantic.BaseModel)
#: What a user asks to be written. A new folder may exist if it is empty.
Output = Literal["file", "folder", "new folder"]

Positive = Annotated[float, pydantic.Field(gt=0)]
NonNegative = Annotated[float, pydantic.Field(ge=0)]
#: Between 0 and 1.
Fraction = Annotated[float, pydantic.Field(ge=0, le=1)]


class Section(pydantic.BaseModel):
    """Base of every table in our TOML files: immutable, and an unknown key is an error."""

    model_config = pydantic.ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


def read_toml(
    path: str | os.PathLike[str], schema: type[Schema], *, base: Schema | None = None
) -> Schema:
    """Read a TOML file and check it against a schema; what it leaves out is as in `base`."""
    content = load_toml(path)
    if base is not None:
        content = laid_over(base.model_dump(mode="json"), content)
    return checked(content, schema, file=path)


def read_packaged(name: str, schema: type[Schema]) -> Schema:
    """Read a TOML file that comes with the package, and check it against a schema."""
    with resources.as_file(resources.files("airpuck") / "packaged" / name) as path:
        return read_toml(path, schema)


def laid_over(base: Mapping[str, Any], content: Mapping[str, Any]) -> dict[str, Any]:
    """Replace in `base` what the content names, table by table; arrays are replaced whole."""
    merged = dict(base)
    for key, value in content.items():
        below = base.get(key)
        if isinstance(below, Mapping) and isinstance(value, Mapping):
            value = laid_over(below, value)
        merged[key] = value
    return merged


def checked(
    content: Mapping[str, Any], schema: type[Schema], *, file: str | os.PathLike[str] | None = None
) -> Schema:
    """Check a mapping against a schema."""
    try:
        # As JSON: there, strictness is about types (no truth value is a number, no text either)
        # and not about Python's containers.
        return schema.model_validate_json(json.dumps(content, default=str), strict=True)
    except pydantic.ValidationError as error:
        # A misspelt key also leaves the right one missing: report the spelling.
        found = error.errors()
        first = next((one for one in found if one["type"] == "extra_forbidden"), found[0])
        # Names of validator functions are of no use to a user.
        field = ".".join(
            str(part) for part in first["loc"] if not str(part).startswith("function-")
        )
        problem = first["msg"].removeprefix("Value error, ").rstrip(".")
        if first["type"] == "extra_forbidden":
            problem = "is not a known key; check its spelling"
        elif first["type"] == "missing":
            problem = "is required but missing"
        raise InputError(problem, file=file, field=field or None) from error


def write_toml(
    path: str | os.PathLike[str], content: Mapping[str, Any], *, header: str = ""
) -> None:
    """Write a mapping as TOML, replacing the file in one step."""
    import tomli_w

    comment = "".join(f"# {line}".rstrip() + "\n" for line in header.splitlines())
    text = f"{comment}\n" if comment else ""
    # tomli_w gives every number of an array its own line; rows of a matrix read better as rows.
    rows = re.compile(r"\[\n((?:[ ]+[^\[\]\n]+,\n)+)[ ]*\]")
    dumped = rows.sub(
        lambda row: "[" + ", ".join(x.strip(" ,") for x in row[1].splitlines()) + "]",
        tomli_w.dumps(content),
    )
    with replacing(path) as temporary:
        temporary.write_text(text + dumped, encoding="utf-8")


@contextlib.contextmanager
def replacing(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Give a temporary file beside `path`, which replaces it if the block succeeds.

    If the block fails or is interrupted, an existing file stays as it was.

    Parameters
    ----------
    path : path-like
        The final name.

    Yields
    ------
    Path
        The temporary name to write to; it has the same suffix.

    Raises
    ------
    InputError
        If the folder cannot be written to.
    """
    target = Path(path)
    temporary = target.parent / temporary_name(target)
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        temporary.touch(exist_ok=False)
        yield temporary
        temporary.replace(target)
    except OSError as error:
        raise unwritable(path, error) from error
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink()


def temporary_name(target: Path) -> str:
    """Return a name for what will become a file or folder, with its suffix.

    It is known before there is such a file, so that no interruption can leave one behind, and
    shorter than the longest that the system allows, whatever the file is called.
    """
    return f".{target.stem[:20]}-{secrets.token_hex(4)}{target.suffix}"


def unwritable(path: str | os.PathLike[str], error: OSError) -> InputError:
    """Say why something cannot be written: the disk is full, a folder is read-only."""
    return InputError(f"cannot be written ({error.strerror or error})", file=path)


def check_output(
    path: str | os.PathLike[str], kind: Output = "file", *, field: str | None = None
) -> None:
    """Refuse a place that cannot be written to, before the work for it is done."""
    target = Path(path).absolute()
    try:
        problem = _problem(target, kind)
    except OSError as error:
        problem = f"cannot be written ({error.strerror}); choose another place"
    if problem is not None:
        raise InputError(problem, file=path, field=field)


def _problem(target: Path, kind: Output) -> str | None:
    """Say why something of this kind cannot be written here, if so; an OSError says it, too."""
    there = next(folder for folder in (target, *target.parents) if os.path.lexists(folder))
    longest = os.pathconf(there if there.is_dir() else there.parent, "PC_NAME_MAX")
    if max(len(os.fsencode(part)) for part in target.parts) > longest:
        return f"has a name of more than {longest} bytes, the longest that the system allows"
    if there == target:
        mode = target.lstat().st_mode if kind == "new folder" else target.stat().st_mode
        if kind == "new folder" and not (stat.S_ISDIR(mode) and not any(target.iterdir())):
            return "exists already; choose a new folder"
        if kind == "file" and stat.S_ISDIR(mode):
            return "is a folder; give the name of a file"
        if kind == "file" and not stat.S_ISREG(mode):
            return "is no ordinary file; choose another place"
        if kind == "file" and not os.access(target, os.W_OK):
            return "is write-protected; choose another place"
        if kind == "folder" and not stat.S_ISDIR(mode):
            return "is a file; give the name of a folder"
    with tempfile.TemporaryFile(dir=there.parent if there == target and kind == "file" else there):
        return None
