"""Dynamics and effects as pytrees, so that JAX sees the arrays inside."""

from __future__ import annotations

from dataclasses import fields
from functools import cache

from airpuck.physics.effects import KINDS
from airpuck.physics.rigid_body import Dynamics


@cache
def register_pytrees() -> None:
    """Let JAX see into `Dynamics` and all effects; once is enough."""
    from jax.tree_util import register_dataclass

    for kind in (Dynamics, *KINDS):
        names = [field.name for field in fields(kind)]
        register_dataclass(kind, [n for n in names if n != "frame"], ["frame"] * ("frame" in names))
