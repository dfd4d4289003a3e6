"""Text formats: one entry point each for TOML, JSON and YAML, within limits."""

from __future__ import annotations

import json
import os
import re
import tomllib
from typing import Any

from airpuck.boundary.errors import InputError
from airpuck.boundary.limits import (
    DEPTH,
    KEYS,
    YAML_BYTES,
    check_tree,
    read_text,
    refused,
    within_means,
)

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
    with within_means(path):
        try:
            content = tomllib.loads(text)
        # A number of thousands of digits is a ValueError of another kind.
        except ValueError as error:
            raise InputError(f"is not valid TOML: {error}", file=path) from error
    check_tree(content, file=path)
    return content


def load_json(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Read a JSON file that contains an object."""
    return parse_json(read_text(path), file=path)


def parse_json(text: str, *, file: str | os.PathLike[str]) -> dict[str, Any]:
    """Parse text from a file as a JSON object."""
    with within_means(file):
        try:
            content = json.loads(text)
        except ValueError as error:
            raise InputError(f"is not valid JSON: {error}", file=file) from error
    if not isinstance(content, dict):
        raise InputError("must contain a JSON object", file=file)
    check_tree(content, file=file)
    return content


def load_yaml(path: str | os.PathLike[str]) -> dict[Any, Any]:
    """Read a YAML file whose content is a mapping."""
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError

    text = read_text(path, YAML_BYTES)
    # Merged tables can double with each line.
    if "<<" in text:
        raise InputError("merges tables (<<); write them out", file=path)
    with within_means(path):
        try:
            content = YAML(typ="safe").load(text)
        except (YAMLError, ValueError, TypeError, AttributeError, KeyError, IndexError) as error:
            raise InputError(f"is not valid YAML: {error}", file=path) from error
    if not isinstance(content, dict):
        raise InputError("must contain a mapping of keys to values", file=path)
    check_tree(content, file=path)
    return content
