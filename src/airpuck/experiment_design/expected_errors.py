"""Standard errors that a flight will give, from a shorter one that was rehearsed.

A rehearsal is flown with a model that is known, so that residuals and scores can be taken at the
truth. The information H of a flight and the covariance M of its scores grow with its length, and
the covariance of an estimate is H⁻¹ M H⁻¹ (White 1980). Ten blocks of a short rehearsal say little
about M, but how M and H differ is a property of what the residuals are made of (radio, noise of the
cameras, windows that overlap), not of the signals: M = κ H^½ K H^½, with κ of the flight, and K
common to all that were rehearsed, drawn to the identity by as much as
the number of blocks behind it asks for (Ledoit and Wolf 2004).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from airpuck.boundary.errors import InputError
from airpuck.data.trajectory import Trajectory
from airpuck.data.windows import make_windows
from airpuck.estimate.encoder import PaperEncoder
from airpuck.identification.blocks import cluster_windows, shared_at_borders
from airpuck.identification.delay_jitter import spread_of, variance_of_mean
from airpuck.identification.objective import PUBLISHED_WEIGHTS, PredictionLoss
from airpuck.identification.packet_delays import PacketDelays
from airpuck.identification.uncertainty import (
    UNDETERMINED,
    binding_constraints,
    subspace,
)
from airpuck.model.model_file import Model
from airpuck.model.uncertainty import Uncertainty

#: Windows as `identify` cuts them, where the model does not say otherwise.
_PAST, _AHEAD, _STRIDE = 40, 50, 7


@dataclass(frozen=True, eq=False)
class Information:
    """What each second of a flight says about the parameters of a known model."""

    #: Gauss-Newton Hessian H of the loss, summed over windows, at the truth [1/s].
    hessian: Float[np.ndarray, "P P"]
    #: Covariance of the sum of scores, from those of blocks of time about their mean [1/s]: what is
    #: wrong in all blocks alike is a bias, of which a standard error knows nothing.
    scores: Float[np.ndarray, "P P"]
    #: Mean squared weighted prediction error.
    loss: float
    #: Of the flight [s].
    duration: float
    #: Blocks of time behind `scores`.
    blocks: int
    #: Variance of the mean delay of the packets whose arrival is known, times the duration [s³]:
    #: they are a sample of the radio's.
    packets: float = 0.0


def fit_settings(model: Model) -> dict[str, Any]:
    """Return the arguments of `identify` that a model was learned with."""
    fit = model.fit
    x, y, yaw = fit.get("weights", PUBLISHED_WEIGHTS)
    return {
        "encoder": PaperEncoder(length=int(fit.get("encoder_length", _PAST))),
        "weights": (x, y, yaw),
        "prediction_length": int(fit.get("prediction_length", _AHEAD)),
        "stride": int(fit.get("stride", _STRIDE)),
        "frame": model.frame,
    }


def information_of(
    trajectory: Trajectory, model: Model, duration: float, delays: Sequence[PacketDelays] = ()
) -> Information:
    """Compute what a flight of a known model says about its parameters."""
    how = fit_settings(model)
    encoder = how["encoder"]
    trajectory = _whole_seconds(trajectory)
    windows = make_windows(trajectory, encoder.length, how["prediction_length"], how["stride"])
    loss = PredictionLoss(
        windows,
        model.vehicle,
        encoder,
        how["weights"],
        how["frame"],
        continuous_delay=model.delay_learned,
    )
    clusters = cluster_windows(windows)
    if clusters.max() < 1:
        raise InputError("is too short for two blocks of time", field="rehearsal")
    shares = loss.by_cluster(model.parameters, clusters)
    # The loss is a mean over windows; information and scores are sums.
    count, blocks = len(windows), len(shares.gradient)
    spread = shares.gradient - shares.gradient.mean(axis=0)
    spread /= np.sqrt(1 - shared_at_borders(windows, clusters))
    return Information(
        hessian=count * shares.hessian.sum(axis=0) / duration,
        scores=count**2 * blocks / (blocks - 1) * (spread.T @ spread) / duration,
        loss=float(shares.loss.sum()),
        duration=duration,
        blocks=blocks,
        packets=duration * variance_of_mean(delays, spread_of(delays)),
    )


def _whole_seconds(trajectory: Trajectory) -> Trajectory:
    """Cut a flight to whole seconds: flights of one length share a compiled program.

    Their samples differ by a few, since a flight is cropped to where it is commanded.
    """
    second = round(1 / trajectory.sample_period)
    kept = len(trajectory) // second * second
    return trajectory.slice(0.0, kept / len(trajectory)) if kept else trajectory


def joined(flights: Sequence[Information]) -> Information:
    """Join what several flights of one kind say."""
    weights = np.array([one.duration for one in flights])

    def mean(values: list[Any]) -> Any:
        return np.average(np.array(values), axis=0, weights=weights)

    return Information(
        hessian=mean([one.hessian for one in flights]),
        scores=mean([one.scores for one in flights]),
        loss=float(mean([one.loss for one in flights])),
        duration=float(weights.sum()),
        blocks=sum(one.blocks for one in flights),
        packets=float(mean([one.packets for one in flights])),
    )


class Forecast:
    """Predicts standard errors of flights of any length."""

    def __init__(self, model: Model, rehearsed: Sequence[Information], level: float = 1.0) -> None:
        self.model, self.level = model, level
        self._constraints = binding_constraints(model.parameters, model.free)
        size = len(model.free)
        #: θ = basis @ y: what is learned and no constraint holds.
        self._basis = subspace(np.eye(size), model.free, self._constraints).basis
        # A flight that leaves a direction in the dark says nothing of K there.
        ranks = [self._rank(one) for one in rehearsed]
        used = [one for one, rank in zip(rehearsed, ranks, strict=True) if rank == max(ranks)]
        self._shape = self._shrunk(
            np.mean([self._correlation(one) for one in used], axis=0),
            max(ranks),
            sum(one.blocks - 1 for one in used),
        )

    def _shrunk(
        self, shape: Float[np.ndarray, "R R"], rank: int, blocks: int
    ) -> Float[np.ndarray, "R R"]:
        """Draw K, whose trace is its rank, to the identity: too few blocks make it singular.

        By as much as is best for the expected square of its error (Ledoit and Wolf 2004).
        """
        square = float((shape**2).sum())
        noise = (rank**2 + square) / max(blocks, 1)
        weight = min(1.0, noise / max(square - rank, 1e-300))
        light = np.diag(np.where(np.diag(shape) > 0, 1.0, 0.0))
        return (1 - weight) * shape + weight * light

    def of(self, flight: Information, duration: float, *, alone: bool = False) -> Uncertainty:
        """Predict what will be known after a flight."""
        precision = self._precision(flight) * duration
        if not alone:
            precision = precision / self.level
        precision = self._less_certain(precision, flight.packets / duration)
        if not alone:
            precision = precision + self._known()
        covariance = self._basis @ _pseudo_inverse(precision) @ self._basis.T
        whole = self._basis @ precision @ self._basis.T
        space = subspace(whole, self.model.free, self._constraints)
        return Uncertainty(
            estimate=self.model.parameters.to_vector(),
            covariance=covariance,
            standard_errors=np.sqrt(np.diag(covariance)),
            undetermined=space.undetermined,
            clusters=0,
            quantile=1.96,
        )

    def _less_certain(
        self, precision: Float[np.ndarray, "R R"], variance: float
    ) -> Float[np.ndarray, "R R"]:
        """Take away what is not known of the delay: the inverse has `variance` more there."""
        delay = self.model.free & self.model.parameters.mask(frozenset({"transport_delay"}))
        if not delay.any() or not variance > 0:
            return precision
        along = np.linalg.lstsq(self._basis, delay.astype(float), rcond=None)[0]
        gained = precision @ along
        return precision - np.outer(gained, gained) / (1 / variance + along @ gained)

    def _known(self) -> Float[np.ndarray, "R R"]:
        """Return the precision of what is known before."""
        known = self.model.uncertainty
        size = self._basis.shape[1]
        if known is None or not np.isfinite(known.covariance).all():
            return np.zeros((size, size))
        return _pseudo_inverse(self._basis.T @ known.covariance @ self._basis)

    def _precision(self, flight: Information) -> Float[np.ndarray, "R R"]:
        """Return the precision that a second of a flight gives, H M⁻¹ H."""
        root, inverse, scale = self._roots(flight)
        # In scaled coordinates it is H^½ K⁻¹ H^½ / κ.
        middle = root @ _pseudo_inverse(self._shape) @ root
        back = np.divide(1.0, scale, out=np.zeros_like(scale), where=scale > 0)
        return middle / self._inflation(flight, inverse, scale) * np.outer(back, back)

    def _correlation(self, flight: Information) -> Float[np.ndarray, "R R"]:
        """Return K of one flight: H^-½ M H^-½ / κ, in scaled coordinates."""
        _, inverse, scale = self._roots(flight)
        whitened = self._whitened(flight, inverse, scale)
        return whitened / self._inflation(flight, inverse, scale)

    def _inflation(
        self,
        flight: Information,
        inverse: Float[np.ndarray, "R R"],
        scale: Float[np.ndarray, " R"],
    ) -> float:
        """Return κ: the variance of scores over the information, on average."""
        trace = float(np.trace(self._whitened(flight, inverse, scale)))
        return trace / max(self._rank(flight), 1)

    def _whitened(
        self,
        flight: Information,
        inverse: Float[np.ndarray, "R R"],
        scale: Float[np.ndarray, " R"],
    ) -> Float[np.ndarray, "R R"]:
        """Return H^-½ M H^-½, in scaled coordinates."""
        scores = self._basis.T @ flight.scores @ self._basis
        return inverse @ (scores * np.outer(scale, scale)) @ inverse

    def _rank(self, flight: Information) -> int:
        """Return how many directions a flight determines."""
        return int(np.linalg.matrix_rank(self._roots(flight)[1], tol=1e-9))

    def _roots(
        self, flight: Information
    ) -> tuple[Float[np.ndarray, "R R"], Float[np.ndarray, "R R"], Float[np.ndarray, " R"]]:
        """Return H^½ and H^-½ in coordinates that give H a unit diagonal, and their scale."""
        hessian = self._basis.T @ flight.hessian @ self._basis
        scale = _unit_scale(hessian)
        value, vector = np.linalg.eigh(hessian * np.outer(scale, scale))
        known = value > UNDETERMINED * max(value[-1], 1e-300)
        value, vector = value[known], vector[:, known]
        return vector * np.sqrt(value) @ vector.T, vector / np.sqrt(value) @ vector.T, scale


def _unit_scale(matrix: Float[np.ndarray, "R R"]) -> Float[np.ndarray, " R"]:
    """Return what gives a matrix a unit diagonal; 0 where there is nothing."""
    diagonal = np.diag(matrix)
    return np.divide(1.0, np.sqrt(diagonal), out=np.zeros(len(matrix)), where=diagonal > 0)


def _pseudo_inverse(matrix: Float[np.ndarray, "R R"]) -> Float[np.ndarray, "R R"]:
    """Invert a positive semidefinite matrix where it is not zero, whatever the units."""
    scale = _unit_scale(matrix)
    value, vector = np.linalg.eigh(matrix * np.outer(scale, scale))
    known = value > UNDETERMINED * max(value[-1], 1e-300)
    return (vector[:, known] / value[known] @ vector[:, known].T) * np.outer(scale, scale)
