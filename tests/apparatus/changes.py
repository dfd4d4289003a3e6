"""Copies of settings and vehicles in which something differs."""

from collections.abc import Callable
from typing import Any

from airpuck.craft.vehicle import Propeller, Vehicle


def changed(whole: Any, **fields: Any) -> Any:
    """Copy settings with other fields; a dictionary changes those of a section."""
    new = {
        name: changed(getattr(whole, name), **value) if isinstance(value, dict) else value
        for name, value in fields.items()
    }
    return whole.model_copy(update=new)


def with_propellers(vehicle: Vehicle, change: Callable[[int, Propeller], dict]) -> Vehicle:
    """Copy a vehicle whose propellers have other fields, by number and propeller."""
    each = enumerate(vehicle.propellers)
    propellers = tuple(one.model_copy(update=change(k, one)) for k, one in each)
    return vehicle.model_copy(update={"propellers": propellers})
