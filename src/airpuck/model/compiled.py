"""Compile small array functions for real time.

A NumPy call costs about a microsecond whatever the array's size, and a control step has hundreds of
them; one call of a compiled program costs ten. The functions stay what they are, plain array
operations over a namespace: compiled here for the controller, run by NumPy in tests.

Every array that goes in or comes out costs a microsecond, too, which is more than the arithmetic:
a program takes one vector and gives one, laid out here.

Programs are kept: a controller for a craft that has one already is not compiled again.
"""

from __future__ import annotations

import math
import pickle
from collections.abc import Callable, Hashable
from itertools import accumulate, pairwise
from types import FunctionType, ModuleType
from typing import Any

import numpy as np

#: Programs by what they compute, the last used last: those of a dozen craft.
_kept: dict[Hashable, Callable[..., Any]] = {}
_MOST_KEPT = 100


def for_real_time(function: Callable[..., Any], *examples: Any) -> Callable[..., Any]:
    """Compile a pure function of arrays, in double precision, for the CPU.

    Parameters
    ----------
    function : callable
        Takes arrays, returns a tuple of arrays; uses jax.numpy. What it takes from the functions
        and modules around it, such as a model, is not changed any more.
    *examples : array or float
        Arguments of the shapes that it will be called with.

    Returns
    -------
    callable
        The same function: NumPy arrays in, a list of NumPy arrays (of double precision, read-only)
        out. It neither depends on nor changes JAX's settings.
    """
    try:
        key = _content(function), tuple(np.shape(example) for example in examples)
    except (pickle.PicklingError, AttributeError, TypeError, ValueError, RecursionError):
        return _compiled(function, *examples)  # takes something that has no content to compare
    program = _kept.pop(key, None) or _compiled(function, *examples)
    _kept[key] = program
    if len(_kept) > _MOST_KEPT:
        _kept.pop(next(iter(_kept)), None)
    return program


def _content(value: Any) -> Hashable:
    """Tell what a value, or a function with what it takes from around it, consists of."""
    if isinstance(value, FunctionType):
        around = tuple(_content(cell.cell_contents) for cell in value.__closure__ or ())
        defaults = _content(value.__defaults__), _content(value.__kwdefaults__)
        return value.__module__, value.__code__, defaults, around
    if hasattr(value, "__wrapped__"):  # compiled by JAX
        return type(value).__qualname__, _content(value.__wrapped__)
    return value.__name__ if isinstance(value, ModuleType) else pickle.dumps(value)


def _compiled(function: Callable[..., Any], *examples: Any) -> Callable[..., Any]:
    """Compile for `for_real_time`."""
    import jax
    import jax.numpy as jnp

    double_precision, concatenate, asarray = jax.enable_x64, np.concatenate, np.asarray
    taken = _places([np.shape(example) for example in examples])
    given: list[tuple[int, int, tuple[int, ...]]] = []

    def on_vectors(vector: Any) -> Any:
        results = function(*(vector[a:b].reshape(shape) for a, b, shape in taken))
        given[:] = _places([result.shape for result in results])
        return jnp.concatenate([result.ravel() for result in results])

    cpu = jax.local_devices(backend="cpu")[0]
    with double_precision(True), jax.default_device(cpu):
        program = jax.jit(on_vectors).lower(np.zeros(taken[-1][1])).compile()

    def call(*arguments: Any) -> list[np.ndarray]:
        with double_precision(True):
            results = asarray(program(concatenate(arguments, axis=None)))
        return [results[a:b].reshape(shape) for a, b, shape in given]

    return call


def _places(shapes: list[tuple[int, ...]]) -> list[tuple[int, int, tuple[int, ...]]]:
    """Lay arrays out one after the other: begin, end and shape of each."""
    edges = accumulate(map(math.prod, shapes), initial=0)
    return [(a, b, shape) for (a, b), shape in zip(pairwise(edges), shapes, strict=True)]
