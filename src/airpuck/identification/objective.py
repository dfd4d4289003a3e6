"""The batched multi-step prediction loss, its gradient and its Gauss-Newton approximation.

Windows are handled in batches, on all cores. The approximation consists of r'r, J'r and J'J of a
batch of windows.

Sensitivities of the prediction are propagated forward with the state and summed up inside the time
loop, which returns a number, a vector and a small matrix, whatever the number of windows. The
equations of motion are not differentiated by hand. At each Runge-Kutta stage JAX computes the local
Jacobian of the accelerations in forward mode. It differentiates with respect to the thrusts instead
of the many coefficients behind them; the powers of the polynomials are applied afterwards.

For speed (`airpuck.compute.compiled`), the batch is the last axis throughout, the sensitivities of
yaw and of velocities are kept separate, and each part of the accelerations is differentiated by
itself, along the coordinates that move it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cache, cached_property, partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from airpuck.boundary.errors import InputError
from airpuck.compute.compiled import double_precision, for_batches, lengthened
from airpuck.compute.process import usable_cores
from airpuck.craft.vehicle import Vehicle
from airpuck.data.windows import Windows, gather_past, integration_parts
from airpuck.estimate.encoder import StateEncoder
from airpuck.identification.settings import PUBLISHED_WEIGHTS
from airpuck.model.parameters import Parameters
from airpuck.physics.effects import IdleLag
from airpuck.physics.motor import all_lags, motor_step
from airpuck.physics.rigid_body import CenterOfMassFrame, Dynamics, acceleration, register_pytrees
from airpuck.physics.thrust import thrust, thrust_slope

#: Number of windows handled at once: large enough to fill vector units, small enough for the cache,
#: and few enough that a block of two seconds fills one batch
#: (`airpuck.identification.uncertainty`).
BATCH = 64
#: Recordings up to this many samples, a minute at 240 Hz, share a program: unused samples cost
#: nothing.
_SHORTEST = 1 << 14
#: Number of windows above which the batch size doubles: an eighth less time for each, but another
#: program to compile.
_LARGE = 10_000
#: Number of windows above which `PredictionLoss.thinned` drops some, and the factor.
_MANY, _THINNED = 1000, 4
#: First samples of B windows, and how often each counts.
_Batch = tuple[Int[np.ndarray, " B"], Float[np.ndarray, " B"]]
#: Runge-Kutta stages. Rows: time from the start of the step, and weight in the change of the motion
#: [steps]; weight in the change of the position [steps²].
_STAGES = np.array([[0, 1 / 2, 1 / 2, 1], [1 / 6, 1 / 3, 1 / 3, 1 / 6], [1 / 6, 1 / 6, 1 / 6, 0]])


def normal_equations(
    dynamics: tuple[Any, tuple[Any, ...], Any, Any],
    basis: list[dict[int, Any]],
    time: Any,
    state: Any,
    measured: Any,
    command: Any,
    command_slope: Any,
    starts: Any,
    multiplicity: Any,
    channel_weights: Any,
    *,
    encoder: StateEncoder,
    lengths: tuple[int, int],
    frame: CenterOfMassFrame,
    felt: int,
    once: bool,
) -> tuple[Any, Any, Any]:
    """Return r² and Jᵀr of each of a batch of B windows, and the sum of their JᵀJ.

    `lengths` are E and T; poses count where `measured` is one, not zero; accelerations depend on ω
    and on the first `felt` of γ, v_x, v_y, ω, x and y; a program that runs `once` is made to
    compile quickly. `dynamics` contains the parts of the accelerations: Π, centre of mass, effects.
    Local coordinates are the thrust coefficients, the directions of `basis`, in groups that move
    the same parts, τ and its increase at standstill, and the transport delay.

    Long because its inner functions share a dozen traced arrays, which would otherwise be arguments
    of each.
    """
    coefficients, parts, lag_values, own_lag = dynamics
    tau, lags = lag_values[0], lag_values.shape[0]
    (n, degree), batch = coefficients.shape, starts.shape[0]
    # The lag does not depend on the delay, the last local coordinate.
    by_lag, (before, ahead) = jnp.eye(lags + 1, lags), lengths

    past = gather_past(jnp, time, state, command, starts, before)
    past_slope = gather_past(jnp, time, state, command_slope, starts, before).command

    def with_delay(slope: Any) -> Any:
        """Return the derivative of a command with respect to lag and delay."""
        return jnp.stack([*[jnp.zeros_like(slope)] * lags, slope])

    def encode(values: Any, command: Any) -> Any:
        idle = [IdleLag(value) for value in values[1:]]
        matrix, center, *effects = parts
        model = Dynamics(coefficients, matrix, center, values[0], frame, (*effects, *idle), own_lag)
        return encoder.encode(jnp, model, replace(past, command=command))

    of_place = any(effect.of_place for effect in parts[2:])
    moving = [k for k in range(6) if k < felt or k == 3]

    def local(force: Any, motion: Any) -> tuple[Any, list[Any]]:
        """Accelerations; derivatives by thrusts, motion, and along the basis, (3, ·, B)."""
        point = {**dict(enumerate(parts)), "force": force, "motion": motion}

        def accelerate(changed: dict[Any, Any]) -> Any:
            force, motion, matrix, center, *effects = (
                changed.get(key, point[key]) for key in ("force", "motion", *range(len(parts)))
            )
            # As if propellers pushed as strongly as they turn.
            model = Dynamics(jnp.ones((n, 1)), matrix, center, tau, frame, tuple(effects))
            return jnp.stack(acceleration(jnp, model, motion, force))

        def slopes(along: dict[Any, Any]) -> Any:
            at = {key: point[key] for key in along}
            return jax.vmap(lambda d: jax.jvp(accelerate, (at,), (d,))[1], out_axes=1)(along)

        units = {"force": jnp.eye(n), "motion": jnp.eye(len(motion))[jnp.array(moving)]}
        each = [{key: unit[..., None] * jnp.ones(batch)} for key, unit in units.items()]
        return accelerate({}), [*map(slopes, (*each, *basis))]

    def rates(
        motion: Any, d_yaw: Any, d_velocity: Any, speed: Any, d_speed: Any, *place: Any
    ) -> tuple[Any, Any]:
        """Time derivative of (γ, vx, vy, ω), and of the sensitivities of (vx, vy, ω).

        `place` is the position and its sensitivities, if effects depend on it.
        """
        everything = jnp.concatenate([motion, place[0]]) if place else motion
        value, slopes = local(thrust(coefficients, speed), everything)
        by_force, by_motion, *by_parts = slopes
        powers = jnp.stack([speed**power for power in range(1, degree + 1)], axis=1)
        by_thrust = (by_force[:, :, None] * powers).reshape(3, -1, batch)
        by_speed = by_force * thrust_slope(coefficients, speed)
        by_motor = sum(by_speed[:, None, i] * d_speed[:, i] for i in range(n))
        d_motion = (d_yaw, *d_velocity, *(place[1] if place else ()))
        d_acceleration: Any = sum(by_motion[:, i, None] * d_motion[k] for i, k in enumerate(moving))
        d_acceleration += jnp.concatenate([by_thrust, *by_parts, by_motor], axis=1)
        return jnp.concatenate([motion[3:], value]), d_acceleration

    def advanced(
        h: Any, motion: Any, d_yaw: Any, d_velocity: Any, speeds: Any, d_speeds: Any, *place: Any
    ) -> list[Any]:
        """Return the changes of the motion and of the position (less h v), with sensitivities."""

        def stage(carry: Any, given: Any) -> tuple[Any, None]:
            slope, d_slope, d_spin, changes = carry
            (ahead, weight, of_position), speed, d_speed = given
            d_now = d_velocity + ahead * d_slope
            now = motion + ahead * slope, d_yaw + ahead * d_spin, d_now
            slope, d_slope = rates(*now, speed, d_speed, *place)
            moved = of_position * slope[1:3], of_position * d_slope
            steps = weight * slope, weight * d_slope, *moved
            changes = [change + step for change, step in zip(changes, steps, strict=True)]
            return (slope, d_slope, d_now[2], changes), None

        many = _STAGES.T[..., None] * jnp.stack([h, h, h**2]), speeds, d_speeds
        none, d_none = jnp.zeros_like(motion), jnp.zeros_like(d_velocity)
        carry = none, d_none, d_velocity[2], [none, d_none, none[1:3], d_none]
        # Unrolled, stages run faster, but take longer to compile; see `airpuck.compute.compiled`.
        return jax.lax.scan(stage, carry, many, unroll=1 if once else 4)[0][-1]

    def lag(speed: Any, d_speed: Any, held: Any, d_held: Any, duration: Any) -> tuple[Any, Any]:
        def turned(speed: Any, held: Any, values: Any) -> Any:
            own = all_lags(values[0], own_lag)
            return motor_step(jnp, speed, held, duration, own, *values[1:])

        end, push = jax.linearize(turned, speed, held, lag_values)
        return end, jax.vmap(push)(d_speed, d_held, by_lag)

    def step(carry: Any, k: Any) -> tuple[Any, None]:
        position, motion, speed, d_position, d_yaw, d_velocity, d_speed, sums = carry
        now = starts + before - 1 + k
        held, h = command[now].T, time[now + 1] - time[now]
        d_held = with_delay(command_slope[now].T)
        # As in `airpuck.physics.rigid_body.step`, with the sensitivities of every quantity.
        lagging = all_lags(tau, own_lag) > 0
        begin = jnp.where(lagging, speed, held), jnp.where(lagging, d_speed, d_held)
        middle, end = (lag(*begin, held, d_held, duration) for duration in (h / 2, h))
        there = ()
        if of_place:
            there = position + h / 2 * motion[1:3], d_position + h / 2 * d_velocity[:2]
        stages = *map(jnp.stack, zip(begin, middle, middle, end, strict=True)), *there
        changed, d_changed, moved, d_moved = advanced(h, motion, d_yaw, d_velocity, *stages)
        position += h * motion[1:3] + moved
        motion += changed
        d_pose = h * d_velocity + d_moved
        d_position, d_yaw = d_position + d_pose[:2], d_yaw + d_pose[2]
        d_velocity += d_changed

        scale = channel_weights[:, None] * jnp.sqrt(multiplicity * measured[now + 1])
        predicted = jnp.concatenate([position, motion[:1]])
        residual = scale * (predicted - state[now + 1, :3].T)
        square, score, curvature = sums
        square += jnp.sum(residual**2, axis=0)
        for c, row in enumerate((*d_position, d_yaw)):
            row = scale[c] * row
            score += row * residual[c]
            curvature += row @ row.T
        sums = square, score, curvature
        return (position, motion, end[0], d_position, d_yaw, d_velocity, end[1], sums), None

    encoded, push = jax.linearize(encode, lag_values, past.command)
    d_encoded = jax.vmap(push)(by_lag, with_delay(past_slope))
    size = coefficients.size + sum(len(jax.tree.leaves(along)[0]) for along in basis) + lags + 1
    # Of the local coordinates, only lag and delay affect the encoder's estimate.
    d_begun = jnp.moveaxis(d_encoded[:, :6], 0, 1)
    d_state = jnp.zeros((6, size, batch)).at[:, -(lags + 1) :].set(d_begun)
    states = encoded[:2], encoded[2:6], encoded[6:], d_state[:2], d_state[2], d_state[3:]
    sums = jnp.zeros(batch), jnp.zeros((size, batch)), jnp.zeros((size, size))
    carry = *states, d_encoded[:, 6 : 6 + n], sums
    return jax.lax.scan(step, carry, jnp.arange(ahead))[0][-1]


@cache
def compiled_normal_equations(once: bool = False) -> Callable[..., tuple[Any, Any, Any]]:
    """Compile `normal_equations`, quickly if it runs `once`; keywords must be hashable."""
    hashed = "encoder", "lengths", "frame", "felt"
    return for_batches(partial(normal_equations, once=once), once=once, static_argnames=hashed)


@dataclass(frozen=True)
class Quadratic:
    """A loss and its quadratic approximation at a point, as sums over G clusters of windows."""

    #: Parts of the loss, the mean square of the weighted errors.
    cluster_losses: Float[np.ndarray, " G"]
    #: Scores: parts of the gradient.
    scores: Float[np.ndarray, "G P"]
    #: Parts of the Gauss-Newton Hessian 2 JᵀJ / M, for M residuals.
    informations: Float[np.ndarray, "G P P"]

    @cached_property
    def loss(self) -> float:
        """The loss."""
        return float(self.cluster_losses.sum())

    @cached_property
    def gradient(self) -> Float[np.ndarray, " P"]:
        """Its gradient."""
        return self.scores.sum(axis=0)

    @cached_property
    def hessian(self) -> Float[np.ndarray, "P P"]:
        """Its Gauss-Newton Hessian."""
        return self.informations.sum(axis=0)


@dataclass(frozen=True, eq=False)
class PredictionLoss:
    """Mean squared prediction error over windows, steps and channels (eq. combined_loss).

    L(θ) = 1/(3 T W) Σ_windows Σ_{k=1…T} ‖ w ∘ (ŷ_{t+k|t} - y_{t+k}) ‖², y = (x, y, γ).

    Attributes
    ----------
    windows : Windows
        Windows to predict.
    vehicle : Vehicle
        The craft.
    encoder : StateEncoder
        Encoder that gives the initial state of predictions.
    weights : tuple of float
        w, for x, y [1/m] and γ [1/rad].
    frame : {"body", "world"}
        The frame in which the offset of the centre of mass is constant.
    multiplicity : array, shape (W,), or None
        How often each window counts, for resampling; None: once.
    continuous_delay : bool
        Whether commands act after the transport delay in θ, each step under their mean
        (`Windows.delayed`). Otherwise they act as the windows hold them, by whole samples, whatever
        θ says.
    clusters : array of int, shape (W,), or None
        The cluster of each window, 0 … G-1, for `quadratic`; None: a single cluster.
    """

    windows: Windows
    vehicle: Vehicle
    encoder: StateEncoder
    weights: tuple[float, float, float] = PUBLISHED_WEIGHTS
    frame: CenterOfMassFrame = "body"
    multiplicity: Float[np.ndarray, " W"] | None = None
    continuous_delay: bool = False
    clusters: Int[np.ndarray, " W"] | None = None

    @property
    def thinned(self) -> PredictionLoss:
        """Every fourth window if there are many; otherwise the loss itself.

        This takes a quarter of the time and keeps nearly all of the information: neighbours
        overlap.
        """
        if len(self.windows) < _MANY:
            return self
        counted = self.multiplicity
        return replace(
            self,
            windows=replace(self.windows, starts=self.windows.starts[::_THINNED]),
            multiplicity=None if counted is None else counted[::_THINNED],
            clusters=None,
        )

    def windows_at(self, parameters: Parameters) -> Windows:
        """Return the windows, with commands as they act.

        Parameters
        ----------
        parameters : Parameters
            θ; commands are held for its delay if that is continuous.

        Returns
        -------
        Windows
            The windows.
        """
        if not self.continuous_delay:
            return self.windows
        assumed = self.vehicle.nominal.transport_delay_s
        return self._refined.delayed(float(parameters.transport_delay), assumed)

    @cached_property
    def _refined(self) -> Windows:
        """The windows, with steps short enough for integration."""
        return self.windows.refined(max(map(integration_parts, self.windows.trajectories)))

    def quadratic(self, parameters: Parameters, *, within: Parameters | None = None) -> Quadratic:
        """Evaluate the loss and its Gauss-Newton approximation in one pass over the windows.

        Parameters
        ----------
        parameters : Parameters
            θ.
        within : Parameters, optional
            θ without the terms that are zero, or negligible: the motion does not act on them. This
            is the only pass with such terms, and compiles in half the time.

        Returns
        -------
        Quadratic
            Derivatives are with respect to ``parameters.to_vector()``.
        """
        square, score, curvature, owner, local = self._passed(parameters, within)
        scale = 1 / (3 * self._counted @ self.windows.poses)
        return Quadratic(
            cluster_losses=scale * _summed([part.sum() for part in square], owner),
            scores=2 * scale * _summed([part.sum(axis=1) for part in score], owner) @ local,
            informations=2 * scale * (local.T @ _summed(curvature, owner) @ local),
        )

    def window_gradients(
        self, parameters: Parameters
    ) -> tuple[Float[np.ndarray, " W"], Float[np.ndarray, "W P"]]:
        """Evaluate each window separately, regardless of its weight.

        Parameters
        ----------
        parameters : Parameters
            θ.

        Returns
        -------
        squares : array, shape (W,)
            Mean squared weighted error s of each window.
        gradients : array, shape (W, P)
            ∇s with respect to ``parameters.to_vector()``.
        """
        alike = replace(self, multiplicity=None, clusters=None)
        square, score, _, _, local = alike._passed(parameters)
        count, scale = len(self.windows), 1 / (3 * self.windows.poses)
        gradients = 2 * scale[:, None] * (np.concatenate(score, axis=1)[:, :count].T @ local)
        return scale * np.concatenate(square)[:count], gradients

    def _passed(
        self, parameters: Parameters, within: Parameters | None = None
    ) -> tuple[list[Any], list[Any], list[Any], list[int], Float[np.ndarray, "L P"]]:
        """Pass over the windows; return r² and Jᵀr of each, JᵀJ of batches with owners, dL/dθ."""
        register_pytrees()
        parts = _parts(parameters, self.vehicle)
        slopes, moved_by = _linear_basis(parameters, self.vehicle)
        windows = self.windows_at(parameters)
        slope = np.zeros_like(windows.input) if windows.input_slope is None else windows.input_slope
        lag = np.array([parameters.motor_time_constant], dtype=float)
        if parameters.idle_lag is not None:
            lag = np.append(lag, parameters.idle_lag)
        own_lag = self.vehicle.actuation.own_lag
        dynamics = (parameters.thrust, parts, lag, own_lag)
        samples = windows.time, windows.state, windows.measured.astype(float), windows.input, slope
        long = tuple(lengthened(values, _SHORTEST) for values in samples)
        with double_precision():
            # Copy to the device; creating the array with jax.numpy would compile a program for each
            # shape.
            model, data, weights = jax.device_put(
                ((dynamics, slopes), long, np.array(self.weights))
            )

        lengths = windows.encoder_length, windows.prediction_length
        _, _, *effects = _parts(within or parameters, self.vehicle)
        # Without effects nothing depends on the velocity, and few effects depend on the position.
        # With all missing terms, models with and without effects share a program.
        felt = 6 if any(effect.of_place for effect in effects) else 4 if effects or within else 1
        static = {"encoder": self.encoder, "lengths": lengths, "frame": self.frame, "felt": felt}
        normal_equations = partial(compiled_normal_equations(within is not None), **static)
        batches, owner = self._batches()

        def sums(batch: _Batch) -> Any:
            return [np.asarray(part) for part in normal_equations(*model, *data, *batch, weights)]

        try:
            with ThreadPoolExecutor(usable_cores()) as pool:
                square, score, curvature = map(list, zip(*pool.map(sums, batches), strict=True))
        except jax.errors.JAXTypeError as error:
            if not (terms := [q.term for q in parameters.own]):
                raise
            problem = "cannot be differentiated: use xp for all arithmetic, and xp.where for cases"
            raise InputError(problem, file=", ".join(terms), field="model") from error
        return square, score, curvature, owner, _local_coordinates(parameters, moved_by)

    @property
    def _counted(self) -> Float[np.ndarray, " W"]:
        """Number of times each window counts."""
        return np.ones(len(self.windows)) if self.multiplicity is None else self.multiplicity

    def _batches(self) -> tuple[list[_Batch], list[int]]:
        """Split the windows with weight into batches, and return the cluster of each batch."""
        clusters, counted = self.clusters, self._counted
        if clusters is None:
            clusters = np.zeros(len(self.windows), dtype=int)
        batches, owner = [], []
        starts = (self._refined if self.continuous_delay else self.windows).starts
        most = BATCH if len(starts) < _LARGE else 2 * BATCH
        # Batches of one size share one program; padding counts zero times.
        size = min(most, 1 << (len(starts) - 1).bit_length())
        for cluster in range(int(clusters.max()) + 1):
            members = np.flatnonzero((clusters == cluster) & (counted > 0))
            for first in range(0, len(members), size):
                part = members[first : first + size]
                missing = (0, size - len(part))
                starting = np.pad(starts[part], missing, mode="edge")
                batches.append((starting, np.pad(counted[part], missing)))
                owner.append(cluster)
        return batches, owner


def _summed(parts: Sequence[Any], owner: Sequence[int]) -> Float[np.ndarray, "G *shape"]:
    """Sum up the parts of each owner."""
    total = np.zeros((max(owner) + 1, *parts[0].shape))
    np.add.at(total, owner, np.array(parts))
    return total


def _parts(parameters: Parameters, vehicle: Vehicle) -> tuple[Any, ...]:
    """Return what accelerations consist of: Π, the centre of mass, and the effects."""
    dynamics = parameters.dynamics(np, vehicle)
    # The motors' lag is not part of the accelerations.
    effects = (effect for effect in dynamics.effects if effect.idle_lag is None)
    return dynamics.configuration, dynamics.center_of_mass, *effects


def _linear_basis(
    parameters: Parameters, vehicle: Vehicle
) -> tuple[list[dict[int, Any]], list[Any]]:
    """Return derivatives of `_parts`, and the entries of θ they are by, in the same order.

    A group holds the entries that move the same parts; its keys are their numbers. Derivatives are
    by complex steps, exact to rounding: f'(x) = Im f(x + iε)/ε for analytic f (Squire and Trapp,
    SIAM Review 40, 1998).
    """
    vector, step = parameters.to_vector(), 1e-30
    groups: dict[tuple[int, ...], list[Any]] = {}
    for entry in np.flatnonzero(~parameters.mask(frozenset({"thrust"}))):
        stepped = vector + 1j * step * np.eye(len(vector))[entry]
        moved = _parts(parameters.with_vector(stepped), vehicle)
        slopes = enumerate(jax.tree.map(lambda value: np.imag(value) / step, moved))
        slopes = {k: part for k, part in slopes if any(map(np.any, jax.tree.leaves(part)))}
        groups.setdefault(tuple(slopes), []).append((slopes, entry))
    groups.pop((), None)
    each = [[slopes for slopes, _ in group] for group in groups.values()]
    basis = [jax.tree.map(lambda *values: np.array(values), *slopes) for slopes in each]
    return basis, [entry for group in groups.values() for _, entry in group]


def _local_coordinates(parameters: Parameters, moved_by: list[Any]) -> Float[np.ndarray, "L P"]:
    """Return d(local)/dθ for the coordinates that `normal_equations` differentiates by."""
    last = ("motor_time_constant", "idle_lag", "transport_delay")
    thrust, *others = (parameters.mask(frozenset({name})) for name in ("thrust", *last))
    return np.concatenate([np.eye(len(thrust))[part] for part in (thrust, moved_by, *others)])
