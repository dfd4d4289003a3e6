"""Compile small array functions for real time.

A NumPy call costs about a microsecond whatever the array's size, and a control step has hundreds of
them; one call of a compiled program costs ten. The functions stay what they are, plain array
operations over a namespace: compiled here for the controller, run by NumPy in tests.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np


def for_real_time(function: Callable[..., Any], *examples: Any) -> Callable[..., Any]:
    """Compile a pure function of arrays, in double precision, for the CPU.

    Parameters
    ----------
    function : callable
        Takes arrays, returns a tuple of arrays; uses jax.numpy.
    *examples : array or float
        Arguments of the shapes that it will be called with.

    Returns
    -------
    callable
        The same function: NumPy arrays in, a tuple of NumPy arrays (read-only) out. It neither
        depends on nor changes JAX's settings.
    """
    import jax

    cpu = jax.local_devices(backend="cpu")[0]
    with jax.enable_x64(True), jax.default_device(cpu):
        arguments = [np.asarray(example, dtype=float) for example in examples]
        program = jax.jit(function).lower(*arguments).compile()

    def call(*arguments: Any) -> tuple[np.ndarray, ...]:
        with jax.enable_x64(True):
            return tuple(map(np.asarray, program(*arguments)))

    return call
