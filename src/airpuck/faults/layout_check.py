"""Check that motor order and signs of a vehicle file agree with a recording."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from airpuck.craft.vehicle import Vehicle
from airpuck.data.trajectory import Trajectory, check_propellers
from airpuck.data.zero_order_hold import hold
from airpuck.faults.axis_signs import AxisSigns, body_acceleration, find_axis_signs
from airpuck.faults.effect_match import Match, cosines, match_effects, rotation
from airpuck.model.model_file import nominal_model
from airpuck.physics.motor import motor_speeds
from airpuck.physics.thrust import thrust

#: Longest transport delay that is tried [s].
_LONGEST_DELAY = 0.1
#: Rotation of the whole layout that is worth a remark [rad].
_TURNED = 0.3
#: Share of the variance that the commands must explain before anything is concluded.
_EXPLAINED = 0.3


@dataclass(frozen=True)
class PropellerCheck:
    """How the measured effect of one propeller compares with the stated one."""

    #: The propeller.
    name: str
    #: Cosine between the measured and the stated effect, 1: the same, -1: the opposite.
    agreement: float
    #: The propeller of the vehicle file whose effect the measured one resembles most.
    behaves_like: str
    #: ``agrees``, or what is wrong in words.
    verdict: str


@dataclass(frozen=True)
class LayoutCheck:
    """Result of `check_layout`."""

    #: One for each propeller.
    propellers: tuple[PropellerCheck, ...]
    #: Share of the acceleration's variance that the commands explain.
    explained: float
    #: Transport delay at which they explain most [s].
    delay: float
    #: Angle by which the whole layout seems turned against the measured yaw [rad].
    rotation: float
    #: Signs of x, y and yaw with which the rest was found.
    signs: AxisSigns

    @property
    def mirrored(self) -> bool:
        """Whether an axis of the pose, or its yaw, has the wrong sign."""
        return bool(self.signs.flipped)

    @property
    def conclusive(self) -> bool:
        """Whether the commands explain enough of the motion to judge."""
        return self.explained >= _EXPLAINED

    @property
    def agrees(self) -> bool:
        """Whether order and signs of all propellers agree with the recording."""
        right = not self.mirrored and all(p.verdict == "agrees" for p in self.propellers)
        return self.conclusive and right

    @property
    def remarks(self) -> tuple[str, ...]:
        """Sentences on the layout as a whole."""
        if not self.conclusive:
            return (
                "too little to judge: use a recording in which every motor was excited, and check "
                "the clocks of poses and commands",
            )
        remarks = [self.signs.remark] if self.mirrored else []
        if abs(self.rotation) > _TURNED:
            remarks.append(
                f"the whole layout is turned by {np.rad2deg(self.rotation):.0f} degrees against "
                "the measured yaw: align the rigid body of the motion capture with the craft"
            )
            if np.pi - abs(self.rotation) < _TURNED:
                both = AxisSigns(-self.signs.x, -self.signs.y, self.signs.yaw)
                remarks.append(f"or {both.remark}")
        return tuple(remarks)

    def to_json(self) -> dict[str, Any]:
        """Return the figures for ``--json``."""
        return {
            "agrees": self.agrees,
            "conclusive": self.conclusive,
            "explained": self.explained,
            "delay_s": self.delay,
            "rotation_rad": self.rotation,
            "mirrored": self.mirrored,
            "flipped": list(self.signs.flipped),
            "propellers": [vars(propeller) for propeller in self.propellers],
        }


def check_layout(trajectory: Trajectory, vehicle: Vehicle) -> LayoutCheck:
    """Measure what each motor does, and compare it with what the vehicle file says.

    The measured accelerations, turned into the body frame, are regressed on the nominal thrusts of
    all motors. Each column of the result is one motor's effect (two forces and a moment); it is
    compared with the columns of the vehicle's configuration matrix by its direction, so that the
    nominal thrust, mass and inertia need not be right. Transport delays up to 0.1 s are tried,
    since the one found by correlation relies on the layout that is in question.

    Parameters
    ----------
    trajectory : Trajectory
        A recording in which every motor was used.
    vehicle : Vehicle
        The vehicle file in question.

    Returns
    -------
    LayoutCheck
        A verdict for each propeller, and for the layout as a whole.
    """
    check_propellers(vehicle, trajectory)
    # Forces and moments in one unit: the moment as a force at the radius of gyration.
    nominal = nominal_model(vehicle)
    stated = nominal.propeller_effects
    forces = _nominal_thrusts(trajectory, vehicle)
    signs = find_axis_signs(trajectory, stated @ forces, _LONGEST_DELAY)
    accelerations = body_acceleration(signs.undone(trajectory))
    accelerations[2] *= nominal.radius_of_gyration
    period = trajectory.sample_period
    fits = []
    for shift in range(round(_LONGEST_DELAY / period) + 1):
        # The motion at sample k is explained by the thrusts `shift` samples before.
        usable = trajectory.usable[shift:]
        cause = forces[:, : len(trajectory) - shift][:, usable]
        effect, explained = _regress(accelerations[:, shift:][:, usable], cause)
        fits.append((explained, shift * period, effect))
    explained, delay, measured = max(fits, key=lambda fit: fit[0])

    names = vehicle.propeller_names
    likeness = cosines(measured, stated)
    matches = match_effects(measured, stated, np.arange(len(names)))
    checks = [
        PropellerCheck(
            name=name,
            agreement=float(likeness[k, k]),
            behaves_like=names[int(np.argmax(likeness[k]))],
            verdict=_verdict(matches[k], k, names),
        )
        for k, name in enumerate(names)
    ]
    turned = rotation(measured, stated)
    return LayoutCheck(tuple(checks), explained, delay, turned, signs)


def _nominal_thrusts(trajectory: Trajectory, vehicle: Vehicle) -> Float[np.ndarray, "n N"]:
    """Return the thrusts of nominal motors without a transport delay."""
    command = hold(trajectory.command_time, trajectory.command, trajectory.time)
    speed = motor_speeds(trajectory.time, command, vehicle.nominal.motor_time_constant_s)
    return thrust(vehicle.nominal_thrust, speed.T)


def _regress(
    measured: Float[np.ndarray, "3 M"], forces: Float[np.ndarray, "n M"]
) -> tuple[Float[np.ndarray, "3 n"], float]:
    """Least squares for the effect of each force, and the share of variance explained."""
    effect = np.linalg.lstsq(forces.T, measured.T, rcond=None)[0].T
    residual = measured - effect @ forces
    total = np.sum(measured**2, axis=1)
    shares = 1 - np.sum(residual**2, axis=1) / np.where(total > 0, total, np.inf)
    shares = np.where(total > 0, shares, 0.0)
    return effect, float(np.mean(shares))


def _verdict(match: Match, k: int, names: tuple[str, ...]) -> str:
    """Describe how a propeller's measured effect compares."""
    if match.acts_as is None:
        return "has no such effect: check its position, direction and wiring"
    if match.acts_as != k:
        reversed_ = "" if match.sign > 0 else " the other way round"
        return f"behaves like {names[match.acts_as]}{reversed_}: motors are swapped"
    if match.sign < 0:
        return "pushes the other way: its direction is wrong by 180 degrees"
    return "agrees"
