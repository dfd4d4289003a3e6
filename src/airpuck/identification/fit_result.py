"""What a fit found, and its figures for machines."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from airpuck.identification.fault_exclusion import Exclusion
from airpuck.identification.identifiability import Identifiability
from airpuck.identification.method import Iteration
from airpuck.identification.objective import PredictionLoss
from airpuck.identification.packet_delays import PacketDelays
from airpuck.model.model_file import Model
from airpuck.model.uncertainty import Uncertainty


@dataclass(frozen=True)
class Fit:
    """Result of `airpuck.identify`.

    Attributes
    ----------
    model : Model
        The identified model.
    loss : float
        Mean squared weighted prediction error over windows, steps and channels, without any
        regulariser; see `PredictionLoss`. Where the delay was learned, with packets at the times
        at which they arrived.
    history : tuple of Iteration
        The optimiser's way.
    converged : bool
        Whether the optimiser stopped by its own criterion.
    message : str
        Why it stopped.
    windows : int
        Windows in the loss.
    wall_s : float
        Time it took [s].
    warnings : tuple of str
        What to look at before trusting the model.
    identifiability : Identifiability or None
        What the data say about the parameters; `identify` always finds it.
    exclusion : Exclusion or None
        The faults that were found and kept out of the fit; None where none were searched.
    packet_delays : tuple of PacketDelays
        When single packets arrived, in each recording; empty where the delay was not learned.
    objective : PredictionLoss or None
        What was minimised last: the windows, as prepared, and how much each counts. `identify`
        always tells it.
    """

    model: Model
    loss: float
    history: tuple[Iteration, ...]
    converged: bool
    message: str
    windows: int
    wall_s: float
    warnings: tuple[str, ...]
    identifiability: Identifiability | None = None
    exclusion: Exclusion | None = None
    packet_delays: tuple[PacketDelays, ...] = ()
    objective: PredictionLoss | None = field(default=None, repr=False)

    @property
    def uncertainty(self) -> Uncertainty | None:
        """How well the parameters are known; `identify` always finds it."""
        return self.model.uncertainty

    @property
    def iterations(self) -> int:
        """Steps of the optimiser."""
        return self.history[-1].number

    def to_json(self) -> dict[str, Any]:
        """Return the figures for ``--json``.

        Returns
        -------
        dict
            ``model, loss, iterations, converged, windows, wall_s, warnings, parameters,
            uncertainty, identifiability, delay_jitter, faults, history``.
        """
        return {
            "model": self.model.name,
            "loss": self.loss,
            "iterations": self.iterations,
            "converged": self.converged,
            "windows": self.windows,
            "wall_s": self.wall_s,
            "warnings": list(self.warnings),
            "parameters": _parameters_json(self.model),
            "uncertainty": _uncertainty_json(self.uncertainty),
            "identifiability": self.identifiability and self.identifiability.to_json(),
            "delay_jitter": self.model.delay_jitter and self.model.delay_jitter.model_dump(),
            "faults": self.exclusion and self.exclusion.to_json(),
            "history": [asdict(iteration) for iteration in self.history],
        }


def _parameters_json(model: Model) -> dict[str, dict[str, Any]]:
    """Return every parameter with its errors, by label; None where there is none."""
    known, figures = model.uncertainty, {}
    labels = model.parameters.labels(model.vehicle.propeller_names)
    for entry, (label, value) in enumerate(zip(labels, model.parameters.to_vector(), strict=True)):
        figures[label] = {"value": float(value), "standard_error": None, "interval_95": None}
        if known is None:
            continue
        if np.isfinite(known.standard_errors[entry]):
            figures[label]["standard_error"] = float(known.standard_errors[entry])
            figures[label]["interval_95"] = known.intervals[entry].tolist()
        if known.bootstrap is not None:
            ends = (known.bootstrap.lower[entry], known.bootstrap.upper[entry])
            figures[label]["bootstrap_95"] = (
                [float(end) for end in ends] if np.isfinite(ends).all() else None
            )
    return figures


def _uncertainty_json(known: Uncertainty | None) -> dict[str, Any] | None:
    """Return what the standard errors rest on."""
    if known is None:
        return None
    found: dict[str, Any] = {"clusters": known.clusters, "notes": list(known.notes)}
    if known.bootstrap is not None:
        found["replicates"], found["seed"] = known.bootstrap.replicates, known.bootstrap.seed
    return found
