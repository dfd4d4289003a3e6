"""How XLA compiles for a CPU what is small or runs in batches side by side."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

#: XLA may give the parts of a program to several threads, which costs more than the arithmetic of
#: small ones, and takes cores from batches that run side by side; this order of the parts does not.
#: And it uses half of a processor's vectors of 512 bits.
_OPTIONS: dict[str, Any] = {
    "xla_cpu_scheduler_type": "CPU_SCHEDULER_TYPE_MEMORY_OPTIMIZED",
    "xla_cpu_prefer_vector_width": 512,
}


@cache
def cpu_options() -> dict[str, Any]:
    """Say how XLA should compile for a CPU what is small or runs in batches side by side."""
    import jax

    with jax.default_device(jax.local_devices(backend="cpu")[0]):
        nothing = jax.jit(lambda same: same).lower(0.0)

    def known(options: dict[str, Any]) -> bool:
        try:
            nothing.compile(options)
        except jax.errors.JaxRuntimeError:
            return False
        return True

    if known(_OPTIONS):  # one thing to compile instead of several
        return dict(_OPTIONS)
    return {name: value for name, value in _OPTIONS.items() if known({name: value})}


def for_batches(function: Callable[..., Any], **settings: Any) -> Any:
    """Compile a function that is called with batches of the work, several at once on a CPU.

    Parameters
    ----------
    function : callable
        What `jax.jit` takes, for JAX's default device.
    **settings : dict
        Others of `jax.jit`.

    Returns
    -------
    callable
        What it returns.
    """
    import jax

    options = cpu_options() if jax.default_backend() == "cpu" else None
    return jax.jit(function, compiler_options=options, **settings)
