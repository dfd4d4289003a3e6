"""Open-loop flights in batches: how far craft come apart that differ a little."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

import numpy as np
import pydantic

from airpuck.campaigns.item import Item, Row, Spread, TwinTable, named, varied
from airpuck.model.model_file import read_model
from airpuck.twin.fleet import fly_fleet
from airpuck.twin.settings import default_twin_settings


class Fleet(Item):
    """A batch of craft that fly the same commands, beside one that is as the model says."""

    SOURCES: ClassVar = ("model",)

    #: The craft.
    model: str = "paper:M3"
    #: By how much each craft differs from it, at random (`varied`).
    spread: Spread = 0.0
    #: Their number.
    craft: Annotated[int, pydantic.Field(ge=1)] = 500
    #: Length of the flight; commands are drawn anew every `hold_s`, up to `amplitude`.
    duration_s: Annotated[float, pydantic.Field(gt=0)] = 0.5
    hold_s: Annotated[float, pydantic.Field(ge=0.01)] = 0.2
    amplitude: Annotated[float, pydantic.Field(gt=0, le=1)] = 1.0
    #: Of the arithmetic.
    precision: Literal["double", "single"] = "double"
    #: Table, sensors, radio.
    twin: TwinTable = pydantic.Field(default_factory=default_twin_settings)

    def run(self) -> list[Row]:
        """Fly; see `Item.run`."""
        model = read_model(self.model)
        vehicle = model.vehicle
        hold = round(self.hold_s / 0.01)
        steps = max(1, round(self.duration_s / 0.01))
        rng = np.random.default_rng([self.seed, 8])
        drawn = rng.uniform(
            vehicle.command_min,
            max(vehicle.command_min, self.amplitude),
            (-(-steps // hold), vehicle.n_propellers),
        )
        command = np.repeat(drawn, hold, axis=0)[:steps]
        # Seeds of different items of a campaign must not meet.
        seeds = rng.integers(2**62, size=self.craft).tolist()
        models = [model, *(varied(model, self.spread, seed) for seed in seeds)]
        flight = fly_fleet(
            models,
            command,
            seeds=[self.seed, *seeds],
            settings=self.twin,
            precision=self.precision,
        )
        apart = flight.state[:, :3, 1:] - flight.state[:, :3, :1]
        return [named("apart", displacement) for displacement in apart[-1].T]
