"""Results of a fit: numbers for machines, sentences for people."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from airpuck.boundary.results import Result
from airpuck.data.trajectory import Trajectory
from airpuck.deviation.packet_delays import PacketDelays
from airpuck.evaluation.presentation import at_bounds, delay_words
from airpuck.identification.method import Iteration, Optimum
from airpuck.identification.objective import PredictionLoss
from airpuck.identification.problem import Exclusion
from airpuck.identification.uncertainty import Identifiability
from airpuck.model.model_file import Model
from airpuck.model.uncertainty import Uncertainty
from airpuck.physics.thrust import lowest_slope
from airpuck.preprocessing.quality import left_out_words

#: A motor whose command stays within this range reveals nothing about its thrust.
_IDLE_RANGE = 0.02
#: Difference between a recording's own delay and the fitted one above which its clocks or its radio
#: differ: three samples at 240 Hz [s], and at least one sample of the recording.
_FAR = 3 / 240


@dataclass(frozen=True)
class Fit(Result):
    """Result of `airpuck.identify`.

    Attributes
    ----------
    model : Model
        The identified model.
    loss : float
        Mean squared weighted prediction error over windows, steps and channels, without any
        regulariser; see `PredictionLoss`. If the delay was learned, with retimed packets.
    history : tuple of Iteration
        The iterations of all fits, in order.
    converged : bool
        Whether the optimiser stopped by its own criterion.
    message : str
        Reason for stopping.
    windows : int
        Number of windows in the loss.
    wall_s : float
        Computing time [s].
    warnings : tuple of str
        Issues to check before trusting the model.
    identifiability : Identifiability or None
        What the data determine about the parameters; `identify` always sets it.
    exclusion : Exclusion or None
        The faults that were found and excluded; None if they were not searched for.
    packet_delays : tuple of PacketDelays
        Arrival times of single packets in each recording; empty if the delay was not learned.
    objective : PredictionLoss or None
        The loss that was minimised last, with its windows and weights; `identify` always sets it.

    Examples
    --------
    >>> isinstance(fit, airpuck.Fit), fit.converged, fit.windows > 100
    (True, True, True)
    >>> fit.model.save("model.toml")
    """

    JSON = (
        "model=model.name loss iterations converged windows wall_s warnings identifiability "
        "delay_jitter=model.delay_jitter faults=exclusion history"
    )

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

    def __repr__(self) -> str:
        return f"Fit({outcome_words(self)[0]})"

    def _repr_html_(self) -> str:
        return self.model.html(outcome_words(self)[0])

    def table(self) -> Any:
        """Return the parameters with their errors; see `Model.table`.

        Returns
        -------
        pandas.DataFrame or dict
            A row for each parameter.
        """
        return self.model.table()

    def covariance(self) -> Any:
        """Return the labelled covariance of the learned parameters; see `Model.covariance`.

        Returns
        -------
        pandas.DataFrame or dict
            A row and a column for each learned parameter.
        """
        return self.model.covariance()

    @property
    def uncertainty(self) -> Uncertainty | None:
        """Accuracy of the parameters; `identify` always computes it."""
        return self.model.uncertainty

    @property
    def iterations(self) -> int:
        """Steps of the optimiser."""
        return self.history[-1].number

    def to_json(self) -> dict[str, Any]:
        """Return the fields for ``--json``.

        Also ``faults``: ``share_of_windows`` left out and ``spans``; ``values`` by label:
        ``value``, ``identified``, ``standard_error``, ``interval_95``, ``bootstrap_95``; and
        ``uncertainty``: ``clusters``, ``notes``, of a bootstrap ``replicates`` and ``seed``.

        Returns
        -------
        dict
            ``model, loss, iterations, converged, windows, wall_s, warnings, values, uncertainty,
            identifiability, delay_jitter, faults, history``.
        """
        known = {"uncertainty": _uncertainty_json(self.uncertainty)}
        return super().to_json() | {"values": _values_json(self.model)} | known


def _values_json(model: Model) -> dict[str, dict[str, Any]]:
    """Return every parameter with its errors, by label; None if there are no errors."""
    known, figures = model.known, {}
    labels = model.parameters.labels(model.vehicle.propeller_names)
    for entry, (label, value) in enumerate(zip(labels, model.parameters.to_vector(), strict=True)):
        figures[label] = {"value": float(value), "standard_error": None, "interval_95": None}
        open_ = known is not None and bool(known.undetermined[:, entry].any())
        figures[label]["identified"] = bool(model.free[entry]) and not open_
        if known is not None and np.isfinite(known.standard_errors[entry]):
            figures[label]["standard_error"] = float(known.standard_errors[entry])
            figures[label]["interval_95"] = known.intervals[entry].tolist()
        if known is not None and known.bootstrap is not None:
            ends = [float(end[entry]) for end in (known.bootstrap.lower, known.bootstrap.upper)]
            figures[label]["bootstrap_95"] = ends if np.isfinite(ends).all() else None
    return figures


def _uncertainty_json(known: Uncertainty | None) -> dict[str, Any] | None:
    """Return a note on the basis of the standard errors."""
    if known is None:
        return None
    found: dict[str, Any] = {"clusters": known.clusters, "notes": list(known.notes)}
    if known.bootstrap is not None:
        found["replicates"], found["seed"] = known.bootstrap.replicates, known.bootstrap.seed
    return found


def fit_warnings(
    model: Model, trajectories: Sequence[Trajectory], outcome: Optimum, exclusion: Exclusion | None
) -> tuple[str, ...]:
    """Return warnings to read before trusting a model."""
    return (
        *_idle_motors(trajectories),
        *(exclusion.warnings if exclusion else ()),
        *([] if outcome.converged else [f"the optimiser has not converged: {outcome.message}"]),
        *_implausible_values(model),
        *_other_delays(model, trajectories),
        *(model.uncertainty.warnings if model.uncertainty else ()),
    )


def _idle_motors(trajectories: Sequence[Trajectory]) -> list[str]:
    """Name the motors whose thrust the data cannot determine."""
    ranges = np.max([np.ptp(t.input[t.usable], axis=0) for t in trajectories], axis=0)
    return [
        f"the command of {name} barely changes: these data do not determine its thrust"
        for name, extent in zip(trajectories[0].propellers, ranges, strict=True)
        if extent < _IDLE_RANGE
    ]


def _implausible_values(model: Model) -> list[str]:
    """Name parameters at a bound, an inertia far from nominal, and falling thrust curves."""
    found = [f"{label} is at its bound" for label in at_bounds(model)]
    inertia, nominal = float(model.parameters.inertia), model.vehicle.nominal.inertia_kg_m2
    if not 0.05 < inertia / nominal < 20:
        found.append(
            f"the inertia, {inertia:.3g} kg m², is far from the nominal {nominal:.3g}: "
            "do the data excite the yaw?"
        )
    slopes, speeds = lowest_slope(model.parameters.thrust)
    for name, slope, speed in zip(model.vehicle.propeller_names, slopes, speeds, strict=True):
        if slope < 0:
            found.append(f"thrust of {name} falls at φ = {speed:.2f}: it cannot be inverted")
    return found


def _other_delays(model: Model, trajectories: Sequence[Trajectory]) -> list[str]:
    """Name recordings whose own delay differs from the learned one."""
    if not model.delay_learned:
        return []
    return [
        f"{t.source}: preprocessing used a delay of {1e3 * t.delay:.1f} ms, the fit "
        f"{1e3 * model.transport_delay:.1f} ms for all recordings; check clocks and nominal lag"
        for t in trajectories
        if t.delay_known and abs(t.delay - model.transport_delay) > max(_FAR, t.sample_period)
    ]


def outcome_words(fit: Fit) -> list[str]:
    """Return sentences on how a fit ended and what it excluded."""
    text = [
        f"{fit.model.name}: loss {fit.loss:.4e} after {fit.iterations} iterations "
        f"on {fit.windows} windows, {fit.wall_s:.1f} s ({fit.message})"
    ]
    data = fit.objective.windows.trajectories if fit.objective is not None else ()
    for trajectory in data:
        name = f"{Path(trajectory.source).name}: " if len(data) > 1 else ""
        text.append(name + left_out_words(trajectory))
    if fit.exclusion is not None and fit.exclusion.share > 0:
        faults = sum(map(len, fit.exclusion.faults))
        text.append(
            f"excluded as faulty: {100 * fit.exclusion.share:.1f} % of the windows "
            f"({'1 fault' if faults == 1 else f'{faults} faults'}); "
            "`airpuck faults` lists them, --faults keep includes them"
        )
    return text


def knowledge_words(fit: Fit) -> list[str]:
    """Return sentences on what the data determine and what they leave open."""
    text, known, found = [], fit.uncertainty, fit.identifiability
    if fit.model.delay_jitter is not None:
        text.append(f"delay {delay_words(fit.model)}")
    if found is not None:
        text.append(
            f"{found.rank} of {found.free} free parameters determined, condition "
            f"{found.condition:.1e}; weakest: {', '.join(found.weakest)}"
        )
        text += found.notes
    return [*text, *(known.notes if known else ())]
