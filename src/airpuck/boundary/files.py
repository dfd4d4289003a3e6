"""Checked TOML files, and the parsers of TOML and JSON with bounds."""

from __future__ import annotations

import json
import math
import os
import re
import tomllib
import warnings
from collections.abc import Callable, Mapping
from difflib import get_close_matches
from functools import cache
from importlib import resources
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, TypeVar

import pydantic

from airpuck.boundary.errors import InputError, explained
from airpuck.boundary.limits import (
    DEPTH,
    KEYS,
    YAML_BYTES,
    check_tree,
    read_text,
    refused,
    within_means,
)
from airpuck.boundary.numbers import check_size
from airpuck.boundary.outputs import replacing
from airpuck.boundary.results import brief

_PART = r"""(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')"""
#: A name with too many dotted parts; tomllib's time grows with the square of their number.
_DOTTED = re.compile(rf"(?<![\w-]){_PART}(?:[ \t]*+\.[ \t]*+{_PART}){{{DEPTH}}}")


def load_toml(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Read a TOML file."""
    text = read_text(path)
    # Checked before parsing, because parsing is what takes the time.
    if text.count("=") + text.count("\n[") > KEYS:
        raise refused("contains too many keys", KEYS, "is it the right file?", file=path)
    if _DOTTED.search(text):
        raise InputError(f"is nested more than {DEPTH} deep; flatten it", file=path)
    # A number of thousands of digits is a ValueError of another kind.
    return _checked_tree(text, tomllib.loads, "TOML", ValueError, path)


def load_json(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Read a JSON file that contains an object."""
    return parse_json(read_text(path), file=path)


def parse_json(text: str, *, file: str | os.PathLike[str]) -> dict[str, Any]:
    """Parse text from a file as a JSON object."""
    return _checked_tree(text, json.loads, "JSON", ValueError, file, "a JSON object")


def load_yaml(path: str | os.PathLike[str]) -> dict[Any, Any]:
    """Read a YAML file whose content is a mapping."""
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError

    text = read_text(path, YAML_BYTES)
    # Merged tables can double with each line.
    if "<<" in text:
        raise InputError("merges tables (<<); write them out", file=path)
    errors = (YAMLError, ValueError, TypeError, AttributeError, KeyError, IndexError)
    wanted = "a mapping of keys to values"
    return _checked_tree(text, YAML(typ="safe").load, "YAML", errors, path, wanted)


def _checked_tree(
    text: str,
    parse: Callable[[str], Any],
    language: str,
    errors: type[Exception] | tuple[type[Exception], ...],
    file: str | os.PathLike[str],
    wanted: str = "tables",
) -> dict[Any, Any]:
    """Parse text from a file with bounds; its content must be a dictionary."""
    problem = f"is not valid {language}: {{error}}"
    with within_means(file), explained(errors, problem, file=file):
        content = parse(text)
    if not isinstance(content, dict):
        raise InputError(f"must contain {wanted}", file=file)
    check_tree(content, file=file)
    return content


#: A `Section`, or a settings class.
Schema = TypeVar("Schema")

#: Measured quantities are larger. Squares and inverses of smaller numbers underflow or overflow.
Positive = Annotated[float, pydantic.Field(ge=1e-9)]
NonNegative = Annotated[float, pydantic.Field(ge=0)]
#: Between 0 and 1.
Fraction = Annotated[float, pydantic.Field(ge=0, le=1)]


#: Pydantic's error types for an unknown key, of a `Section` and of a settings class.
_UNKNOWN = ("extra_forbidden", "unexpected_keyword_argument")
#: Pydantic's phrase for the kind of a value that is too short or too long, and its actual size.
_OF_LENGTH = re.compile(r"^(?:Tuple|List) should have (.*?) after validation, not .*")


class Section(pydantic.BaseModel):
    """Base of every table in our TOML files: immutable; an unknown key is an error."""

    model_config = pydantic.ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
    #: Former keys and attributes, and where each stands now; methods have (), and are no keys.
    MOVED: ClassVar[Mapping[str, str]] = {}
    __repr__ = __str__ = brief

    if not TYPE_CHECKING:  # type checkers derive the arguments from the fields

        def __init__(self, /, **values: Any) -> None:
            try:
                super().__init__(**values)
            except pydantic.ValidationError as error:
                raise _explained(error, type(self), values) from error

        # Of nested tables, pydantic reports the place itself.
        __init__.__pydantic_base_init__ = True

        def __getattr__(self, name: str) -> Any:
            if now := self.MOVED.get(name) or self.MOVED.get(f"{name}()"):
                raise AttributeError(f"{type(self).__name__}.{name} is now {now.strip('[]')}")
            return super().__getattr__(name)

    @pydantic.model_validator(mode="after")
    def _of_this_world(self) -> Section:
        for name, value in self:
            check_size(name, value)
        return self

    def model_copy(self, **how: Any) -> Any:
        """Copy as pydantic does, but without the original's cached properties.

        Parameters
        ----------
        **how : Any
            As pydantic's: `update` and `deep`.

        Returns
        -------
        Section
            The copy; of updated fields, only numbers are checked, which must be finite.
        """
        for name, value in (how.get("update") or {}).items():
            if isinstance(value, float) and not math.isfinite(value):
                raise InputError(f"must be a finite number, not {value!r}", field=name)
        copied = super().model_copy(**how)
        for name in copied.__dict__.keys() - type(self).model_fields.keys():
            object.__delattr__(copied, name)
        return copied


def read_toml(
    path: str | os.PathLike[str], schema: type[Schema], *, base: Schema | None = None
) -> Schema:
    """Read a TOML file and check it against a schema; omitted fields keep the values of `base`."""
    content = load_toml(path)
    if base is not None:
        content = laid_over(_adapter(schema).dump_python(base, mode="json"), content)
    return checked(content, schema, file=path)


def read_packaged(name: str, schema: type[Schema]) -> Schema:
    """Read a packaged TOML file, and check it against a schema."""
    with resources.as_file(resources.files("airpuck") / "packaged" / name) as path:
        return read_toml(path, schema)


@cache
def _adapter(schema: type) -> Any:
    """Return a validator for a schema."""
    return pydantic.TypeAdapter(schema)


@cache
def _keys(schema: type) -> list[set[str]]:
    """Return the keys of a schema, then the keys of its tables."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # about defaults that JSON cannot represent
        found = _adapter(schema).json_schema()
    return [set(one.get("properties", ())) for one in (found, *found.get("$defs", {}).values())]


def laid_over(base: Mapping[str, Any], content: Mapping[str, Any]) -> dict[str, Any]:
    """Override values of `base` with the content's, table by table; arrays are replaced whole."""
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
    adapter = _adapter(schema)
    try:
        # Validate as JSON: there, strict mode concerns types (booleans and strings are not numbers)
        # instead of Python's containers.
        # Keys in YAML can be dates or lists.
        return adapter.validate_json(json.dumps(content, default=str, skipkeys=True), strict=True)
    except pydantic.ValidationError as error:
        raise _explained(error, schema, content, file) from error


def _explained(
    error: pydantic.ValidationError,
    schema: type,
    content: Mapping[str, Any],
    file: str | os.PathLike[str] | None = None,
) -> InputError:
    """Return the error for the first thing that pydantic rejects."""
    # A misspelt key also leaves the right one missing: report the spelling.
    found = error.errors()
    first = next((one for one in found if one["type"] in _UNKNOWN), found[0])
    field = _field(first, content)
    cause = first.get("ctx", {}).get("error")
    if isinstance(cause, InputError):
        field = ".".join(part for part in (field, cause.field) if part)
        first["msg"] = cause.problem
    problem = first["msg"].removeprefix("Value error, ").rstrip(".")
    problem = problem.replace("Input should be", "must be")
    problem = problem.replace("a valid array", "a list in brackets, [ ]")
    problem = problem.replace("a valid dictionary or instance of", "a dictionary or a")
    problem = _OF_LENGTH.sub(r"must have \1", problem)
    known = _keys(schema)
    if first["type"] in _UNKNOWN and file is not None and (kinds := _other_kind(content, known[0])):
        field, problem = "", "is {}; expected {}".format(*kinds)
    elif first["type"] in _UNKNOWN:
        key = str(first["loc"][-1])
        near = get_close_matches(key, set().union(*known), 1)
        hint = f"did you mean {near[0]}?" if near else "check its spelling"
        hint = "it is a key of another table" if near == [key] else hint
        now = getattr(schema, "MOVED", {}).get(key)
        problem = f"is now written {now}" if now else f"is not a known key; {hint}"
    elif first["type"] == "missing":
        problem = "is required but missing"
    return InputError(problem, file=file, field=field or None)


def _field(error: Mapping[str, Any], content: Any) -> str:
    """Return the key of an error, without pydantic's names of validators and of a union's types."""
    found = []
    for part in error["loc"]:
        try:
            content = content[part]
        except (KeyError, IndexError, TypeError):
            continue
        found.append(str(part))
    return ".".join([*found, str(error["loc"][-1])] if error["type"] == "missing" else found)


def _other_kind(content: Mapping[str, Any], known: set[str]) -> tuple[str, str] | None:
    """Return the kind of a file and the expected kind, unless it seems to be of that kind."""
    tables = read_packaged("file_kinds.toml", dict[str, dict[str, str]])
    kinds = tables["certain"] | tables["possible"]
    key = next((k for k in kinds if k in content and k not in known), None)
    if key is None or (key in tables["possible"] and kinds.keys() & content.keys() & known):
        return None
    wanted = next((name for k, name in kinds.items() if k in known), "another kind of file")
    return kinds[key], wanted


def write_toml(
    path: str | os.PathLike[str], content: Mapping[str, Any], *, header: str = ""
) -> None:
    """Write a mapping as TOML, replacing the file in one step."""
    import tomli_w

    comment = "".join(f"# {line}".rstrip() + "\n" for line in header.splitlines())
    text = f"{comment}\n" if comment else ""
    # tomli_w puts every number of an array on its own line; rows of a matrix read better as rows.
    rows = re.compile(r"\[\n((?:[ ]+[^\[\]\n]+,\n)+)[ ]*\]")
    dumped = rows.sub(
        lambda row: "[" + ", ".join(x.strip(" ,") for x in row[1].splitlines()) + "]",
        tomli_w.dumps(content),
    )
    with replacing(path) as temporary:
        # The name of a source file may have bytes that are not UTF-8.
        temporary.write_text(text + dumped, encoding="utf-8", errors="replace")
