"""What every kind of item shares: its content, its key, and the figures that it yields."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, ClassVar, TypeVar

import numpy as np
import pydantic

from airpuck import __version__
from airpuck.boundary.errors import InputError
from airpuck.boundary.files import Section, checked, laid_over
from airpuck.control.tuning import Tuning, default_tuning
from airpuck.model.model_file import Model
from airpuck.model.parameters import Parameters
from airpuck.model.rungs import named_rung
from airpuck.recording.fingerprint import sha256
from airpuck.twin.settings import TwinSettings, default_twin_settings

#: Figures by name; what is not known is nan.
Row = dict[str, float]

Packaged = TypeVar("Packaged", TwinSettings, Tuning)

#: Tables of a spec name only what differs from the packaged files.
TwinTable = Annotated[
    TwinSettings, pydantic.BeforeValidator(lambda table: _whole(table, default_twin_settings()))
]
TuningTable = Annotated[
    Tuning, pydantic.BeforeValidator(lambda table: _whole(table, default_tuning()))
]
#: Name of a rung, with terms or without.
Rung = Annotated[str, pydantic.AfterValidator(lambda name: _known_rung(name))]
Seed = Annotated[int, pydantic.Field(ge=0)]
Spread = Annotated[float, pydantic.Field(ge=0, le=1)]


def _known_rung(name: str) -> str:
    """Refuse a rung that there is not."""
    try:
        named_rung(name)
    except InputError as error:
        raise ValueError(error.problem) from None
    return name


def _whole(table: Any, packaged: Packaged) -> Packaged:
    """Lay a table of a spec over the packaged file."""
    if not isinstance(table, Mapping):
        raise ValueError("must be a table")
    return checked(laid_over(packaged.model_dump(mode="json"), table), type(packaged))


class Item(Section):
    """Base of all kinds: a computation that is wholly described by its fields."""

    #: Fields that name models or recordings: their content belongs to the key.
    SOURCES: ClassVar[tuple[str, ...]] = ()

    #: Of everything random in it.
    seed: Seed = 0

    def run(self) -> list[Row]:
        """Compute."""
        raise NotImplementedError

    def key(self, fingerprint: Callable[[str], str]) -> str:
        """Identify the computation: its fields, what is in the files it names, our version."""
        content = self.model_dump(mode="json")
        for field in self.SOURCES:
            names = content[field] if isinstance(content[field], list) else [content[field]]
            content[field] = [
                name if name is None or name.startswith("paper:") else fingerprint(name)
                for name in names
            ]
        told = json.dumps([type(self).__name__, __version__, content], sort_keys=True)
        return hashlib.sha256(told.encode()).hexdigest()[:20]


@dataclass(frozen=True)
class Entry:
    """An item and its place in the campaign."""

    #: Of the item: the same computation has the same key in every campaign.
    key: str
    #: What the grid says of it, by dotted field.
    setting: dict[str, Any]
    #: What to compute.
    item: Item


def fingerprint(name: str) -> str:
    """Return the hash of a file, or of all files in a folder."""
    path = Path(name)
    if not path.is_dir():
        return sha256(path)
    files = sorted(file for file in path.rglob("*") if file.is_file())
    told = [f"{file.relative_to(path)} {sha256(file)}" for file in files]
    return hashlib.sha256("\n".join(told).encode()).hexdigest()


def moved(parameters: Parameters, spread: float, seed: int) -> Parameters:
    """Multiply thrusts, inertia and motor lag by random factors."""
    rng = np.random.default_rng([seed, 7])
    inertia, lag, *thrust = np.exp(spread * rng.normal(size=2 + len(parameters.thrust)))
    return replace(
        parameters,
        thrust=parameters.thrust * np.array(thrust)[:, None],
        inertia=parameters.inertia * inertia,
        motor_time_constant=parameters.motor_time_constant * lag,
    )


def varied(model: Model, spread: float, seed: int) -> Model:
    """Return another craft of the kind, its parameters `moved`."""
    if not spread:
        return model
    return replace(model, parameters=moved(model.parameters, spread, seed), uncertainty=None)


def named(prefix: str, values: Any) -> Row:
    """Name the channels x, y [m] and yaw [rad] of a figure."""
    channels = ("x_m", "y_m", "yaw_rad")
    return {f"{prefix}_{name}": float(v) for name, v in zip(channels, values, strict=True)}
