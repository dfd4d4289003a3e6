"""Checks of signatures while the tests run: by beartype, which accepts an int as a float.

In each test, the first calls of each function with arrays are checked. A check takes longer than
most short functions; loops that step through a flight make a million of them, of the same shapes.
Functions without arrays are left to pyright: counting their calls took a quarter of such loops.
"""

import dataclasses
import inspect
import re
from collections.abc import Callable
from functools import partial, wraps
from typing import Any

from beartype import BeartypeConf, beartype
from jaxtyping import jaxtyped as always_checked

check = beartype(conf=BeartypeConf(is_pep484_tower=True))

#: Number of calls of each function that are checked in each test.
CHECKED = 3
#: Calls of each function in this test, in a list of one: loops make millions of these look-ups.
_calls: dict[tuple[str, str], list[int]] = {}


def start_again() -> None:
    """Restart the count: the next calls belong to another test."""
    for calls in _calls.values():
        calls[0] = 0


def pause() -> None:
    """Check no more calls in this test, so that a wrong argument reaches our own checks."""
    for calls in _calls.values():
        calls[0] = CHECKED


def jaxtyped(fn: Any = None, *, typechecker: Callable[..., Any]) -> Any:
    """Stand in for `jaxtyping.jaxtyped`, with which the import hook decorates all functions.

    Checks are built when they are first needed, since that takes long, too, and a nested function
    is decorated whenever the outer one runs. They are kept with the function itself: a program is
    found again by what its functions close over, which must stay the same.
    """
    if fn is None:
        return partial(jaxtyped, typechecker=typechecker)
    if inspect.isclass(fn):
        if dataclasses.is_dataclass(fn) and "__init__" in vars(fn):
            fn.__init__ = jaxtyped(fn.__init__, typechecker=typechecker)
        return fn
    if not _takes_arrays(fn):
        return fn
    # Kept with the function for the same reason.
    fn.calls = _calls.setdefault((fn.__module__, fn.__qualname__), [0])
    # The check of a nested function is rebuilt for each outer call.
    checked = 1 if "<locals>" in fn.__qualname__ else CHECKED
    fn.typechecker = typechecker

    @wraps(fn)
    def call(*arguments: Any, **named: Any) -> Any:
        __tracebackhide__ = True
        if fn.calls[0] >= checked:
            return fn(*arguments, **named)
        fn.calls[0] += 1
        if not hasattr(fn, "checked"):
            fn.checked = always_checked(fn, typechecker=fn.typechecker)
        return fn.checked(*arguments, **named)

    return call


def _takes_arrays(fn: Callable[..., Any]) -> bool:
    """Return whether annotations mention arrays, by jaxtyping's names or by an alias."""
    for annotation in fn.__annotations__.values():
        words = re.findall(r"\w+", annotation) if isinstance(annotation, str) else ()
        named = (fn.__globals__.get(word) for word in words)
        if any("jaxtyping" in repr(kind) for kind in (annotation, *named)):
            return True
    return False
