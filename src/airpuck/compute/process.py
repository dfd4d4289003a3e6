"""Cores, threads and caches of the whole process; only commands and games change its settings."""

from __future__ import annotations

import os
import warnings
from contextlib import suppress

#: Priority above ordinary processes, below the system's own.
_PRIORITY = 10
#: XLA reads the size of its thread pool from here; it has no option for that.
_POOL = "NPROC"


def prioritize(*, first: bool) -> None:
    """Request real-time priority for this thread, or give it up; the system may refuse."""
    with suppress(OSError, AttributeError):
        policy, priority = (os.SCHED_FIFO, _PRIORITY) if first else (os.SCHED_OTHER, 0)
        os.sched_setscheduler(0, policy, os.sched_param(priority))


def usable_cores() -> int:
    """Count the cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def single_threaded_algebra() -> None:
    """Restrict linear algebra to one thread; this works only before NumPy is imported.

    Matrices here are small: BLAS threads would wait for each other and slow down JAX's threads.
    """
    for library in ("OPENBLAS", "OMP"):
        os.environ.setdefault(f"{library}_NUM_THREADS", "1")


def keep_compiled_programs() -> None:
    """Store JAX's programs in the user's cache folder, unless the environment names another.

    Only commands do so: a process that imports airpuck keeps its own JAX settings.
    """
    # If the disk is full, the command continues without the cache and without a warning.
    warnings.filterwarnings("ignore", "Error (reading|writing) persistent compilation cache")
    if "JAX_COMPILATION_CACHE_DIR" in os.environ:
        return
    from platformdirs import user_cache_path

    folder = user_cache_path("airpuck", appauthor=False) / "compiled"
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return
    if os.access(folder, os.W_OK):
        os.environ["JAX_COMPILATION_CACHE_DIR"] = str(folder)
        # Control needs half a dozen programs that compile in 0.05 s each.
        os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")


def low_latency() -> bool:
    """Run programs of any size in the calling thread; call this before JAX first computes.

    By default JAX passes large programs to another thread, which takes 10 µs or more, and XLA
    passes parts of them to a pool. Threads of the pool have no priority: while other processes keep
    the cores busy, a loop with priority waits for them, up to 0.3 s (`studies/live_loop.py`).
    Returns whether the setting came in time.
    """
    import jax

    if not large_programs_are_fast() and not _has_computed():
        jax.config.update("jax_cpu_enable_async_dispatch", False)
        before = os.environ.get(_POOL)
        os.environ[_POOL] = "1"
        jax.local_devices(backend="cpu")  # creates the pool
        if before is None:
            del os.environ[_POOL]
        else:
            os.environ[_POOL] = before
    return large_programs_are_fast()


def large_programs_are_fast() -> bool:
    """Return whether one large program is faster than two small ones; see `low_latency`."""
    import jax

    return not jax.config.read("jax_cpu_enable_async_dispatch")


def _has_computed() -> bool:
    """Return whether JAX has started its backends, after which the setting has no effect."""
    try:
        from jax._src import xla_bridge  # there is no public function for this

        return xla_bridge.backends_are_initialized()
    except (ImportError, AttributeError):
        return False  # commands call `low_latency` before the first computation
