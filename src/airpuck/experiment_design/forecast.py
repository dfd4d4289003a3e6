"""Forecasts of a flight's standard errors, from shorter trial flights on the twin.

A trial is flown with a known model, so residuals and scores can be evaluated at the truth. The
information H of a flight and the covariance M of its scores grow with its length, and the
covariance of an estimate is H⁻¹ M H⁻¹ (White 1980). Ten blocks of a short trial determine M poorly.
But how M and H differ depends on the sources of the residuals (radio, noise of the cameras,
overlapping windows), not on the signals: M = κ H^½ K H^½. κ is specific to each flight. K is common
to all trials, and shrunk towards the identity according to the number of blocks (Ledoit and Wolf
2004).

Errors are compared in terms of quantities, each with a scale for its error. Coefficients of a
thrust curve are not among them: they correlate by more than 0.95, and the curve is known far better
than they are. The force at half and at full speed shows how well it is known.
"""

from __future__ import annotations

import multiprocessing
import signal
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from itertools import compress
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from airpuck.boundary.errors import InputError
from airpuck.boundary.results import plain
from airpuck.compute.process import usable_cores
from airpuck.control.settings import ExcitationPlan
from airpuck.control.tuning import Tuning
from airpuck.data.trajectory import Trajectory
from airpuck.deviation.packet_delays import PacketDelays
from airpuck.evaluation.presentation import main_quantities, physical_thrust
from airpuck.identification.problem import prediction_loss
from airpuck.identification.retiming import retime_packets, spread_of, variance_of_mean
from airpuck.identification.settings import PUBLISHED_WEIGHTS, Loss
from airpuck.identification.uncertainty import (
    binding_constraints,
    inverted,
    shared_at_borders,
    spectrum,
    subspace,
)
from airpuck.model.model_file import Model
from airpuck.model.uncertainty import Uncertainty
from airpuck.preprocessing.pipeline import preprocess
from airpuck.twin.experiments import fly_excitation
from airpuck.twin.radio import as_received
from airpuck.twin.settings import TwinSettings

#: Motor speeds at which forces are compared.
_SPEEDS = (0.5, 1.0)
#: Step of a finite difference, relative to a parameter; absolute if the parameter is near zero.
_STEP, _LEAST = 1e-6, 1e-3
#: A relative error below this is rounding: a constraint fixes the quantity.
HELD = 1e-9


@dataclass(frozen=True, eq=False)
class Information:
    """Information per second of a flight about the parameters of a known model."""

    #: Gauss-Newton Hessian H of the loss, summed over windows, at the truth [1/s].
    hessian: Float[np.ndarray, "P P"]
    #: Covariance of the sum of scores [1/s], from blocks of time about their mean: an error that
    #: all blocks share is a bias, which no standard error shows.
    scores: Float[np.ndarray, "P P"]
    #: Mean squared weighted prediction error.
    loss: float
    #: Duration of the flight [s].
    duration: float
    #: Number of blocks of time behind `scores`.
    blocks: int
    #: Variance of the mean delay of the packets with known arrival, times the duration [s³]: these
    #: packets are only a sample of all.
    packets: float = 0.0


def loss_of(model: Model) -> Loss:
    """Return the loss that a model was learned with."""
    fit = model.fit
    x, y, yaw = fit.get("weights", PUBLISHED_WEIGHTS)
    # Models of earlier versions were learned at 240 Hz.
    period = fit.get("sample_period_s", 1 / 240)
    names = {
        "encoder_time": "encoder_length",
        "prediction_time": "prediction_length",
        "spacing": "stride",
    }
    given = {name: fit[key] * period for name, key in names.items() if key in fit}
    return Loss(weights=(x, y, yaw), **given)


def information_of(
    trajectory: Trajectory, model: Model, duration: float, delays: Sequence[PacketDelays] = ()
) -> Information:
    """Compute the information in a flight of a known model."""
    whole = [_whole_seconds(trajectory)]
    loss = prediction_loss(
        loss_of(model).suited(whole, model.vehicle),
        whole,
        model.vehicle,
        frame=model.frame,
        learns_delay=model.delay_learned,
    )
    quadratic = loss.quadratic(model.parameters)
    # The loss is a mean over windows; information and scores are sums.
    count, blocks = len(loss.windows), len(quadratic.scores)
    if blocks < 2:
        raise InputError("is too short for two blocks of time", field="rehearsal")
    spread = quadratic.scores - quadratic.scores.mean(axis=0)
    spread /= np.sqrt(1 - shared_at_borders(loss))
    return Information(
        hessian=count * quadratic.hessian / duration,
        scores=count**2 * blocks / (blocks - 1) * (spread.T @ spread) / duration,
        loss=quadratic.loss,
        duration=duration,
        blocks=blocks,
        packets=duration * variance_of_mean(delays, spread_of(delays)),
    )


def _whole_seconds(trajectory: Trajectory) -> Trajectory:
    """Cut a flight to whole seconds: flights of one length share a compiled program.

    Flights differ by a few samples, since each is cropped to its commanded span.
    """
    second = round(1 / trajectory.sample_period)
    kept = len(trajectory) // second * second
    return trajectory.slice(0.0, kept / len(trajectory)) if kept else trajectory


def joined(flights: Sequence[Information]) -> Information:
    """Average the information of several flights of one plan, weighted by their length."""
    weights = [one.duration for one in flights]
    means: dict[str, Any] = {
        name: np.average([getattr(one, name) for one in flights], axis=0, weights=weights)
        for name in ("hessian", "scores", "loss", "packets")
    }
    return Information(**means, duration=sum(weights), blocks=sum(one.blocks for one in flights))


class Forecast:
    """Predicts standard errors of flights of any length."""

    def __init__(self, model: Model, trials: Sequence[Information], level: float = 1.0) -> None:
        self.model, self.level = model, level
        self._constraints = binding_constraints(model.parameters, model.free)
        size = len(model.free)
        #: θ = basis @ y: the learned directions that no constraint fixes.
        self._basis = subspace(np.eye(size), model.free, self._constraints).basis
        found = [self._decomposed(trial) for trial in trials]
        # A flight that leaves a direction undetermined has no information about K there.
        rank = max(one.rank for one in found)
        used = [one.rank == rank for one in found]
        shape = np.mean([one.shape for one in compress(found, used)], axis=0)
        blocks = sum(trial.blocks - 1 for trial in compress(trials, used))
        self._shape = _shrunk(shape, rank, blocks)

    def of(self, flight: Information, duration: float) -> Uncertainty:
        """Predict the uncertainty after a flight of a given length."""
        precision = self._precision(flight) * duration / self.level
        precision = self._less_certain(precision, flight.packets / duration) + self._prior()
        covariance = self._basis @ inverted(precision) @ self._basis.T
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
        """Add `variance` to the delay's variance, in the inverse of `precision`."""
        delay = self.model.free & self.model.parameters.mask(frozenset({"transport_delay"}))
        if not delay.any() or not variance > 0:
            return precision
        along = np.linalg.lstsq(self._basis, delay.astype(float), rcond=None)[0]
        gained = precision @ along
        return precision - np.outer(gained, gained) / (1 / variance + along @ gained)

    def _prior(self) -> Float[np.ndarray, "R R"]:
        """Return the precision of the prior knowledge."""
        before = self.model.known
        if before is None or not np.isfinite(before.covariance).all():
            return np.zeros((self._basis.shape[1],) * 2)
        return inverted(self._basis.T @ before.covariance @ self._basis)

    def _precision(self, flight: Information) -> Float[np.ndarray, "R R"]:
        """Return the precision per second of a flight, H M⁻¹ H = H^½ K⁻¹ H^½ / κ."""
        one = self._decomposed(flight)
        scaled = one.root @ inverted(self._shape) @ one.root / one.inflation
        back = np.divide(1.0, one.scale, out=np.zeros_like(one.scale), where=one.scale > 0)
        return scaled * np.outer(back, back)

    def _decomposed(self, flight: Information) -> _Decomposed:
        """Split a flight's statistics into information and shape of the scores."""
        value, vector, scale = spectrum(self._basis.T @ flight.hessian @ self._basis)
        inverse, rank = vector / np.sqrt(value) @ vector.T, len(value)
        scores = self._basis.T @ flight.scores @ self._basis * np.outer(scale, scale)
        whitened, root = inverse @ scores @ inverse, vector * np.sqrt(value) @ vector.T
        inflation = float(np.trace(whitened)) / max(rank, 1)
        return _Decomposed(root, scale, inflation, whitened / inflation, rank)


class _Decomposed(NamedTuple):
    """H and M of a flight in coordinates that give H a unit diagonal."""

    #: H^½.
    root: Float[np.ndarray, "R R"]
    #: Scale of the coordinates.
    scale: Float[np.ndarray, " R"]
    #: κ: the average ratio of the scores' variance to the information.
    inflation: float
    #: K = H^-½ M H^-½ / κ.
    shape: Float[np.ndarray, "R R"]
    #: Number of directions that the flight determines.
    rank: int


def _shrunk(shape: Float[np.ndarray, "R R"], rank: int, blocks: int) -> Float[np.ndarray, "R R"]:
    """Shrink K, whose trace is its rank, towards the identity: too few blocks make it singular.

    The amount minimises the expected squared error (Ledoit and Wolf 2004).
    """
    square = float((shape**2).sum())
    noise = (rank**2 + square) / max(blocks, 1)
    weight = min(1.0, noise / max(square - rank, 1e-300))
    return (1 - weight) * shape + weight * np.diag(np.where(np.diag(shape) > 0, 1.0, 0.0))


class ComparedQuantity(NamedTuple):
    """A quantity computed from a model."""

    label: str
    unit: str
    #: An error of this size counts as 100 %. Infinite if there is nothing to compare with: the
    #: error is then shown, but does not count.
    scale: float
    value: Callable[[Model], float]


class ComparedQuantities:
    """A model's learned parameters, as quantities with comparable errors."""

    def __init__(self, model: Model) -> None:
        self._quantities = q = tuple(_compared(model))
        self.labels, self.units = [one.label for one in q], [one.unit for one in q]
        self.scales = np.array([one.scale for one in q])
        self._estimate = vector = model.parameters.to_vector()
        self._gradient = np.empty((len(vector), len(self.labels)))
        for entry, step in enumerate(_STEP * np.maximum(np.abs(vector), _LEAST)):
            above, below = (
                self.values(replace(model, parameters=model.parameters.with_vector(moved)))
                for moved in vector + step * np.outer((1, -1), np.arange(len(vector)) == entry)
            )
            self._gradient[entry] = (above - below) / (2 * step)

    def values(self, model: Model) -> Float[np.ndarray, " K"]:
        """Compute the quantities of a model."""
        return np.array([quantity.value(model) for quantity in self._quantities])

    def labelled(self, errors: Float[np.ndarray, " K"]) -> dict[str, float]:
        """Return one number for each quantity, by label."""
        return dict(zip(self.labels, errors.tolist(), strict=True))

    def to_json(self) -> dict[str, Any]:
        """Return unit and scale of each quantity, by label."""
        return plain(
            {one.label: {"unit": one.unit, "scale": one.scale} for one in self._quantities}
        )

    def relative_errors(self, uncertainty: Uncertainty | None) -> Float[np.ndarray, " K"]:
        """Compute standard errors relative to the scales, for an uncertainty of this model.

        Infinite where a quantity is undetermined, nan where it has no scale.
        """
        if uncertainty is None or not np.array_equal(uncertainty.estimate, self._estimate):
            return np.full(len(self.scales), np.inf)
        return self._shares(uncertainty.errors_along(self._gradient))

    def relative_errors_of(self, model: Model) -> Float[np.ndarray, " K"]:
        """Compute the same for another model, from its own uncertainty."""
        return self._shares(model.standard_error(self.values))

    def _shares(self, errors: Float[np.ndarray, " K"]) -> Float[np.ndarray, " K"]:
        """Divide errors by the scales."""
        shares = np.where(np.isfinite(errors), errors / self.scales, np.inf)
        return np.where(np.isfinite(self.scales), shares, np.nan)


def _compared(model: Model) -> Iterator[ComparedQuantity]:
    """List all learned quantities, the forces of the propellers first."""
    scales = {"angle_offset": 1.0, "center_of_mass": model.radius_of_gyration}
    full = np.abs(physical_thrust(model).sum(axis=1))
    learned = [q for q in main_quantities(model, _SPEEDS, in_si=True) if q.learned(model)]
    for q in sorted(learned, key=lambda one: one.motor is None):
        natural = scales.get(q.parameter) if q.motor is None else full[q.motor]
        yield ComparedQuantity(q.label, q.unit, natural or abs(q.value(model)) or np.inf, q.value)
    if model.parameters.configuration_matrix is not None:
        yield from _of_columns(model)


def _of_columns(model: Model) -> Iterator[ComparedQuantity]:
    """List the directions and lever arms of propellers in a directly learned Π."""
    for motor, name in enumerate(model.vehicle.propeller_names):
        ahead = np.asarray(model.dynamics.configuration)[:2, motor]
        if not ahead.any():  # a wheel only turns the craft
            continue
        yield ComparedQuantity(f"direction {name}", "rad", 1.0, partial(_direction, motor, ahead))
        arm, turn = 1 / model.radius_of_gyration, partial(_turn_per_push, motor)
        yield ComparedQuantity(f"turn per push {name}", "rad/m", arm, turn)


def _direction(motor: int, ahead: Float[np.ndarray, " 2"], model: Model) -> float:
    """Return the angle between the force of a propeller and a direction [rad]."""
    x, y = np.asarray(model.dynamics.configuration)[:2, motor]
    return float(np.arctan2(ahead[0] * y - ahead[1] * x, ahead @ (x, y)))


def _turn_per_push(motor: int, model: Model) -> float:
    """Return the ratio of a propeller's angular to its linear acceleration [rad/m]."""
    x, y, turn = np.asarray(model.dynamics.configuration)[:, motor]
    return float(turn / np.hypot(x, y))


#: Called with the number done and the total.
ProgressCallback = Callable[[float, float], None]


class Trial(NamedTuple):
    """A flight of a plan on the twin."""

    #: Smallest distance to a rail [m]; 0: it touched one.
    clearance: float
    #: Its information about the model; None if it touched a rail, which no model includes.
    information: Information | None


def fly_trial(
    model: Model, settings: TwinSettings, tuning: Tuning, plan: ExcitationPlan, seed: int
) -> Trial:
    """Fly a plan on a twin of a model, and compute the flight's information about the model."""
    trajectory, clearance = fly(model, settings, tuning, plan, seed)
    if not clearance:
        return Trial(clearance, None)
    delays = ()
    if model.delay_learned:
        # As in `identify`: with the mean delay of this radio, and packets at their arrival times.
        model = as_received(model, settings, tuning.period_s)
        (trajectory,), delays = retime_packets((trajectory,), model)
    return Trial(clearance, information_of(trajectory, model, plan.duration_s, delays))


def fly(
    model: Model, settings: TwinSettings, tuning: Tuning, plan: ExcitationPlan, seed: int
) -> tuple[Trajectory, float]:
    """Fly a plan; return its data and the smallest distance to a rail [m], 0 if it touched one."""
    flown = fly_excitation(model, plan, seed, settings=settings, tuning=tuning)
    reach = np.array(settings.table.reach(model.vehicle.radius_m))
    free = float((reach - np.abs(flown.recording["pose"].values[:, :2])).min())
    clearance = 0.0 if flown.contacts else max(free, 0.0)
    return preprocess(flown.recording, model.vehicle), clearance


@contextmanager
def on_processes(processes: int | None) -> Iterator[Callable[..., Iterable[Any]]]:
    """Yield a function like the built-in `map` that by default uses one process per core."""
    if processes is not None and processes < 1:
        raise InputError("must be at least 1", field="processes")
    count = processes or usable_cores()
    if count == 1:
        yield map
        return
    # JAX has threads, which do not survive a fork.
    pool = ProcessPoolExecutor(count, mp_context=multiprocessing.get_context("spawn"))

    def run(*arguments: Any) -> Iterable[Any]:
        # The processes start here and inherit a blocked Ctrl-C, which a terminal sends to all.
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            return pool.map(*arguments)
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)

    try:
        yield run
    except KeyboardInterrupt:
        for process in list(pool._processes.values()):  # no public way before Python 3.14
            process.terminate()
        raise
    finally:
        pool.shutdown(cancel_futures=True)
