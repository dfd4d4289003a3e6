"""Adam on random batches of windows: the paper's optimiser, as a method for `airpuck.identify`.

    AIRPUCK_DATA=... python studies/adam.py --epochs 200

Fits M3 to the paper's training recording and prints its errors on the validation recording, next to
those of Levenberg-Marquardt. 200 epochs take two minutes. Needs optax.

The settings are those of the published fits: a learning rate of 1e-4 (1e-3 for M4), and a tenth of
it for the inertia, 200 epochs, batches of 512 overlapping windows, nine tenths of all windows. The
penalty is the paper's, w_reg sum max(0, -F'), at 0, at 1 and at the minimum in between
(subsec:reg_force_model; the published code has 3c phi there instead of 3c phi^2).
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Bool

import airpuck
from airpuck.compute.compiled import double_precision
from airpuck.data.windows import gather_past
from airpuck.identification.method import Iteration, Optimum
from airpuck.identification.objective import PredictionLoss
from airpuck.model.parameters import Parameters
from airpuck.physics.rigid_body import rollout
from airpuck.physics.thrust import thrust_slope
from airpuck.recording.dataset import dataset_folder
from airpuck.recording.torch_archive import read_authors_experiment
from airpuck.report.reproduce import TRAINING, VALIDATION


@dataclass(frozen=True)
class Adam:
    """Stochastic gradient descent with momentum and scaling, by automatic differentiation.

    The defaults are the settings of the published fits (their params.json), which differ from the
    paper's text (learning rate 10⁻³, 150 epochs).

    Attributes
    ----------
    learning_rate : float or None
        None: 10⁻⁴, or 10⁻³ if the configuration matrix is learned directly.
    inertia_factor : float
        Factor on the learning rate of the inertia, which is small in SI units.
    epochs : int
        Passes over the training windows.
    batch_size : int
        Windows in a step.
    test_share : float
        Fraction of windows held out, as in the published fits.
    regularizer_weight : float
        Weight w_reg of the penalty on falling thrust curves; 0: no penalty.
    seed : int
        Seed of the split and of the batches.

    """

    learning_rate: float | None = None
    inertia_factor: float = 0.1
    epochs: int = 200
    batch_size: int = 512
    test_share: float = 0.1
    regularizer_weight: float = 1e3
    seed: int = 42

    def minimize(
        self,
        loss: PredictionLoss,
        parameters: Parameters,
        free: Bool[np.ndarray, " P"],
        progress: Callable[[Iteration], None] = lambda _: None,
    ) -> Optimum:
        """Minimise a prediction loss; see `Method.minimize`."""
        rng = np.random.default_rng(self.seed)
        order = rng.permutation(loss.windows.starts)
        n_test = round(self.test_share * len(order))
        train = order[n_test:]
        size = min(self.batch_size, len(train))
        rate = self.learning_rate or (1e-3 if parameters.configuration_matrix is not None else 1e-4)
        rates = np.where(free, rate, 0.0)
        rates[parameters.mask(frozenset({"inertia"}))] *= self.inertia_factor

        with double_precision():
            error = batch_loss(loss, parameters)
            lower, upper = map(jnp.asarray, parameters.bounds())
            optimizer = optax.scale_by_adam()

            def objective(vector: Any, starts: Any) -> tuple[Any, Any]:
                prediction = error(vector, starts)
                penalty = monotone_penalty(jnp, parameters.with_vector(vector).thrust)
                return prediction + self.regularizer_weight * penalty, prediction

            def update(carry: Any, starts: Any) -> tuple[Any, Any]:
                vector, state = carry
                (_, prediction), gradient = jax.value_and_grad(objective, has_aux=True)(
                    vector, starts
                )
                direction, state = optimizer.update(gradient * (rates > 0), state)
                moved = jnp.clip(vector - rates * direction, lower, upper)
                return (jnp.where(rates > 0, moved, vector), state), prediction

            epoch = jax.jit(lambda carry, batches: jax.lax.scan(update, carry, batches))
            evaluate = jax.jit(error)

            vector = jnp.asarray(parameters.to_vector())
            carry = (vector, optimizer.init(vector))
            history = [Iteration(0, _mean_loss(evaluate, vector, train))]
            progress(history[0])
            for number in range(1, self.epochs + 1):
                shuffled = rng.permutation(train)[: len(train) // size * size]
                carry, losses = epoch(carry, shuffled.reshape(-1, size))
                history.append(Iteration(number, float(losses.mean())))
                progress(history[-1])
            final = _mean_loss(evaluate, carry[0], train)
        return Optimum(
            parameters=parameters.with_vector(np.asarray(carry[0])),
            loss=final,
            history=tuple(history),
            converged=True,
            message=f"{self.epochs} epochs done",
        )


def _mean_loss(evaluate: Callable[..., Any], vector: Any, train: Any) -> float:
    """Evaluate the loss on all training windows, in parts that bound the memory."""
    parts = np.array_split(train, max(1, len(train) // 4096))
    return sum(float(evaluate(vector, part)) * len(part) for part in parts) / len(train)


def batch_loss(loss: PredictionLoss, parameters: Parameters) -> Callable[[Any, Any], Any]:
    """Return the prediction loss as a function that JAX can differentiate."""
    windows, encoder, before = loss.windows, loss.encoder, loss.windows.encoder_length
    time, state, command = map(jnp.asarray, (windows.time, windows.state, windows.input))
    weights = jnp.asarray(loss.weights)[:, None]
    steps, real = jnp.arange(windows.prediction_length + 1)[:, None], windows.measured
    counts = None if real.all() else jnp.asarray(real.astype(float))

    def error(vector: Any, starts: Any) -> Any:
        dynamics = parameters.with_vector(vector).dynamics(jnp, loss.vehicle, loss.frame)
        past = gather_past(jnp, time, state, command, starts, before)
        index = starts + before - 1 + steps
        predicted = rollout(
            jnp,
            dynamics,
            encoder.encode(jnp, dynamics, past),
            jnp.moveaxis(command[index[:-1]], -1, 1),
            jnp.diff(time[index], axis=0),
        )
        measured = jnp.moveaxis(state[index[1:], :3], -1, 1)
        squares = (weights * (predicted[:, :3] - measured)) ** 2
        if counts is None:
            return jnp.mean(squares)
        return jnp.mean(squares * (some := counts[index[1:]])[:, None]) / jnp.mean(some)

    return error


def monotone_penalty(xp: Any, coefficients: Any) -> Any:
    """Compute the paper's regulariser without its weight (subsec:reg_force_model).

    The sum over propellers of max(0, -F'(φ)) at φ = 0, at φ = 1 and, by Proposition 1
    (prop:thrust), at the minimum of F' if it lies in between. The minimum is exact for degrees up
    to three; for higher ones it is searched on a grid of 41 points.
    """
    n, degree = coefficients.shape
    ends = xp.broadcast_to(xp.array([0.0, 1.0]), (n, 2))
    penalty = xp.sum(xp.maximum(-thrust_slope(coefficients, ends), 0.0))
    if degree < 3:
        return penalty  # F' is linear: its minimum is at an end.
    if degree > 3:
        grid = xp.broadcast_to(xp.linspace(0.0, 1.0, 41)[1:-1], (n, 39))
        lowest = xp.min(thrust_slope(coefficients, grid), axis=1)
        return penalty + xp.sum(xp.maximum(-lowest, 0.0))
    a, b, c = coefficients[:, 0], coefficients[:, 1], coefficients[:, 2]
    divisor = xp.where(c > 0, c, 1.0)
    stationary = -b / (3 * divisor)
    inside = (c > 0) & (stationary >= 0) & (stationary <= 1)
    return penalty + xp.sum(xp.where(inside, xp.maximum(b**2 / (3 * divisor) - a, 0.0), 0.0))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--epochs", type=int, default=200)
    options = parser.parse_args()
    folder = dataset_folder() / "experiments"
    training, validation = (
        read_authors_experiment(folder / name / "data.pt") for name in (TRAINING, VALIDATION)
    )
    every, kept = airpuck.Loss(spacing=0.0), airpuck.Preparation(faults="keep")
    for method in (airpuck.LevenbergMarquardt(), Adam(epochs=options.epochs)):
        began = time.perf_counter()
        fit = airpuck.identify(training, "M3", loss=every, method=method, preparation=kept)
        x, y, yaw = airpuck.evaluate(fit.model, validation).rmse
        print(
            f"{type(method).__name__}: loss {fit.loss:.4e}, {time.perf_counter() - began:.0f} s; "
            f"RMSE {1e3 * x:.2f} mm, {1e3 * y:.2f} mm, {yaw:.4f} rad"
        )


if __name__ == "__main__":
    from one_line import run

    run(main)
