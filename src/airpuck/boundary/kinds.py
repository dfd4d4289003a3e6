"""Kinds of values: whether a value fits an annotation, and what the annotation accepts."""

from __future__ import annotations

import os
import types
import typing
from collections.abc import Callable, Iterable, Mapping, Sequence
from difflib import get_close_matches
from functools import cache
from numbers import Integral, Real
from typing import Any, Literal

#: Number of characters shown of a value that is too long.
_SHOWN = 60


@cache
def _kinds() -> dict[Any, tuple[Any, str]]:
    """Return the types that fit a type, and words for it: a NumPy number is a number, too."""
    import numpy as np  # only where a value is checked: it would double the time of `--help`

    return {
        float: (Real, "a number"),
        int: (Integral, "a whole number"),
        bool: ((bool, np.bool_), "True or False"),
        str: (str, "a text"),
        os.PathLike: (os.PathLike, "a path"),
        np.ndarray: (np.ndarray, "an array"),
        Callable: (Callable, "a function"),
        Sequence: ((Sequence, np.ndarray), "a sequence"),
        tuple: ((Sequence, np.ndarray), "a sequence"),
        Iterable: (Iterable, "a sequence"),
        Mapping: (Mapping, "a mapping"),
    }


def fits(value: Any, hint: Any) -> bool:
    """Return whether a value fits an annotation; undecidable cases fit."""
    origin, inner = typing.get_origin(hint) or hint, typing.get_args(hint)
    if origin is typing.Annotated:
        return fits(value, inner[0])
    if origin in (typing.Union, types.UnionType):
        return any(fits(value, one) for one in inner)
    if origin is Literal:
        return isinstance(value, str | int) and value in inner
    if origin in (None, type(None)):
        return value is None
    if origin in _kinds():
        kind, _ = _kinds()[origin]
        if not isinstance(value, kind) or (isinstance(value, bool) and origin in (int, float)):
            return False
        if origin in (Sequence, tuple):
            return _elements_fit(value, inner)
        return True
    if origin is Any or not isinstance(origin, type) or hasattr(origin, "array_type"):
        return True  # an array is converted, and its shape checked
    if getattr(origin, "_is_protocol", False) and not getattr(origin, "_is_runtime_protocol", 0):
        return True
    return isinstance(value, origin)


def _elements_fit(value: Any, inner: tuple[Any, ...]) -> bool:
    """Return whether all elements of a sequence are of a kind; text does not count."""
    if isinstance(value, str | bytes):
        return False
    if not inner:
        return True
    if hasattr(value, "shape"):
        return len(inner) == 1 or inner[-1] is ... or value.shape[:1] == (len(inner),)
    if len(inner) == 1 or inner[-1] is ...:
        return all(fits(one, inner[0]) for one in value)
    pairs = zip(value, inner, strict=False)
    return len(value) == len(inner) and all(fits(one, kind) for one, kind in pairs)


def misfit(value: Any, hint: Any) -> str:
    """Describe what an argument accepts."""
    names = [name for one in _alternatives(hint) for name in _names(one)]
    if names and isinstance(value, str):
        return unknown(value, names)
    kinds = [typing.get_args(o)[0] for o in _alternatives(hint) if typing.get_origin(o) is Sequence]
    entries = value if kinds and isinstance(value, list | tuple) else ()
    for entry in entries:
        if not any(fits(entry, kind) for kind in kinds):
            return f"must be {_words(hint)}, but contains {_shown(entry)}"
    return f"must be {_words(hint)}, not {_shown(value)}"


def _alternatives(hint: Any) -> tuple[Any, ...]:
    """Return the kinds that an annotation allows."""
    if typing.get_origin(hint) is typing.Annotated:
        hint = hint.__origin__
    union = typing.get_origin(hint) in (typing.Union, types.UnionType)
    return typing.get_args(hint) if union else (hint,)


def _names(hint: Any) -> tuple[str, ...]:
    return typing.get_args(hint) if typing.get_origin(hint) is Literal else ()


def _words(hint: Any) -> str:
    """Describe a kind."""
    alternatives = _alternatives(hint)
    if len(alternatives) > 1:
        return _either(dict.fromkeys(map(_words, alternatives)))
    origin, inner = typing.get_origin(hint) or hint, typing.get_args(hint)
    if origin is Literal:
        return _either(map(repr, inner))
    if origin in (None, type(None)):
        return "None"
    if origin in (Sequence, tuple) and inner:
        count = "" if len(inner) == 1 or inner[-1] is ... else f"{len(inner)} values: "
        return f"a sequence of {count}{_words(inner[0])}".replace("of a text", "of texts")
    if origin in _kinds():
        return _kinds()[origin][1]
    return getattr(origin, "__name__", str(origin))


def _shown(value: object) -> str:
    """Show a short value; for others, the type."""
    if isinstance(value, type):
        return f"the class {value.__name__}"
    simple = value is None or isinstance(value, str | bool | Real)
    return repr(value) if simple and len(repr(value)) < 40 else f"a {type(value).__name__}"


def unknown(name: Any, known: Iterable[Any]) -> str:
    """Return an error text for an unknown name: the known names, and the nearest of them."""
    names, shown = list(known), repr(name)
    shown = shown if len(shown) <= _SHOWN else f"{shown[:_SHOWN]}…"
    return f"must be {_either(map(repr, names))}, not {shown}{nearest(name, names)}"


def nearest(name: Any, known: Iterable[Any]) -> str:
    """Return the end of an error text that suggests the nearest name; empty if none is near."""
    near = get_close_matches(repr(name), map(repr, known), 1) if isinstance(name, str) else []
    return f"; did you mean {near[0]}?" if near else ""


def _either(words: Iterable[str]) -> str:
    """Join alternatives: 1, 2 or 3."""
    *others, last = words
    return f"{', '.join(others)} or {last}" if others else last
