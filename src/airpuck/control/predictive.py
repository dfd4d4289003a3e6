"""Settings of the predictive law."""

from __future__ import annotations

from typing import Annotated, Any, Self

import pydantic

from airpuck.boundary.files import NonNegative, Positive, Section
from airpuck.control.lqr import TUNED, PositiveWeight, Weights
from airpuck.control.tuning import LawSettings

#: Limits on steps of a horizon and on discs: with more, a prediction takes longer than a period.
_MOST_STEPS, _MOST_DISCS = 80, 8


class PredictiveWeights(Weights):
    """Weights of the predictive law: the LQR's, and one for the commands."""

    #: Weight of commands above idle.
    command: PositiveWeight = 0.05


class SoftLimits(Section):
    """Limits of the predictive law besides the motors'; exceeded only if unavoidable."""

    #: Area in which the craft's centre may be: lowest x and y, highest x and y. By default the
    #: table minus the craft's radius and a margin.
    fence_m: tuple[float, float, float, float] | None = None
    #: Smallest distance of the craft's edge from the rails.
    margin_m: NonNegative = 0.004
    #: A moving craft must also be inside the fence this much later, because commands may get lost.
    headway_s: Annotated[float, pydantic.Field(ge=0, le=1)] = 0.05
    #: Limits along the planned trajectory.
    speed_m_s: Positive | None = None
    spin_rad_s: Positive | None = None
    #: Discs to keep out of: x and y of the centre, and the smallest distance of the craft's centre.
    keep_out_m: Annotated[
        tuple[tuple[float, float, Positive], ...], pydantic.Field(max_length=_MOST_DISCS)
    ] = ()
    #: Cost of exceeding a limit by a metre, metre per second or radian per second.
    penalty: Annotated[float, pydantic.Field(ge=1, le=1e8)] = 1e4

    @pydantic.field_validator("fence_m")
    @classmethod
    def _right_way_up(
        cls, fence: tuple[float, float, float, float] | None
    ) -> tuple[float, float, float, float] | None:
        if fence is not None and not (fence[0] < fence[2] and fence[1] < fence[3]):
            raise ValueError("must be lowest x and y, then highest x and y: [-1.0, -0.5, 1.0, 0.5]")
        return fence


def _listed(value: Any) -> Any:
    """Accept a single number as a list of one."""
    return tuple(value) if isinstance(value, list | tuple) else (value,)


class PredictiveSettings(LawSettings):
    """Settings of the predictive law."""

    law = "mpc"
    tuned = TUNED

    #: Length of the prediction, in steps of step_s; at most 80 steps.
    horizon_s: Annotated[float, pydantic.Field(ge=0.02, le=5.0)] = 0.6
    step_s: Annotated[float, pydantic.Field(ge=1e-3, le=0.1)] = 0.02
    #: Number of steps per command, block after block; the last number repeats. A single number
    #: applies to all blocks.
    block: Annotated[
        tuple[Annotated[int, pydantic.Field(ge=1, le=50)], ...],
        pydantic.Field(min_length=1, max_length=80),
        pydantic.BeforeValidator(_listed),
    ] = (1, 1, 2, 2, 3)
    #: Largest number of solver iterations.
    iterations: Annotated[int, pydantic.Field(ge=1, le=10_000)] = 400
    weights: PredictiveWeights
    limits: SoftLimits = SoftLimits()

    @pydantic.model_validator(mode="after")
    def _in_time(self) -> Self:
        if self.step_s > self.horizon_s:
            raise ValueError(
                f"step_s = {self.step_s:g} is longer than horizon_s = {self.horizon_s:g}; use a "
                "shorter step or a longer horizon"
            )
        steps = round(self.horizon_s / self.step_s)
        if steps > _MOST_STEPS:
            raise ValueError(
                f"horizon_s / step_s is {steps} steps; at most {_MOST_STEPS} can be predicted in "
                "time: use a longer step or a shorter horizon"
            )
        return self

    def held(self, period_s: float) -> Self:
        """Make no step shorter than a period; see `LawSettings.held`."""
        longer = max(period_s / self.step_s, 1.0)
        times = {"step_s": longer * self.step_s, "horizon_s": longer * self.horizon_s}
        return self.model_copy(update=times)
