"""What an excitation experiment is flown with, as a TOML file."""

from __future__ import annotations

import os
from typing import Annotated

import pydantic

from airpuck.boundary.files import Section, read_toml, write_toml

Share = Annotated[float, pydantic.Field(ge=0, le=1)]
Positive = Annotated[float, pydantic.Field(gt=0)]


class ExcitationPlan(Section):
    """An excitation experiment; what is left out is as the paper flew it."""

    #: Largest signal, of all or of each: those of the pairs, then those of the propellers without a
    #: partner.
    amplitude: Share | tuple[Share, ...] = 1.0
    #: Time between changes of the signals.
    hold_s: Positive = 0.2
    #: Length.
    duration_s: Positive = 90.0
    #: Distance to the rails at which the craft must be able to stop; else the signals pause.
    margin_m: Annotated[float, pydantic.Field(ge=0)] = 0.05

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the plan as TOML."""
        write_toml(path, self.model_dump(mode="json"), header="An airpuck excitation experiment.")


def read_excitation_plan(path: str | os.PathLike[str]) -> ExcitationPlan:
    """Read the plan of an excitation experiment."""
    return read_toml(path, ExcitationPlan, base=ExcitationPlan())
