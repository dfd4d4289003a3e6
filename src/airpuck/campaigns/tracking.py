"""Closed loops on the twin: set points, flown with noise, radio and craft of each seed."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

import numpy as np
import pydantic

from airpuck.campaigns.item import Item, Row, Spread, TuningTable, TwinTable, named, varied
from airpuck.control.tuning import default_tuning
from airpuck.model.model_file import read_model
from airpuck.twin.settings import default_twin_settings
from airpuck.twin.tracking_study import DWELL, Tracked, tracking_study


class Tracking(Item):
    """One flight to the paper's set points."""

    SOURCES: ClassVar = ("model", "truth")

    #: What the controller believes.
    model: str = "paper:M4"
    #: The twin's truth.
    truth: str = "paper:M4"
    #: By how much the truth differs from that, at random (`varied`).
    truth_spread: Spread = 0.0
    #: Time at each set point.
    dwell_s: Annotated[float, pydantic.Field(ge=0.1, le=1000)] = DWELL
    #: As flown, or compensating the delay and rejecting disturbances, too.
    controller: Literal["paper", "full"] = "paper"
    #: Table, sensors, radio, faults.
    twin: TwinTable = pydantic.Field(default_factory=default_twin_settings)
    #: Of the controller.
    tuning: TuningTable = pydantic.Field(default_factory=default_tuning)

    def run(self) -> list[Row]:
        """Fly; see `Item.run`."""
        truth = varied(read_model(self.truth), self.truth_spread, self.seed)
        (flown,) = tracking_study(
            [read_model(self.model)],
            truth,
            dwell=self.dwell_s,
            seed=self.seed,
            full_controller=self.controller == "full",
            settings=self.twin,
            tuning=self.tuning,
        )
        reach = self.twin.table.reach(truth.vehicle.radius_m)
        clearance = np.asarray(reach) - np.abs(flown.twin.pose[:, :2]).max(axis=0)
        return [{**flight_figures(flown), "clearance_m": float(clearance.min())}]


def flight_figures(flown: Tracked) -> Row:
    """Sum up a flight to set points."""
    results, unknown = flown.results, (np.nan,) * 3
    settled = [r.settling_time for r in results if r.settling_time is not None]
    steady = np.abs([r.steady_state_error or unknown for r in results])
    inexact = sum(count for status, count in flown.outcomes.items() if status != "exact")
    return {
        "not_settled": float(len(results) - len(settled)),
        "settling_time_s": float(np.mean(settled)) if settled else np.nan,
        **named("steady_state_error", steady.max(axis=0)),
        **named("overshoot", np.max([r.overshoot for r in results], axis=0)),
        "effort": float(np.mean([r.effort for r in results])),
        "inexact": inexact / sum(flown.outcomes.values()),
    }
