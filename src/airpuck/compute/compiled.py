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

from airpuck.compute.xla import cpu_options

_DOUBLE = np.dtype(float)
#: Programs by what they compute, the last used last: those of a dozen craft.
_kept: dict[Hashable, Callable[..., Any]] = {}
_MOST_KEPT = 100


def at_once() -> bool:
    """Let JAX run programs on a CPU where they are called, in this process.

    By default it hands those of more than a thousand operations to another thread, which takes
    10 µs. A setting of the whole process, so a command may change it, not a library.
    """
    import jax
    from jax._src import xla_bridge  # nothing public tells whether JAX has computed yet

    if not runs_at_once() and not xla_bridge.backends_are_initialized():
        jax.config.update("jax_cpu_enable_async_dispatch", False)
    return runs_at_once()


def runs_at_once() -> bool:
    """Say whether JAX runs programs of any size where they are called; see `at_once`."""
    import jax

    return not jax.config.read("jax_cpu_enable_async_dispatch")


def program(function: Callable[..., Any], *examples: Any, compiled: bool) -> Callable[..., Any]:
    """Give a function of a namespace and arrays its namespace.

    Parameters
    ----------
    function : callable
        Takes an array namespace and arrays, returns a tuple of arrays; pure.
    *examples : array or float
        Arrays of the shapes that it will be called with.
    compiled : bool
        Whether the namespace is jax.numpy, and the function compiled (`for_real_time`), or numpy.

    Returns
    -------
    callable
        NumPy arrays in, NumPy arrays out.
    """
    xp: Any = np
    if compiled:
        import jax.numpy as xp

    def bound(*arrays: Any) -> Any:
        return function(xp, *arrays)

    return for_real_time(bound, *examples) if compiled else bound


def for_real_time(function: Callable[..., Any], *examples: Any) -> Callable[..., Any]:
    """Compile a pure function of arrays, in double precision, for the CPU."""
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

    double_precision, array = jax.enable_x64, np.array
    taken = _places([np.shape(example) for example in examples])
    given: list[tuple[slice, tuple[int, ...]]] = []

    def on_vectors(vector: Any) -> Any:
        results = function(*(vector[part].reshape(shape) for part, shape in taken))
        given[:] = _places([result.shape for result in results])
        return jnp.concatenate([result.ravel() for result in results])

    cpu = jax.local_devices(backend="cpu")[0]
    with double_precision(True), jax.default_device(cpu):
        lowered = jax.jit(on_vectors).lower(np.zeros(taken[-1][0].stop))
        program = lowered.compile(cpu_options())
    parts = [(part, shape if len(shape) != 1 else None) for part, shape in given]

    def call(*arguments: Any) -> list[np.ndarray]:
        with double_precision(True):
            results = array(program(_joined(arguments)))
        return [
            results[part] if shape is None else results[part].reshape(shape)
            for part, shape in parts
        ]

    return call


def _joined(arguments: tuple[Any, ...]) -> np.ndarray:
    """Lay arguments out one after the other, in double precision.

    Joining bytes takes half the time, where all are arrays of double precision without gaps.
    """
    try:
        if [argument.dtype for argument in arguments].count(_DOUBLE) == len(arguments):
            return np.frombuffer(b"".join(arguments))
    except (AttributeError, TypeError):  # a plain number, or an array with gaps
        pass
    return np.concatenate(arguments, axis=None, dtype=float)


def _places(shapes: list[tuple[int, ...]]) -> list[tuple[slice, tuple[int, ...]]]:
    """Lay arrays out one after the other: place and shape of each."""
    edges = accumulate(map(math.prod, shapes), initial=0)
    return [(slice(a, b), shape) for (a, b), shape in zip(pairwise(edges), shapes, strict=True)]
