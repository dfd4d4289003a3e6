"""Optimisers: their interface, Levenberg-Marquardt, and fits with other data or other weights."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol, runtime_checkable

import numpy as np
import piqp
from jaxtyping import Bool, Float

from airpuck.boundary.errors import InputError
from airpuck.boundary.numbers import check_finite
from airpuck.boundary.results import Changes
from airpuck.evaluation.evaluate import prediction_errors
from airpuck.identification.objective import PredictionLoss, Quadratic
from airpuck.identification.uncertainty import scaling
from airpuck.model.parameters import Parameters
from airpuck.physics.thrust import lowest_slope, slope_rows

#: Degrees of freedom of the Student distribution; one is Cauchy's.
_DEGREES = 1.0
#: Weights between 0 and 2 have converged when none moves by more than this.
_SETTLED = 0.02
_MOST_PASSES = 12
#: Windows whose errors lie between these quantiles determine the derivative of the overall median
#: with respect to θ.
_AROUND = (0.4, 0.6)


@dataclass(frozen=True)
class Iteration:
    """One step of an optimiser."""

    #: 0 is the start.
    number: int
    #: Prediction loss on the training windows.
    loss: float

    def __str__(self) -> str:
        return f"iteration {self.number}: loss {self.loss:.4e}"


@dataclass(frozen=True)
class Optimum:
    """Result of an optimiser."""

    #: The best parameters found.
    parameters: Parameters
    #: Their prediction loss, without any regulariser.
    loss: float
    #: Iterations, beginning with the start.
    history: tuple[Iteration, ...]
    #: Whether the optimiser stopped by its own criterion.
    converged: bool
    #: Reason for stopping.
    message: str
    #: The loss that was minimised, at `parameters`; None where the optimiser does not evaluate it.
    quadratic: Quadratic | None = None


@runtime_checkable
class Method(Protocol):
    """An optimiser, with its settings."""

    def minimize(
        self,
        loss: PredictionLoss,
        parameters: Parameters,
        free: Bool[np.ndarray, " P"],
        progress: Callable[[Iteration], None] = ...,
    ) -> Optimum:
        """Minimise a prediction loss."""
        ...


def minimize_on(
    method: Method,
    loss: PredictionLoss,
    outcome: Optimum,
    free: Bool[np.ndarray, " P"],
    progress: Callable[[Iteration], None] = lambda _: None,
) -> Optimum:
    """Continue from an optimum with another loss, and continue counting iterations."""

    def renumbered(step: Iteration) -> Iteration:
        return replace(step, number=outcome.history[-1].number + step.number)

    def report(step: Iteration) -> None:
        if step.number:  # its start is the end of the last fit, which was already reported
            progress(renumbered(step))

    after = method.minimize(loss, outcome.parameters, free, report)
    return replace(after, history=(*outcome.history, *map(renumbered, after.history[1:])))


def reweighted(
    method: Method,
    loss: PredictionLoss,
    outcome: Optimum,
    free: Bool[np.ndarray, " P"],
    progress: Callable[[Iteration], None] = lambda _: None,
) -> tuple[PredictionLoss, Optimum]:
    """Fit repeatedly, with each window weighted by how well the last fit predicts it.

    With s the mean squared weighted error of a window and σ² the median over all windows, a window
    gets the weight (ν + 1)/(ν + s/σ²), from Student's distribution with ν degrees of freedom
    (Holland and Welsch, Communications in Statistics A 6, 1977). If a window's error is ten times
    the median, its weight is a hundredth of the weight of a window without error.
    """
    weight, settled = np.ones(len(loss.windows)), False
    weighted, counted = loss, loss.multiplicity
    for _ in range(_MOST_PASSES):
        before, weight = weight, window_weights(loss, outcome.parameters)
        settled = bool(np.abs(weight - before).max() < _SETTLED)
        if settled:
            break
        weighted = replace(loss, multiplicity=weight if counted is None else counted * weight)
        outcome = minimize_on(method, weighted, outcome, free, progress)
    return weighted, replace(
        outcome,
        loss=loss.quadratic(outcome.parameters).loss,
        converged=settled and outcome.converged,
        message=outcome.message if settled else "the weights of the windows have not settled",
    )


def window_weights(loss: PredictionLoss, parameters: Parameters) -> Float[np.ndarray, " W"]:
    """Return the weight of each window, per count in the loss."""
    dynamics = replace(parameters.dynamics(np, loss.vehicle), frame=loss.frame)
    errors = prediction_errors(dynamics, loss.windows_at(parameters), loss.encoder)
    scaled = np.array(loss.weights)[:, None] * errors
    return student_weights(np.nanmean(scaled**2, axis=(0, 1)), loss.multiplicity)


def student_weights(
    square: Float[np.ndarray, " W"], times: Float[np.ndarray, " W"] | None = None
) -> Float[np.ndarray, " W"]:
    """Return the weights of windows with these mean squared errors; `times` are repetitions."""
    drawn = square if times is None else np.repeat(square, times.astype(int))
    return (_DEGREES + 1) / (_DEGREES + square / _typical(drawn))


def information_of_weights(
    square: Float[np.ndarray, " W"], gradient: Float[np.ndarray, "W P"]
) -> Float[np.ndarray, "P P"]:
    """Return the contribution of parameter-dependent weights to the information H = Σ w Hᵢ / Σ w.

    The weighted score Σ w ∇s changes with θ as Σ w ∇∇ᵀs + Σ ∇s (∂w/∂θ)ᵀ, where w = w(s/σ²) and σ²,
    the median of all s, moves with the windows around it. Windows whose predictions get worse lose
    weight: the second sum is negative.
    """
    weight, typical = student_weights(square), _typical(square)
    low, high = np.quantile(square, _AROUND)
    scale = gradient[(square >= low) & (square <= high)].mean(axis=0)
    slope = gradient / typical - np.outer(square / typical**2, scale)
    return -(gradient.T * weight**2 / (_DEGREES + 1)) @ slope / weight.sum()


def _typical(square: Float[np.ndarray, " W"]) -> float:
    """Return the scale σ² of windows' errors."""
    return max(float(np.median(square)), np.finfo(float).tiny)


#: Largest factor by which a step changes the motor lag.
MOST_LAG = 3.0
#: Damping, relative to the curvature, above which steps are too short to be informative.
_OVERDAMPED = 1e6
#: If a step promises less than this fraction of the loss and still fails, the loss has a kink:
#: wherever the delay moves a command across a sample. The delay is then held.
_SMALL = 2e-5
#: Distance from a bound that makes no difference, in units in which the Hessian has a unit
#: diagonal, and at most this fraction of the range: a short lag seems to have no effect.
_TOUCHES, _TOUCHES_AT_MOST = 1e-7, 1e-3
#: Largest unit of a parameter in a step's program, in units of its range.
_WIDEST = 1e6


@dataclass(frozen=True)
class LevenbergMarquardt(Changes):
    """Damped Gauss-Newton steps, each the solution of a small quadratic program.

    Every iterate respects the bounds and, with `monotone`, condition (thrust_cond): the thrust
    curves rise on all of [0, 1]. The damping follows Nielsen's rule (Madsen, Nielsen and Tingleff,
    "Methods for non-linear least squares problems", 2004).

    Attributes
    ----------
    max_iterations : int
        Largest number of evaluations after the first.
    tolerance : float
        Stop when the predicted decrease of the loss falls below this fraction.
    monotone : bool
        Whether thrust curves must rise.
    damping : float
        Initial damping, relative to the diagonal of the Hessian.

    Examples
    --------
    >>> method = airpuck.LevenbergMarquardt(max_iterations=1)
    >>> airpuck.identify(trajectory, "M0", method=method).converged
    False
    """

    max_iterations: int = 50
    tolerance: float = 1e-6
    monotone: bool = True
    damping: float = 1e-4

    def __post_init__(self) -> None:
        """Check the numbers."""
        check_finite(tolerance=self.tolerance, damping=self.damping)

    def minimize(
        self,
        loss: PredictionLoss,
        parameters: Parameters,
        free: Bool[np.ndarray, " P"],
        progress: Callable[[Iteration], None] = lambda _: None,
    ) -> Optimum:
        """Minimise a prediction loss; see `Method.minimize`."""
        program = _StepProgram(parameters, free, monotone=self.monotone)
        delay = parameters.mask(frozenset({"transport_delay"}))
        point = np.array(parameters.to_vector())
        here = loss.quadratic(parameters)
        history = [Iteration(0, here.loss)]
        progress(history[0])
        damping, growth, reason = self.damping, 2.0, "most iterations reached"
        for number in range(1, self.max_iterations + 1):
            try:
                step = program.step(here, point, damping)
            except ArithmeticError:
                # More damping makes the problem better conditioned.
                damping, growth = damping * growth, 2 * growth
                if damping > _OVERDAMPED:
                    raise InputError(
                        "the data do not determine this many parameters (a step's quadratic "
                        "program has no solution); use more data, fewer free parameters or a "
                        "lower degree",
                        field="recording",
                    ) from None
                history.append(Iteration(number, here.loss))
                continue
            promised = -(here.gradient @ step + step @ here.hessian @ step / 2)
            standstill = np.all(np.abs(step) <= 1e-14 + 1e-12 * np.abs(point))
            if promised <= self.tolerance * here.loss or standstill:
                # A step that is short only because of damping says nothing about the optimum.
                reason = "converged" if damping < _OVERDAMPED else "no step lowers the loss"
                break
            there = loss.quadratic(parameters.with_vector(point + step))
            gain = (here.loss - there.loss) / promised
            if gain > 0:
                point, here = point + step, there
                damping, growth = damping * max(1 / 3, 1 - (2 * float(gain) - 1) ** 3), 2.0
            elif promised < _SMALL * here.loss and program.free[delay].any():
                program.free = program.free & ~delay
            else:
                damping, growth = damping * growth, 2 * growth
            history.append(Iteration(number, here.loss))
            progress(history[-1])
        return Optimum(
            parameters=parameters.with_vector(point),
            loss=here.loss,
            history=tuple(history),
            converged=reason == "converged",
            message=reason,
            quadratic=here,
        )


class _StepProgram:
    """The quadratic program of a step within the bounds that keeps thrust curves rising."""

    def __init__(
        self, parameters: Parameters, free: Bool[np.ndarray, " P"], *, monotone: bool
    ) -> None:
        self.free, self._bounds = free, parameters.bounds()
        self._lag = parameters.mask(frozenset({"motor_time_constant"}))
        self._shape, self._n_thrust = np.shape(parameters.thrust), np.size(parameters.thrust)
        self._slopes = SlopeConstraints(free[: self._n_thrust].reshape(self._shape), monotone)

    def step(
        self, here: Quadratic, point: Float[np.ndarray, " P"], damping: float
    ) -> Float[np.ndarray, " P"]:
        """Solve min g'd + d'(H + λ diag H)d/2."""
        free, n = self.free, self._n_thrust
        gradient, hessian = here.gradient[free], here.hessian[np.ix_(free, free)]
        # Far from the optimum a step may end where the lag no longer matters, and stay there.
        lower = np.maximum(self._bounds[0], np.where(self._lag, point / MOST_LAG, -np.inf))
        upper = np.minimum(self._bounds[1], np.where(self._lag, point * MOST_LAG, np.inf))
        lower, upper = (lower - point)[free], (upper - point)[free]
        # The solver cannot tell the ends of a range that is tiny in units of a weak influence.
        scale = scaling(here.hessian, free)[free]
        scale = np.where(upper > lower, np.minimum(scale, _WIDEST * (upper - lower)), scale)
        damped = hessian * scale[:, None] * scale + damping * np.eye(len(scale))
        step = np.zeros_like(point)
        while True:
            rows = self._slopes.rows()
            by_step = np.pad(rows, [(0, 0), (0, len(point) - n)])[:, free] * scale
            least = self._slopes.margin - rows @ point[:n]
            found = scale * _solve(
                damped, gradient * scale, by_step, least, lower / scale, upper / scale
            )
            # A solver stops just inside a bound: move the result onto it.
            near = np.minimum(_TOUCHES * scale, _TOUCHES_AT_MOST * (upper - lower))
            found = np.where(found < lower + near, lower, found)
            step[free] = np.where(found > upper - near, upper, found)
            if not self._slopes.cut((point + step)[:n].reshape(self._shape)):
                return step


def _solve(
    hessian: Float[np.ndarray, "F F"],
    gradient: Float[np.ndarray, " F"],
    rows: Float[np.ndarray, "R F"],
    least: Float[np.ndarray, " R"],
    lower: Float[np.ndarray, " F"],
    upper: Float[np.ndarray, " F"],
) -> Float[np.ndarray, " F"]:
    """Solve min d'Hd/2 + g'd subject to rows·d ≥ least and lower ≤ d ≤ upper; diag H is about 1."""
    step = np.linalg.solve(hessian, -gradient)
    if np.all(rows @ step >= least) and np.all(lower <= step) and np.all(step <= upper):
        return step
    # The solver's tolerances are absolute: scale the step to order one, and drop unreachable
    # bounds, whose huge numbers would swamp it.
    unit = float(np.linalg.norm(step))
    far = 1e6
    near = least / unit > -far
    constraints = {"G": rows[near], "h_l": least[near] / unit} if near.any() else {}
    solver = piqp.DenseSolver()
    solver.settings.eps_abs = 1e-10
    solver.setup(
        hessian,
        gradient / unit,
        **constraints,
        x_l=np.where(lower / unit > -far, lower / unit, -np.inf),
        x_u=np.where(upper / unit < far, upper / unit, np.inf),
    )
    status = solver.solve()
    if status != piqp.PIQP_SOLVED:
        raise ArithmeticError(f"the step's quadratic program ended with {status}")
    return unit * np.array(solver.result.x)


class SlopeConstraints:
    """Linear inequalities that keep thrust curves rising (prop:thrust), made where needed.

    F'(φ) ≥ 0 for all φ in [0, 1] is one linear inequality in the coefficients for every φ. The
    inequalities at the ends always exist; `cut` adds one at the minimum of a curve that falls
    somewhere. A few cuts suffice, since a polynomial's slope has few minima.
    """

    #: Lowest allowed slope [N].
    margin = 1e-6

    def __init__(self, free: Bool[np.ndarray, "n degree"], monotone: bool = True) -> None:
        self._free = free
        # A curve that is not free may fall: no step can correct it.
        self._mended = monotone & free.any(axis=1)
        propellers = range(len(free)) if monotone else ()
        self._points = [(i, speed) for i in propellers for speed in (0.0, 1.0)]

    def rows(self) -> Float[np.ndarray, "R entries"]:
        """Return A such that the constraints are A c ≥ margin; c are the flat coefficients."""
        return slope_rows(self._free, self._points)

    def cut(self, coefficients: Float[np.ndarray, "n degree"]) -> bool:
        """Add constraints where curves fall."""
        slopes, speeds = lowest_slope(coefficients)
        falling = (slopes < 0) & (speeds > 0) & (speeds < 1) & self._mended
        self._points += [(k, float(speeds[k])) for k in np.flatnonzero(falling).tolist()]
        return bool(falling.any())
