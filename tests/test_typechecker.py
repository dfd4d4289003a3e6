"""Signatures are checked in the first calls of each test."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from jaxtyping import Float, TypeCheckError

from .apparatus import typechecker


@typechecker.jaxtyped(typechecker=typechecker.check)
def total(one: Float[np.ndarray, " N"], other: Float[np.ndarray, " N"]) -> Float[np.ndarray, " N"]:
    return (one + other)[: 2 if one[0] < 0 else None]


@typechecker.jaxtyped(typechecker=typechecker.check)
@dataclass
class Pair:
    one: Float[np.ndarray, " N"]
    other: Float[np.ndarray, " N"]


@pytest.mark.parametrize("kind", [total, Pair])
def test_shapes_are_checked_jointly(kind):
    kind(np.ones(3), np.ones(3))
    with pytest.raises(TypeCheckError):
        kind(np.ones(3), np.ones(1))
    with pytest.raises(TypeCheckError):
        kind(np.ones(3, dtype=int), np.ones(3))


@pytest.mark.parametrize("time", [1, 2])
def test_only_the_first_calls_are_checked(time):
    with pytest.raises(TypeCheckError):
        total(-np.ones(3), np.ones(3))
    for _ in range(typechecker.CHECKED):
        total(np.ones(3), np.ones(3))
    assert len(total(-np.ones(3), np.ones(3))) == 2


def test_calls_of_the_package_are_checked():
    from airpuck.physics.thrust import is_monotone

    with pytest.raises(TypeCheckError):
        is_monotone(np.ones(3))


def test_a_compiled_program_is_reused_after_its_functions_were_checked():
    from airpuck.compute.compiled import program

    @typechecker.jaxtyped(typechecker=typechecker.check)
    def half(value: Float[Any, "2"]) -> Any:
        return value / 2

    def bind() -> Any:
        @typechecker.jaxtyped(typechecker=typechecker.check)
        def quarter(xp: Any, value: Float[Any, "2"]) -> tuple[Any]:
            return (half(half(value)),)

        return program(quarter, np.ones(2), compiled=True)

    first = bind()
    np.testing.assert_array_equal(first(np.ones(2))[0], [0.25, 0.25])
    assert bind().func is first.func
