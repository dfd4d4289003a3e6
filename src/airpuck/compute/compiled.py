"""Compiled programs, in double precision whatever the user's own JAX is set to.

There are two kinds. `program` is for real time: a NumPy call costs a microsecond whatever the size
of its arrays, and a control step needs hundreds of calls. One call of a compiled program costs
eight microseconds, mostly inside JAX. So a step makes few calls, and each takes one vector and
returns one, since every further array costs another microsecond. `for_batches` is for passes over
many samples in parallel, `for_samples` for passes from one sample to the next.

The functions remain plain array operations over a namespace; tests run them under NumPy. Programs
are cached by code and content, but for the numbers that they take as `Applied`: a second craft of
the same kind compiles nothing.

XLA's behaviour on a CPU, as measured:

* It splits programs with arrays above 512 bytes between several threads. That costs more
  than the arithmetic of small programs, and takes cores from batches that run in parallel. The
  memory-minimising scheduler does not (`_OPTIONS`). Together with 512-bit vectors it makes a pass
  over windows 20 % faster.
* JAX hands a program of a thousand operations or more to another thread: 10 µs on one core, 60 on
  two. Only a process-wide setting prevents it (`airpuck.compute.process.low_latency`).
* JAX releases the interpreter lock while it computes, so a thread pool uses all cores. Several JAX
  devices would do so too, but need a process-wide setting before JAX starts.
* It vectorises along the last axis, which is the batch throughout the identification's kernel.
* It does not skip products with zeros: Jacobians are taken with respect to one argument at a time,
  and motion counts only where accelerations depend on it. So the pass with all missing terms takes
  half the time, as does tracing.
* Tried on that kernel, and slower: one array for each kind of coordinate, the Jacobian of a whole
  step, reverse mode.
* The Runge-Kutta stages as an inner loop compile in two thirds of the time. A pass then takes
  1.3 (drag, idle, pair and sag) to 2 times as long (tilt), without effects half as long again.
* Without fusion emitters a program compiles in half the time. With many coordinates a pass takes as
  long, with few 1.6 times as long.
"""

from __future__ import annotations

import contextlib
import math
import pickle
from collections.abc import Callable, Hashable
from dataclasses import dataclass
from functools import cache, partial, wraps
from itertools import accumulate, pairwise
from types import FunctionType, MethodType, ModuleType
from typing import Any

import numpy as np

from airpuck.compute.arrays import register_pytree

_DOUBLE = np.dtype(float)
#: XLA's options on a CPU; see above.
_OPTIONS: dict[str, Any] = {
    "xla_cpu_scheduler_type": "CPU_SCHEDULER_TYPE_MEMORY_OPTIMIZED",
    "xla_cpu_prefer_vector_width": 512,
}
#: Options for a program that runs once: it compiles faster, and may run slower.
_OPTIONS_ONCE: dict[str, Any] = {**_OPTIONS, "xla_cpu_use_fusion_emitters": False}
#: Programs by their computation, least recently used first; enough for a dozen craft.
_kept: dict[Hashable, Callable[..., Any]] = {}
_MOST_KEPT = 100
#: Programs that a function of `for_batches` keeps. Each takes some hundred mappings of memory, of
#: which Linux allows 65 530 in a process.
_MOST_COMPILED = 50
#: Number of samples that a sample-by-sample pass takes at a time.
_STRETCH = 512


def double_precision() -> contextlib.AbstractContextManager[Any]:
    """Compute in double precision inside the block; the user's JAX settings do not change."""
    import jax

    return jax.enable_x64(True)


def for_batches(
    function: Callable[..., Any], *, once: bool = False, **settings: Any
) -> Callable[..., Any]:
    """Compile a function for passes over many samples; threads may call it in parallel.

    Parameters
    ----------
    function : callable
        Takes and returns trees of arrays; pure.
    once : bool
        Whether it runs once or twice only, so that a short compile time matters more.
    **settings : dict
        Of `jax.jit`.

    Returns
    -------
    callable
        The same function in double precision, on JAX's default device.
    """
    import jax

    options = _cpu_options(once) if jax.default_backend() == "cpu" else None
    compiled: Any = jax.jit(function, compiler_options=options, **settings)

    @wraps(function)
    def call(*arguments: Any, **named: Any) -> Any:
        if compiled._cache_size() > _MOST_COMPILED:
            compiled.clear_cache()
        with jax.enable_x64(True):
            return compiled(*arguments, **named)

    return call


def for_samples(step: Callable[[Any, Any, Any], tuple[Any, Any]]) -> Callable[..., Any]:
    """Compile a sample-by-sample pass; one program serves recordings of any length.

    It takes `_STRETCH` samples at a time. The last stretch is padded, and the padding is dropped
    from the results.

    Parameters
    ----------
    step : callable
        ``(known, carry, sample) -> (carry, output)``, trees of arrays; pure.

    Returns
    -------
    callable
        ``(known, carry, samples) -> (carry, outputs)``, with the samples along the first axis of
        each array, like `jax.lax.scan`.
    """
    import jax
    import jax.numpy as jnp

    def stretch(known: Any, carry: Any, samples: Any, real: Any) -> Any:
        def one(carry: Any, given: Any) -> Any:
            sample, real = given
            after, output = step(known, carry, sample)
            return jax.tree.map(lambda new, old: jnp.where(real, new, old), after, carry), output

        return jax.lax.scan(one, carry, (samples, real))

    compiled = for_batches(stretch)

    def call(known: Any, carry: Any, samples: Any) -> tuple[Any, Any]:
        count, parts = len(jax.tree.leaves(samples)[0]), []
        # JAX gives a plain number another type.
        carry = jax.tree.map(np.asarray, carry)
        for first in range(0, count, _STRETCH):
            chosen = np.arange(first, first + _STRETCH)
            real, within = chosen < count, np.minimum(chosen, count - 1)
            part = jax.tree.map(lambda values, rows=within: values[rows], samples)
            carry, outputs = compiled(known, carry, part, real)
            parts.append(outputs)
        outputs = jax.tree.map(lambda *values: np.concatenate(values)[:count], *parts)
        return jax.tree.map(np.asarray, carry), outputs

    return call


def lengthened(values: np.ndarray, shortest: int = 1) -> np.ndarray:
    """Repeat the last row up to a power of two, so that one program serves many recordings."""
    missing = max(shortest, 1 << (len(values) - 1).bit_length()) - len(values)
    return np.pad(values, [(0, missing)] + [(0, 0)] * (values.ndim - 1), mode="edge")


@dataclass(frozen=True, eq=False)
class Applied:
    """A function of an array namespace, of what is known, and of arrays: all but the latter bound.

    With other numbers in `known`, such as another craft's coefficients, the program is the same.
    It is another one for other numbers in the function's closure, and in objects that JAX does not
    know (`airpuck.compute.arrays.register_pytree`).
    """

    function: Callable[..., Any]
    known: Any

    def __call__(self, xp: Any, *arrays: Any) -> Any:
        """Call the function."""
        return self.function(xp, self.known, *arrays)


def program(function: Callable[..., Any], *examples: Any, compiled: bool) -> Callable[..., Any]:
    """Bind a function to its array namespace, compiled for real time or as plain NumPy.

    Parameters
    ----------
    function : callable or Applied
        Takes an array namespace and arrays, returns a tuple of arrays; pure.
    *examples : array or float
        Arrays of the shapes that it will be called with.
    compiled : bool
        Whether to compile it over jax.numpy or run it over numpy.

    Returns
    -------
    callable
        A function from NumPy arrays to NumPy arrays.
    """
    if not compiled:
        return partial(function, np)
    import jax
    import jax.numpy as jnp

    register_pytree(Applied)
    leaves, structure = jax.tree.flatten(function)
    real = float, np.ndarray
    free = [isinstance(leaf, real) and np.asarray(leaf).dtype.kind == "f" for leaf in leaves]
    numbers = [leaf for leaf, one in zip(leaves, free, strict=True) if one]
    fixed = tuple(leaf for leaf, one in zip(leaves, free, strict=True) if not one)
    places = _places([np.shape(leaf) for leaf in numbers])

    def bound(vector: Any, *arrays: Any) -> Any:
        rest, own = iter(fixed), (vector[part].reshape(shape) for part, shape in places)
        both = [next(own if one else rest) for one in free]
        return jax.tree.unflatten(structure, both)(jnp, *arrays)

    vector = np.concatenate([*numbers, ()], axis=None, dtype=float)
    try:
        return partial(_kept_program(bound, vector, *examples), vector)
    except Exception:  # a user's function decides by a number, or an effect cannot be made anew
        return _kept_program(partial(function, jnp), *examples)


def _kept_program(function: Callable[..., Any], *examples: Any) -> Callable[..., Any]:
    """Compile a function, unless one with the same content was compiled before."""
    try:
        key = _content(function), tuple(np.shape(example) for example in examples)
    except (pickle.PicklingError, AttributeError, TypeError, ValueError, RecursionError):
        return _compile(function, *examples)  # it uses something that cannot be compared
    program = _kept.pop(key, None) or _compile(function, *examples)
    _kept[key] = program
    if len(_kept) > _MOST_KEPT:
        _kept.pop(next(iter(_kept)), None)
    return program


def _content(value: Any) -> Hashable:
    """Return a key that identifies a value, or a function and the variables it closes over."""
    if isinstance(value, FunctionType):
        around = tuple(_content(cell.cell_contents) for cell in value.__closure__ or ())
        defaults = _content(value.__defaults__), _content(value.__kwdefaults__)
        return value.__module__, value.__code__, defaults, around
    if isinstance(value, MethodType):
        return _content(value.__func__), pickle.dumps(value.__self__)
    if hasattr(value, "__wrapped__"):  # compiled by JAX
        return type(value).__qualname__, _content(value.__wrapped__)
    if isinstance(value, partial):
        return "partial", _content((value.func, *value.args, *value.keywords.items()))
    if isinstance(value, Applied):
        return _content(value.function), pickle.dumps(value.known)
    if type(value) is tuple:
        return tuple(map(_content, value))
    if isinstance(value, ModuleType):
        return value.__name__
    return value if type(value).__name__ == "PyTreeDef" else pickle.dumps(value)


def _compile(function: Callable[..., Any], *examples: Any) -> Callable[..., Any]:
    """Compile for the CPU, as a program from one vector to one vector."""
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
        program = lowered.compile(_cpu_options())
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
    """Concatenate arguments in double precision.

    Joining bytes takes half the time if all arrays are contiguous and in double precision.
    """
    try:
        if [argument.dtype for argument in arguments].count(_DOUBLE) == len(arguments):
            return np.frombuffer(b"".join(arguments))
    except (AttributeError, TypeError):  # a plain number, or an array that is not contiguous
        pass
    return np.concatenate(arguments, axis=None, dtype=float)


def _places(shapes: list[tuple[int, ...]]) -> list[tuple[slice, tuple[int, ...]]]:
    """Return position and shape of each of several concatenated arrays."""
    edges = accumulate(map(math.prod, shapes), initial=0)
    return [(slice(a, b), shape) for (a, b), shape in zip(pairwise(edges), shapes, strict=True)]


@cache
def _cpu_options(once: bool = False) -> dict[str, Any]:
    """Return the options that this version of XLA knows."""
    import jax

    options = _OPTIONS_ONCE if once else _OPTIONS
    with jax.default_device(jax.local_devices(backend="cpu")[0]):
        nothing = jax.jit(lambda same: same).lower(0.0)

    def known(options: dict[str, Any]) -> bool:
        try:
            nothing.compile(options)
        except jax.errors.JaxRuntimeError:
            return False
        return True

    if known(options):  # one program to compile instead of several
        return dict(options)
    return {name: value for name, value in options.items() if known({name: value})}
