"""The excitation experiment: random signals on top of a controller that holds position."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from airpuck.boundary.errors import InputError
from airpuck.control.authority import control_authority, pushes, weakest_effort
from airpuck.control.law import Pilot, Step
from airpuck.control.laws import PAPERS
from airpuck.control.reference import Reference, SetPoint, Unturned
from airpuck.control.tracking import TrackingController
from airpuck.control.tuning import Tuning, tuning_for
from airpuck.craft.table import Table
from airpuck.estimate.estimator import Estimate
from airpuck.model.model_file import Model
from airpuck.physics.rigid_body import acceleration_map
from airpuck.physics.thrust import thrust

#: Lowest acceleration, over all directions, with which a flight can be safe [m/s²].
_LEAST_PUSH = 1e-2
#: Largest cosine between the effects of two opposing propellers: 154 degrees.
_OPPOSED = -0.9
#: Fraction of the largest acceleration that a stop may need.
_BRAKING = 0.5
#: Fraction of this that is left, whatever pulls, and if nothing may turn the craft.
_LEFT = 0.25
#: Largest turn of the craft until its brakes act [rad]: turned further, they push another way.
_TURNED = 0.5


class Excitation(Pilot):
    """Excites the craft with random signals while keeping it on the table.

    Each pair of propellers gets one signal, uniform in ± amplitude and held for a while. The signal
    s is added to the difference w of the pair's two commands; one propeller then gets w + s and the
    other -(w + s), clipped, so that only one of them blows at a time (sec:experiment; the
    recordings show this sign). A propeller without a partner gets its command plus a signal of its
    own. Whenever the craft could not stop before the rails, the signals pause until it can.

    The controller assumes motors without lag. A controller that modelled the lag would compensate
    the signals, because it knows the commands actually sent.

    Parameters
    ----------
    model : Model
        The controller's model of the craft; a nominal model is enough.
    reference : Reference, optional
        Reference of the controller; by default the centre of the table.
    tuning : Tuning, optional
        Tuning of the controller; by default the one for the model. The law is always the LQR,
        whatever the tuning names.
    amplitude : float or sequence of float, default 1
        Largest signal, either one number for all or one each: first the pairs, then the propellers
        without a partner, each in the vehicle's order. Individual values may be 0.
    hold : float, default 0.2
        Time between changes of the signals [s].
    seed : int, default 0
        Seed of the signals.
    table : Table, optional
        The table with its rails; by default the paper's.
    margin : float, default 0.05
        Distance from the rails at which the craft must be able to stop [m].
    reaction : float, default 0
        Time for which the present commands still accelerate the craft before its brakes act [s].
        The signals also pause while the craft turns too far in this time, and a craft that could
        not stop before a rail returns without regard to its yaw. Brakes count as strong as they
        are without turning the craft.
    pull : sequence of float, default (0, 0)
        Acceleration along x and y that the model lacks, such as a slope's, against which a craft
        with a `reaction` brakes [m/s²].

    Raises
    ------
    InputError
        If amplitude, hold or margin are out of range, if the propellers of a pair do not oppose
        each other, or if all propellers together cannot push in every direction and turn the craft
        both ways.
    """

    def __init__(
        self,
        model: Model,
        reference: Reference | None = None,
        *,
        tuning: Tuning | None = None,
        amplitude: float | Sequence[float] = 1.0,
        hold: float = 0.2,
        seed: int = 0,
        table: Table | None = None,
        margin: float = 0.05,
        reaction: float = 0.0,
        pull: Sequence[float] = (0.0, 0.0),
        compiled: bool = True,
    ) -> None:
        weakest = float(pushes(np, model.dynamics).min())
        craft = model.vehicle.name
        if weakest < _LEAST_PUSH:
            raise InputError(
                f"the propellers of {craft!r} cannot push in every direction: the craft could not "
                "be kept on the table. Steer it by hand and record that flight"
            )
        if weakest_effort(model) < _LEAST_PUSH:
            raise InputError(
                f"the propellers of {craft!r} cannot push in every direction and turn it both "
                "ways: no positive thrusts of all cancel in force and in moment"
            )
        # The controller assumes motors without lag; see the class.
        self.controller = controller = TrackingController(
            replace(model, parameters=replace(model.parameters, motor_time_constant=0.0)),
            reference or SetPoint(0.0, 0.0, 0.0),
            # The signals are added to the commands of a law, which does not foresee them.
            (tuning or tuning_for(model)).with_law(PAPERS),
            reject_disturbance=False,
            compensate_delay=False,
            compiled=compiled,
        )
        #: The controller's reference.
        self.reference = controller.reference
        #: Measurements and sent commands concern only the controller.
        self.pose, self.measured, self.sent = controller.pose, controller.measured, controller.sent
        if not hold >= controller.tuning.period_s:
            raise InputError(
                f"must be at least the controller's period, {controller.tuning.period_s:g} s",
                field="hold",
            )
        self._hold = hold
        self._bits = np.random.PCG64(seed)
        self._rng = np.random.Generator(self._bits)
        self._signed, self._mixer = _mixing(model)
        self._amplitude = _amplitudes(amplitude, self._mixer.shape[1])
        self._reach = np.array((table or Table()).reach(model.vehicle.radius_m))
        if not (margin >= 0 and (self._reach > margin).all()):
            raise InputError(
                "must not be negative, and leave room between the rails", field="margin"
            )
        if reaction:
            alone = control_authority(model).alone
            straight = min(most for way, most in alone.items() if "turn" not in way)
            weakest = max(min(weakest, straight), _LEFT * weakest)
        self._braking, self._reaction, self._margin = _BRAKING * weakest, reaction, margin
        self._pull = np.asarray(pull, dtype=float)
        self._begun: float | None = None
        self._changes = 0
        self._signal = np.zeros(self._mixer.shape[1])
        #: Number of periods in which the signals paused.
        self.pauses = 0

    def step(self, time: float) -> Step:
        """Compute the command to send now.

        Parameters
        ----------
        time : float
            Now [s].

        Returns
        -------
        Step
            The controller's command plus the signals; without signals if the controller idles or
            the rails are near.
        """
        step = self.controller.step(time)
        if math.isfinite(time) and (self._begun is None or time < self._begun):
            # The first step, or the first after the clock was set back.
            self._begun, self._changes = time, 0
        if not step.flies or step.estimate is None:
            return step
        self._change(time)
        farthest = self._farthest(step.estimate)
        turned = abs(step.estimate.state[5]) * self._reaction
        if self._reaction:
            # A craft that could not stop before a rail leaves its yaw alone in the next step, and
            # the more of its spin, the less it turns until its brakes act.
            spin = step.estimate.state[5] * max(0.0, 1 - turned / _TURNED)
            free = Unturned(self.reference, np.append(step.estimate.state[:5], spin))
            stops = (farthest < self._reach).all()
            self.controller.reference = self.reference if stops else free
        if turned > _TURNED or not (farthest < self._reach - self._margin).all():
            self.pauses += 1
            return step
        vehicle = self.controller.model.vehicle
        signed = self._signed @ step.command + self._mixer @ self._signal
        command = np.clip(signed, *vehicle.command_range)
        return replace(step, command=vehicle.actuation.possible(command))

    def _change(self, time: float) -> None:
        """Draw the signals in force at a time, even if earlier steps were skipped."""
        assert self._begun is not None
        # Half a nanosecond keeps rounding from delaying a change.
        due = int((time - self._begun + 5e-10) / self._hold) + 1
        if due <= self._changes:
            return
        # Skip the missed draws, one 64-bit number each.
        self._bits.advance((due - 1 - self._changes) * len(self._signal))
        self._signal = self._rng.uniform(-self._amplitude, self._amplitude)
        self._changes = due

    def _farthest(self, estimate: Estimate) -> Float[np.ndarray, "*cases 2"]:
        """Return how far from the middle the craft may get until it has stopped [m]."""
        position, velocity = estimate.state[:2], estimate.state[3:5]
        if self._reaction:
            # The present commands may act until the brakes do, or end at once.
            dynamics = self.controller.model.dynamics
            by_thrust, _ = acceleration_map(np, dynamics, *estimate.state[[2, 5]])
            now = by_thrust[:2] @ thrust(dynamics.thrust, estimate.motor_speed) + self._pull
            gained = np.outer([0.0, 1.0], now * self._reaction)
            position = position + (velocity + gained / 2) * self._reaction
            velocity = velocity + gained
            # Brakes act along the motion, and less if something pulls the craft that way.
            speed = np.linalg.norm(velocity, axis=-1, keepdims=True)
            pull = (velocity @ self._pull)[:, None] / np.maximum(speed, 1e-9)
            braking = np.maximum(self._braking - pull, _LEFT * self._braking)
        else:
            speed, braking = np.abs(velocity), self._braking
        stop = position + velocity * speed / (2 * braking)
        return np.maximum(np.abs(position), np.abs(stop))


def _amplitudes(amplitude: float | Sequence[float], signals: int) -> Float[np.ndarray, " signals"]:
    """Return the amplitude of each signal."""
    each = np.asarray(amplitude, dtype=float)
    if each.ndim == 0:
        if not 0 < each <= 1:
            raise InputError("must be above 0 and at most 1", field="amplitude")
        return np.full(signals, float(each))
    if each.shape != (signals,) or not ((each >= 0) & (each <= 1)).all() or not each.any():
        raise InputError(
            f"must be one number, or {signals}: of each pair, then of each propeller without a "
            "partner; from 0 to 1, and not all 0",
            field="amplitude",
        )
    return each


def _mixing(model: Model) -> tuple[Float[np.ndarray, "c c"], Float[np.ndarray, "c signals"]]:
    """Return two matrices that mix the controller's commands and the signals.

    The first maps the commands of a pair to ± their difference and leaves single propellers
    unchanged. The second adds a signal with opposite signs to a pair, and once to a single
    propeller.
    """
    vehicle, effects = model.vehicle, model.propeller_effects
    effects = effects / np.linalg.norm(effects, axis=0)
    for (one, other), (first, second) in zip(vehicle.pairs, vehicle.pair_indices, strict=True):
        cosine = effects[:, first] @ effects[:, second]
        if cosine > _OPPOSED:
            raise InputError(
                f"{one} and {other} of {vehicle.name!r} do not oppose each other "
                f"in force and in moment (cosine {cosine:.2f}, at most {_OPPOSED:g}); take the "
                "pair out, and each is excited separately",
                field="pairs",
            )
    first, second = np.array(vehicle.pair_indices, dtype=int).reshape(-1, 2).T
    each = np.eye(len(vehicle.columns))
    mixer = [each[:, first] - each[:, second], np.delete(each, [*first, *second], axis=1)]
    signed = each.copy()
    signed[first, second] = signed[second, first] = -1.0
    return signed, np.hstack(mixer)
