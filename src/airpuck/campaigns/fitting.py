"""Fits of recordings: many models, random starts, resampled data."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
import pydantic

from airpuck.campaigns.item import Item, Row, Rung, Spread, fingerprint, moved, named
from airpuck.craft.vehicle import Vehicle, default_vehicle, read_vehicle
from airpuck.data.trajectory import Trajectory
from airpuck.estimate.encoder import PaperEncoder
from airpuck.evaluation.evaluate import evaluate
from airpuck.identification.bootstrap import bootstrap
from airpuck.identification.fit import identify
from airpuck.identification.fit_result import Fit
from airpuck.identification.transport_delay import mean_delay
from airpuck.model.parameters import Parameters
from airpuck.model.rungs import named_rung
from airpuck.preprocessing.load import load_trajectory

#: Of every fit, as in `identify`.
ENCODER = PaperEncoder(length=40)


class Fitting(Item):
    """One fit; or `resamplings` of them, to data drawn with replacement."""

    SOURCES: ClassVar = ("recordings", "validation", "vehicle")

    #: What to learn from.
    recordings: Annotated[tuple[str, ...], pydantic.Field(min_length=1)]
    #: M0 … M4 or quadratic.
    model: Rung = "M3"
    #: A recording to judge the fit on, by the paper's protocol.
    validation: str | None = None
    #: Vehicle file; by default the paper's craft.
    vehicle: str | None = None
    #: Part of each recording to learn from.
    span: tuple[float, float] | None = None
    #: By how much the start differs from the nominal values, at random (`moved`).
    start_spread: Spread = 0.0
    #: Fits to blocks of time drawn with replacement, from the fit to all data.
    resamplings: Annotated[int, pydantic.Field(ge=0)] = 0
    #: Samples from one window to the next.
    stride: Annotated[int, pydantic.Field(ge=1)] = 7
    #: Of the thrust polynomials.
    degree: Annotated[int, pydantic.Field(ge=1, le=9)] | None = None
    #: Where the offset of the centre of mass is constant.
    frame: Literal["body", "world"] = "body"
    #: Whether windows that are predicted badly count less; not of resampled data.
    robust: bool = False

    @pydantic.model_validator(mode="after")
    def _resamples_plain_fits(self) -> Fitting:
        if self.resamplings == 1:
            raise ValueError("resamplings must be 0 or at least 2")
        if self.resamplings and (self.robust or self.start_spread):
            raise ValueError("resamplings go with neither robust nor start_spread")
        return self

    def run(self) -> list[Row]:
        """Fit; see `Item.run`."""
        craft, trajectories = self.data()
        if self.resamplings:
            return self._resampled(craft)
        fit = self.fit(craft, trajectories)
        row = {
            "loss": fit.loss,
            "iterations": float(fit.iterations),
            "converged": float(fit.converged),
            "windows": float(fit.windows),
            **_parameters(craft, fit.model.parameters),
        }
        if self.validation is not None:
            judged = evaluate(fit.model, self._load(self.validation))
            row |= named("rmse", judged.rmse)
        return [row]

    def data(self) -> tuple[Vehicle, list[Trajectory]]:
        """Read the vehicle and the recordings."""
        craft = default_vehicle() if self.vehicle is None else read_vehicle(self.vehicle)
        trajectories = [self._load(name) for name in self.recordings]
        if self.span is not None:
            trajectories = [trajectory.slice(*self.span) for trajectory in trajectories]
        return craft, trajectories

    def _load(self, name: str) -> Trajectory:
        vehicle = self.vehicle
        return _trajectory(
            name, fingerprint(name), vehicle, None if vehicle is None else fingerprint(vehicle)
        )

    def fit(self, craft: Vehicle, trajectories: list[Trajectory]) -> Fit:
        """Identify, from a start of the seed's."""
        rung, start = named_rung(self.model), None
        if self.start_spread:
            nominal = rung.initial(craft, self.degree)
            nominal = replace(nominal, transport_delay=mean_delay(trajectories, craft))
            elsewhere = moved(nominal, self.start_spread, self.seed).to_vector()
            vector = np.where(rung.mask(nominal), elsewhere, nominal.to_vector())
            start = nominal.with_vector(vector)
        return identify(
            trajectories,
            rung,
            vehicle=craft,
            initial=start,
            degree=self.degree,
            encoder=ENCODER,
            stride=self.stride,
            frame=self.frame,
            robust=self.robust,
        )

    def _resampled(self, craft: Vehicle) -> list[Row]:
        """Return the parameters of each fit to resampled data, from the fit to all."""
        # A frozen pydantic model has a hash, which the type checker does not see.
        whole: Any = self.model_copy(update={"seed": 0, "resamplings": 0})
        fit = _fit_to_all(whole, whole.key(fingerprint))
        model, loss = fit.model, fit.objective
        assert loss is not None and loss.clusters is not None
        _, estimates = bootstrap(
            loss, model.parameters, model.free, loss.clusters, self.resamplings, seed=self.seed
        )
        return [_parameters(craft, model.parameters.with_vector(e)) for e in estimates]


def _parameters(craft: Vehicle, parameters: Parameters) -> Row:
    """Name the parameters."""
    labels = parameters.labels(craft.propeller_names)
    return dict(zip(labels, parameters.to_vector().tolist(), strict=True))


# Items of one campaign share recordings, and resamplings the fit that they begin at. What stands
# in the files is part of what is remembered: a worker may outlive it.


@lru_cache(maxsize=8)
def _trajectory(
    name: str, _content: str, vehicle: str | None, _vehicle_content: str | None
) -> Trajectory:
    return load_trajectory(name, None if vehicle is None else read_vehicle(vehicle))


@lru_cache(maxsize=8)
def _fit_to_all(item: Fitting, _key: str) -> Fit:
    return item.fit(*item.data())
