"""Arguments of public functions: option names, and values of the right kind."""

from __future__ import annotations

import functools
import inspect
import math
import os
import types
import typing
from collections.abc import Callable, Iterable, Mapping, Sequence
from numbers import Integral, Real
from typing import Any, Literal, TypeVar

import numpy as np

from airpuck.boundary.errors import InputError
from airpuck.boundary.settings import setting_of, unknown

Chosen = TypeVar("Chosen")
Function = TypeVar("Function", bound=Callable[..., Any])

#: Kinds of values that are also accepted: a NumPy number is a number, too.
_KINDS: dict[Any, tuple[Any, str]] = {
    float: (Real, "a number"),
    int: (Integral, "a whole number"),
    bool: ((bool, np.bool_), "True or False"),
    str: (str, "a text"),
    os.PathLike: (os.PathLike, "a path"),
    Callable: (Callable, "a function"),
    Sequence: ((Sequence, np.ndarray), "a sequence"),
    tuple: ((Sequence, np.ndarray), "a sequence"),
    Iterable: (Iterable, "a sequence"),
    Mapping: (Mapping, "a mapping"),
}


def chosen(name: object, options: Mapping[str, Chosen], field: str) -> Chosen:
    """Return the named option; an InputError lists all names and suggests the nearest."""
    if isinstance(name, str) and name in options:
        return options[name]
    raise InputError(unknown(name, options), field=field)


def checked(function: Function) -> Function:
    """Make a function reject arguments that contradict their annotations or are out of range."""
    signature = inspect.signature(function)
    hints = _hints(function, signature)

    @functools.wraps(function)
    def boundary(*args: Any, **kwargs: Any) -> Any:
        given = signature.bind(*args, **kwargs).arguments
        for name, hint in hints.items():
            if name in given and not _fits(given[name], hint):
                raise InputError(_problem(given[name], hint), field=name)
            if name in given and (setting := setting_of(hint)):
                setting.check(given[name], name)
            if name in given and not _finite(given[name]):
                raise InputError("must be finite numbers", field=name)
        return function(*args, **kwargs)

    return typing.cast(Function, boundary)


def _hints(function: Callable[..., Any], signature: inspect.Signature) -> dict[str, Any]:
    """Return the annotations of arguments, except those that only a type checker can resolve."""
    hints = {}
    for name, parameter in signature.parameters.items():
        if parameter.kind in (parameter.VAR_POSITIONAL, parameter.VAR_KEYWORD):
            continue
        hint = parameter.annotation
        try:
            names = inspect.unwrap(function).__globals__
            hints[name] = eval(hint, names) if isinstance(hint, str) else hint
        except NameError:
            continue
    return hints


def _fits(value: Any, hint: Any) -> bool:
    """Return whether a value fits an annotation; undecidable cases fit."""
    origin, inner = typing.get_origin(hint) or hint, typing.get_args(hint)
    if origin is typing.Annotated:
        return _fits(value, inner[0])
    if origin in (typing.Union, types.UnionType):
        return any(_fits(value, one) for one in inner)
    if origin is Literal:
        return isinstance(value, str | int) and value in inner
    if origin in (None, type(None)):
        return value is None
    if origin in _KINDS:
        kind, _ = _KINDS[origin]
        if not isinstance(value, kind) or (isinstance(value, bool) and origin in (int, float)):
            return False
        if origin in (Sequence, tuple):
            return _elements_fit(value, inner)
        return True
    if not isinstance(origin, type) or hasattr(origin, "array_type"):
        return True  # Any, or an array, which is converted and whose shape is checked
    if getattr(origin, "_is_protocol", False) and not getattr(origin, "_is_runtime_protocol", 0):
        return True
    return isinstance(value, origin)


def _finite(value: Any) -> bool:
    """Return whether a number, or all numbers of an array or sequence, are finite."""
    if isinstance(value, np.ndarray):
        return value.dtype.kind != "f" or bool(np.isfinite(value).all())
    if type(value) in (tuple, list):
        return all(map(_finite, value))
    return not isinstance(value, float | np.floating) or math.isfinite(value)


def _elements_fit(value: Any, inner: tuple[Any, ...]) -> bool:
    """Return whether all elements of a sequence are of a kind; text does not count."""
    if isinstance(value, str | bytes):
        return False
    if isinstance(value, np.ndarray) or not inner:
        return True
    if len(inner) == 1 or inner[-1] is ...:
        return all(_fits(one, inner[0]) for one in value)
    pairs = zip(value, inner, strict=False)
    return len(value) == len(inner) and all(_fits(one, kind) for one, kind in pairs)


def _problem(value: Any, hint: Any) -> str:
    """Describe what an argument accepts."""
    names = [name for one in _alternatives(hint) for name in _names(one)]
    if names and isinstance(value, str):
        return unknown(value, names)
    words = dict.fromkeys(_words(one) for one in _alternatives(hint))
    return f"must be {' or '.join(words)}, not {_shown(value)}"


def _alternatives(hint: Any) -> tuple[Any, ...]:
    """Return the kinds that an annotation allows."""
    union = typing.get_origin(hint) in (typing.Union, types.UnionType)
    return typing.get_args(hint) if union else (hint,)


def _names(hint: Any) -> tuple[str, ...]:
    return typing.get_args(hint) if typing.get_origin(hint) is Literal else ()


def _words(hint: Any) -> str:
    """Describe a kind."""
    origin, inner = typing.get_origin(hint) or hint, typing.get_args(hint)
    if origin is Literal:
        return " or ".join(map(repr, inner))
    if origin in (None, type(None)):
        return "None"
    if origin in (Sequence, tuple) and inner:
        count = "" if len(inner) == 1 or inner[-1] is ... else f"{len(inner)} values: "
        return f"a sequence of {count}{_words(inner[0])}"
    if origin in _KINDS:
        return _KINDS[origin][1]
    return getattr(origin, "__name__", str(origin))


def _shown(value: object) -> str:
    """Show a short value; for others, the type."""
    simple = value is None or isinstance(value, str | bool | Real)
    return repr(value) if simple and len(repr(value)) < 40 else f"a {type(value).__name__}"
