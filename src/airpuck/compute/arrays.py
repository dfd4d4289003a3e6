"""Array operations that JAX and NumPy write differently, over a namespace `xp`."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import MISSING, fields
from threading import Lock
from typing import Any

import numpy as np


def namespace(*values: Any) -> Any:
    """Return the namespace for computing with values: JAX's if one of them is a JAX array."""
    # A caller with a JAX array has imported JAX.
    jax = sys.modules.get("jax")
    if jax is not None and any(isinstance(value, jax.Array) for value in values):
        return jax.numpy
    return np


def generator(key: Any) -> np.random.Generator:
    """Return a random generator from a seed, a generator or a JAX key."""
    if namespace(key) is not np:
        import jax
        import jax.numpy as jnp

        if jnp.issubdtype(key.dtype, jax.dtypes.prng_key):
            key = jax.random.key_data(key)
        key = np.asarray(key).ravel().tolist()
    return np.random.default_rng(key)


def with_symbols(function: Callable[..., Any], *values: Any) -> Any:
    """Call a function of arrays, also with CasADi matrices whose columns are vectors.

    NumPy calls the methods of an array's elements, such as ``cos``, so it computes with symbols as
    with numbers. A batch of size one keeps them inside arrays: for a NumPy number times a bare
    symbol Python would call NumPy, not CasADi.
    """
    if not any(map(_is_symbolic, values)):
        numbers = namespace(*values) is np
        return function(*(np.asarray(v, dtype=float) if numbers else v for v in values))
    import casadi

    # CasADi evaluates symbols at zero, which leaves the processor's error flags set.
    with np.errstate(all="ignore"):
        result = function(*(_elements(value)[..., None] for value in values))[..., 0]
    rows = result if result.ndim == 2 else result[:, None]
    return casadi.vertcat(*(casadi.horzcat(*row) for row in rows))


def _elements(value: Any) -> np.ndarray:
    """Return an array of the elements of a CasADi matrix, or of an array."""
    if not _is_symbolic(value):
        return np.asarray(value, dtype=float)
    array = np.empty(value.shape, dtype=object)
    for entry in np.ndindex(value.shape):
        array[entry] = value[entry]
    return array[:, 0] if value.shape[1] == 1 else array


def _is_symbolic(value: Any) -> bool:
    """Return whether a value is a CasADi matrix."""
    return type(value).__module__.partition(".")[0] == "casadi"


#: Fits run in parallel threads, and JAX rejects a second registration.
_registered: set[Any] = set()
_registering = Lock()


def coefficients_of(kind: Any) -> dict[str, float]:
    """Return the float fields of a dataclass that have a default: what a fit may learn."""
    return {
        one.name: one.default
        for one in fields(kind)
        if one.init
        and isinstance(one.default, float if one.type not in (float, "float") else float | int)
    }


def settings_of(kind: Any) -> list[str]:
    """Return the names of the other fields of a dataclass that have a default."""
    given = {one.name for one in fields(kind) if one.init and one.default is not MISSING}
    return [*(given - coefficients_of(kind).keys())]


def register_pytree(kind: Any, static: Callable[[Any], Sequence[str]] = lambda _: ()) -> None:
    """Let JAX see the arrays inside a dataclass; the fields that `static` names contain none.

    JAX treats another class as a constant. `register_dataclass` will not do: in jaxlib 0.10.2,
    trees of two such classes with the same number of fields are equal, so that the program of one
    could run for the other.
    """
    from jax.tree_util import register_pytree_node, register_static

    with _registering:
        if kind in _registered:
            return
        _registered.add(kind)
        if not hasattr(kind, "__dataclass_fields__"):
            register_static(kind)
            return
        fixed = list(static(kind))
        names = [entry.name for entry in fields(kind) if entry.init and entry.name not in fixed]

        def values_of(one: Any, names: list[str]) -> tuple[Any, ...]:
            return tuple(getattr(one, name) for name in names)

        register_pytree_node(
            kind,
            lambda one: (values_of(one, names), values_of(one, fixed)),
            lambda rest, values: kind(**dict(zip(names + fixed, (*values, *rest), strict=True))),
        )


def linear_map(matrix: Any, vector: Any) -> Any:
    """Apply a matrix, shared or one per batch entry, to vectors (batch as last axis)."""
    if matrix.ndim == 2 and vector.ndim <= 2:
        return matrix @ vector
    if matrix.ndim == 2:
        matrix = matrix.reshape(matrix.shape + (1,) * (vector.ndim - 1))
    # An explicit sum: XLA's reduction over an axis takes several times as long on a CPU.
    return sum(matrix[:, i] * vector[i] for i in range(matrix.shape[1]))


def small_product(xp: Any, left: Any, right: Any) -> Any:
    """Multiply a small matrix, or a stack of them, by others or by a vector.

    An explicit sum: XLA calls a library for `@`, which costs more than the arithmetic.
    """
    if right.ndim == 1:
        return xp.sum(left * right, axis=-1)
    return xp.sum(left[..., :, :, None] * right[..., None, :, :], axis=-2)


def scan(xp: Any, body: Callable[[Any, Any], tuple[Any, Any]], carry: Any, inputs: Any) -> Any:
    """Loop over the leading axis, like `jax.lax.scan`."""
    if xp is not np:
        import jax

        return jax.lax.scan(body, carry, inputs)
    outputs = []
    for values in zip(*inputs, strict=True):
        carry, output = body(carry, values)
        outputs.append(output)
    return carry, np.stack(outputs)


def slopes(xp: Any, function: Callable[[Any], Any], point: Any) -> Any:
    """Differentiate a function of arrays (k, B), a batch of vectors, by each of the k: (k, p, B).

    In forward mode under JAX, by complex steps under NumPy.
    """
    if xp is np:
        count, step = len(point), 1e-30
        # The direction becomes the last axis of the batch.
        along = np.eye(count).reshape(count, *[1] * (point.ndim - 1), count)
        moved = point[..., None] + 1j * step * along
        return np.moveaxis(np.imag(function(moved)), -1, 0) / step
    import jax

    _, along = jax.linearize(function, point)
    each = xp.broadcast_to(xp.eye(len(point))[:, :, None], (len(point), *point.shape))
    return jax.vmap(along)(each)


def if_any(xp: Any, condition: Any, function: Callable[[Any], Any], value: Any) -> Any:
    """Apply a function if a condition holds for any of a batch; else return the value."""
    if xp is not np:
        import jax

        return jax.lax.cond(condition.any(), function, lambda same: same, value)
    return function(value) if condition.any() else value


def repeat_while(
    xp: Any, condition: Callable[[Any], Any], body: Callable[[Any], Any], value: Any
) -> Any:
    """Apply a function while a condition holds, like `jax.lax.while_loop`."""
    if xp is not np:
        import jax

        return jax.lax.while_loop(condition, body, value)
    while condition(value):
        value = body(value)
    return value
