"""Arguments of public functions and classes: option names, and values of the right kind."""

from __future__ import annotations

import functools
import inspect
import math
import typing
from collections.abc import Callable, Mapping
from typing import Any, TypeVar

import numpy as np

from airpuck.boundary.errors import InputError, nearest, unknown
from airpuck.boundary.results import brief
from airpuck.boundary.settings import check_value, setting_of

Chosen = TypeVar("Chosen")
Function = TypeVar("Function", bound=Callable[..., Any])
Class = TypeVar("Class", bound=type)
#: Stands for a function among the defaults that `help` shows.
_DEFAULT = type("Default", (), {"__repr__": lambda _: "..."})()


def chosen(name: object, options: Mapping[str, Chosen], field: str) -> Chosen:
    """Return the named option; an InputError lists all names and suggests the nearest."""
    if isinstance(name, str) and name in options:
        return options[name]
    raise InputError(unknown(name, options), field=field)


def checked(function: Function, *, finite: bool = True) -> Function:
    """Make a function reject arguments that contradict their annotations or are out of range.

    Numbers must be finite, unless `finite` is False.
    """
    signature = inspect.signature(function)
    hints = _hints(function, signature)

    @functools.wraps(function)
    def boundary(*args: Any, **kwargs: Any) -> Any:
        try:
            given = signature.bind(*args, **kwargs).arguments
        except TypeError as error:
            raise TypeError(_uncallable(function, signature, kwargs, error)) from None
        for name, hint in hints.items():
            if name in given:
                check_value(given[name], hint, setting_of(hint), name)
            if finite and name in given and not _finite(given[name]):
                raise InputError("must be finite numbers", field=name)
        return function(*args, **kwargs)

    shown = [
        one.replace(default=_DEFAULT) if inspect.isfunction(one.default) else one
        for one in signature.parameters.values()
    ]
    boundary.__signature__ = signature.replace(parameters=shown)  # pyright: ignore
    return typing.cast(Function, boundary)


def _uncallable(
    function: Callable[..., Any],
    signature: inspect.Signature,
    given: Mapping[str, Any],
    error: TypeError,
) -> str:
    """Describe a call that does not fit a function; suggest the nearest name of an argument."""
    name, known = function.__qualname__.removesuffix(".__init__"), signature.parameters
    strange = [one for one in given if one not in known]
    if strange and not any(p.kind is p.VAR_KEYWORD for p in known.values()):
        return f"{name}() has no argument {strange[0]!r}{nearest(strange[0], known)}"
    return f"{name}() is {error}" if str(error).startswith("missing") else f"{name}(): {error}"


def checked_class(kind: Class, *, finite: bool = True) -> Class:
    """Make a class reject arguments of its constructor, like `checked`, and give it a text."""
    if kind.__repr__ is object.__repr__:
        setattr(kind, "__repr__", brief)  # noqa: B010
    kind.__init__ = checked(kind.__init__, finite=finite)
    return kind


def numbers_of(given: Any, shape: tuple[int | None, ...], field: str) -> np.ndarray:
    """Return finite numbers as a new array of a shape, where None is any length.

    Raise InputError that names the field for anything else.
    """
    try:
        found = np.array(given)
    except ValueError:  # rows of different lengths
        found = np.array(None)
    wide = found.ndim == len(shape) and all(
        most is None or length == most for length, most in zip(found.shape, shape, strict=True)
    )
    if not (wide and found.dtype.kind in "fiu" and np.isfinite(found).all()):
        lengths = ", ".join("N" if length is None else str(length) for length in shape)
        words = {0: "a finite number", 1: f"{lengths} finite numbers"}
        words = words.get(len(shape), f"finite numbers of the shape ({lengths})")
        words = words.replace("N ", "" if found.ndim == 1 else "a row of ")
        raise InputError(f"must be {words}", field=field)
    return found.astype(float, copy=False)


def _hints(function: Callable[..., Any], signature: inspect.Signature) -> dict[str, Any]:
    """Return the annotations of arguments, except those that only a type checker can resolve."""
    hints = {}
    for name, parameter in signature.parameters.items():
        if parameter.kind in (parameter.VAR_POSITIONAL, parameter.VAR_KEYWORD):
            continue
        hint = parameter.annotation
        if hint is parameter.empty:  # self
            continue
        try:
            names = inspect.unwrap(function).__globals__
            hints[name] = eval(hint, names) if isinstance(hint, str) else hint
        except NameError:
            continue
    return hints


def _finite(value: Any) -> bool:
    """Return whether a number, or all numbers of an array or sequence, are finite."""
    if isinstance(value, np.ndarray):
        return value.dtype.kind != "f" or bool(np.isfinite(value).all())
    if type(value) in (tuple, list):
        return all(map(_finite, value))
    return not isinstance(value, float | np.floating) or math.isfinite(value)
