"""The check of a layout: motors under swapped signs of the axes, and findings by cause."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from jaxtyping import Float

from airpuck.boundary.results import CauseKind, Finding, Result
from airpuck.data.trajectory import Trajectory
from airpuck.deviation.window_regression import LEVEL
from airpuck.faults.propeller_check import (
    EXCHANGED,
    HARMLESS,
    REVERSED,
    TURNED,
    TURNS,
    PropellerCheck,
)
from airpuck.physics.rigid_body import to_body

#: If the forces are turned by 180 degrees to within this angle, two more flips are assumed.
_HALF_TURN = 0.5
#: Least improvement of the sum of correlations, at most 2, by which other signs are accepted.
_MARGIN = 0.15


@dataclass(frozen=True)
class AxisSigns:
    """Signs by which logged x, y and yaw are multiplied to get the true ones."""

    x: int = 1
    y: int = 1
    yaw: int = 1

    @property
    def flipped(self) -> tuple[str, ...]:
        """Names of the axes with the wrong sign."""
        return tuple(name for name in ("x", "y", "yaw") if getattr(self, name) < 0)

    @property
    def names(self) -> tuple[str, ...]:
        """The wrong signs in words."""
        return tuple("the yaw" if name == "yaw" else f"the {name} axis" for name in self.flipped)

    def line(self, axes: Sequence[str]) -> str:
        """Return the corrected line of a mapping file; `axes` are its current ones."""
        signs = (self.x, self.y, self.yaw)
        mended = [_turned(a) if sign < 0 else a for a, sign in zip(axes, signs, strict=True)]
        return f"axes = {mended}".replace("'", '"')

    def undone(self, trajectory: Trajectory) -> Trajectory:
        """Return the trajectory with true signs."""
        signs = np.array([self.x, self.y, self.yaw], dtype=float)
        return replace(
            trajectory,
            state=trajectory.state * np.tile(signs, 2),
            acceleration=trajectory.acceleration * signs,
        )


def _turned(axis: str) -> str:
    """Return an axis of a mapping with the opposite sign."""
    return axis.removeprefix("-") if axis.startswith("-") else f"-{axis}"


def find_axis_signs(
    trajectory: Trajectory, modelled: Float[np.ndarray, "3 N"], longest_delay: float
) -> AxisSigns:
    """Find the signs with which modelled body accelerations best explain the measured ones.

    Forces may be turned by any angle, since the rigid body may be. Their complex correlation
    therefore counts by magnitude; the correlation of moments counts by value.
    """
    scores = {}
    for y, yaw in product((1, -1), repeat=2):
        signs = AxisSigns(1, y, yaw)
        true = signs.undone(trajectory)
        measured = to_body(true.acceleration, true.state[:, 2]).T * trajectory.usable
        scores[signs] = max(
            _likeness(measured[:, shift:], modelled[:, : modelled.shape[1] - shift])
            for shift in range(trajectory.steps(longest_delay) + 1)
        )
    usual = scores[AxisSigns()]
    best = max(scores, key=lambda signs: scores[signs][0])
    if scores[best][0] < usual[0] + _MARGIN:
        return AxisSigns()
    if np.pi - abs(scores[best][1]) < _HALF_TURN:
        return replace(best, x=-best.x, y=-best.y)
    return best


def _likeness(
    measured: Float[np.ndarray, "3 M"], modelled: Float[np.ndarray, "3 M"]
) -> tuple[float, float]:
    """Return the sum of the two correlations, and the rotation of the forces [rad]."""
    force, cause = (a[0] + 1j * a[1] for a in (measured, modelled))
    turned = _correlation(cause, force)
    return float(abs(turned) + _correlation(modelled[2], measured[2]).real), float(np.angle(turned))


def _correlation(cause: np.ndarray, effect: np.ndarray) -> complex:
    """Return the normalised inner product; zero if either vector is zero."""
    size = np.linalg.norm(cause) * np.linalg.norm(effect)
    return complex(np.vdot(cause, effect) / size) if size > 0 else 0j


#: Axes of a mapping that renames none.
AXES = ("x", "y", "z")
#: If a verdict would need this multiple of the flight's length, the motors were barely used.
_TOO_LONG = 100.0
#: Shortest usable recording from which anything is concluded [s].
_SHORTEST = 2.0


@dataclass(frozen=True, repr=False)
class LayoutCheck(Result):
    """Result of `check_layout`."""

    JSON = (
        "agrees conclusive explained p_value delay_s=delay rotation_rad=rotation length_ratio "
        "inertia_ratio mirrored flipped=signs.flipped exchanged tilt_rad=tilt "
        "tilt_error_rad=tilt_error dish_rad_m=dish friction_m_s2=friction propellers"
    )

    #: One for each propeller.
    propellers: tuple[PropellerCheck, ...]
    #: Fraction of the variance of mean accelerations that the commands explain.
    explained: float
    #: Probability that chance explains as much.
    p_value: float
    #: Transport delay at which they explain most [s].
    delay: float
    #: Angle by which the whole layout seems rotated against the measured yaw [rad].
    rotation: float
    #: Signs of x, y and yaw with which the other results were found.
    signs: AxisSigns
    #: Factor by which positions are too large for the measured turns: 1, or a power of ten.
    length_ratio: float = 1.0
    #: Inertia at which forces and moments agree, relative to the vehicle file's; 1 if it is close.
    inertia_ratio: float = 1.0
    #: Whether no motor's thrust ever changes.
    still: bool = False
    #: Usable time of poses and commands together [s].
    usable: float = np.inf
    #: Our x, y, z in terms of the file's axes, as in the mapping.
    axes: tuple[str, ...] = AXES
    #: Flight time needed to detect nominal motors, relative to the recording's duration.
    longer: float = np.inf
    #: Length of the windows over which accelerations are averaged [s].
    window: float = np.nan
    #: Slope of the table where it is clear and matters, positive where the table falls, and its
    #: standard error [rad].
    tilt: tuple[float, float] | None = None
    tilt_error: tuple[float, float] | None = None
    #: Likewise, change of the slope along x with x, along y with y, and of each with the other
    #: [rad/m].
    dish: tuple[float, float, float] | None = None
    #: Likewise, dry friction of the floor [m/s²].
    friction: float | None = None

    def __repr__(self) -> str:
        each = (f"{p.name} {p.agreement:.3f} {p.verdict}" for p in self.propellers)
        return "\n".join(["; ".join(each), *self.lines[len(self.propellers) :]])

    @property
    def lines(self) -> tuple[str, ...]:
        """The verdict on each propeller, and remarks about the layout."""
        return (
            *(f"{p.name:16s} {p.agreement:6.3f}  {p.verdict}" for p in self.propellers),
            f"the commands explain {100 * self.explained:.0f} % of the acceleration",
            *self.remarks,
        )

    @property
    def mirrored(self) -> bool:
        """Whether an axis of the pose, or its yaw, has the wrong sign."""
        return bool(self.signs.flipped)

    @property
    def exchanged(self) -> bool:
        """Whether x and y stand in each other's place: one is flipped, and all turned by 90°."""
        return self.signs.flipped == ("y",) and abs(abs(self.rotation) - np.pi / 2) < TURNED

    @property
    def conclusive(self) -> bool:
        """Whether the commands explain enough of the motion for a verdict."""
        return bool(self.p_value < LEVEL and self.usable >= _SHORTEST)

    @property
    def agrees(self) -> bool:
        """Whether order and signs of all propellers agree with the recording."""
        return self.conclusive and not self.wrong

    @property
    def reversed(self) -> bool:
        """Whether all propellers push the other way."""
        return any(one.verdict == REVERSED for one in self.propellers)

    @property
    def untouched(self) -> int:
        """Number of propellers that agree, less the number of axes with the wrong sign."""
        fine = sum(one.verdict in ("agrees", TURNS, EXCHANGED, REVERSED) for one in self.propellers)
        return fine - len(self.signs.flipped) - self.reversed

    @property
    def floor(self) -> dict[str, Float[np.ndarray, " k"]]:
        """Coefficients of the floor's effects, by the names of a model's parameters."""
        found = {"tilt": self.tilt, "dish": self.dish}
        if self.friction is not None:
            found["friction"] = (self.friction, 0.0)
        return {name: np.array(value) for name, value in found.items() if value is not None}

    @property
    def wrong(self) -> tuple[str, ...]:
        """Items that disagree: axes, the unit of length, names of propellers."""
        return (
            *(("the order of x and y",) if self.exchanged else self.signs.names),
            *(("the unit of length",) if self.length_ratio != 1 else ()),
            *(("all directions",) if self.reversed else ()),
            *(("the yaw's zero",) if any(p.verdict == TURNS for p in self.propellers) else ()),
            *(p.name for p in self.propellers if p.verdict not in HARMLESS),
        )

    @property
    def remarks(self) -> tuple[str, ...]:
        """Sentences about the layout as a whole."""
        if self.conclusive:
            return tuple(said[0].lower() + said[1:] for said in (f.sentence for f in self.common))
        if self.usable < _SHORTEST:
            return (
                f"too short to judge: poses and commands can be used together for {self.usable:.1f}"
                f" s, but {_SHORTEST:g} s are needed; check the clocks and gaps of both",
            )
        if self.still:
            return (
                "too little to judge: the commands never change; use a recording in which every "
                "motor was excited",
            )
        if 1 < self.longer < _TOO_LONG:
            return (
                "too little to judge: motors of nominal thrust would be seen in about "
                f"{self.usable * self.longer:.0f} s; this recording has {self.usable:.0f} s",
            )
        return (
            "too little to judge: use a recording in which every motor was excited, and check "
            "the clocks of poses and commands, and the unit of the yaw",
        )

    @property
    def common(self) -> tuple[Finding, ...]:
        """Findings on the layout as a whole, and on the floor; empty if not conclusive."""
        return layout_findings(self) if self.conclusive else ()


def layout_findings(check: LayoutCheck) -> tuple[Finding, ...]:
    """Describe what is wrong with poses, layout and floor as a whole."""
    return (*_poses(check), *_layout(check), *_floor(check))


#: How verdicts on propellers begin that lead to a finding: its kind, the cause for each propeller,
#: and the remedy.
_ACCUSED: dict[str, tuple[CauseKind, str, str]] = {
    "behaves like": (
        "order",
        "{0.name} acts like {0.behaves_like}",
        "Correct the commands' columns, or the cables; see `airpuck check`.",
    ),
    "pushes the other way": (
        "actuator",
        "{0.name} pushes the other way",
        "Correct direction_deg by 180 degrees, or the motor's sense of rotation.",
    ),
    "has no such effect": (
        "layout",
        "{0.name} does not act as stated",
        "Check their positions, directions and wiring.",
    ),
}


def propeller_findings(check: LayoutCheck) -> tuple[Finding, ...]:
    """Describe which propellers are swapped, reversed, or have another effect than stated."""
    wrong, found = [one for one in check.propellers if one.verdict not in HARMLESS], []
    for verdict, (kind, cause, remedy) in _ACCUSED.items():
        ones = [one for one in wrong if one.verdict.startswith(verdict)]
        cosines = ", ".join(f"cosine {one.agreement:.2f}" for one in ones)
        if ones:
            found.append(Finding(kind, "; ".join(map(cause.format, ones)), cosines, remedy))
    return tuple(found)


def _poses(check: LayoutCheck) -> list[Finding]:
    """Describe wrong signs, units and axes of the poses."""
    found = []
    if check.exchanged:
        found.append(_exchanged(check))
    elif check.mirrored:
        found.append(_flipped(check, check.signs))
    if check.length_ratio != 1:
        ratio = f"the craft moves {check.length_ratio:g} times as far as its turns imply"
        remedy = 'Correct it in the mapping file, under [pose], such as units = ["mm"].'
        found.append(Finding("units", "The unit of length is wrong", ratio, remedy))
    verdicts = {one.verdict for one in check.propellers}
    # Swapped motors can look like a rotation, but the others would be turned, too.
    swapped = "agrees" in verdicts and not verdicts <= set(HARMLESS)
    if abs(check.rotation) > TURNED and not (swapped or check.reversed or check.exchanged):
        cause = f"The whole layout is turned by {np.rad2deg(check.rotation):.0f} degrees"
        remedy = "Align the rigid body of the motion capture with the craft; if the cables of "
        remedy += "equivalent motors are shifted round the craft, correct their order."
        found.append(Finding("axes", cause, "against the measured yaw", remedy))
        if np.pi - abs(check.rotation) < TURNED:
            signs = check.signs
            found.append(_flipped(check, AxisSigns(-signs.x, -signs.y, signs.yaw), "or "))
    return found


def _exchanged(check: LayoutCheck) -> Finding:
    """Describe x and y that stand in each other's place."""
    x, y, z = check.axes
    if check.rotation > 0:
        x, y = _turned(x), _turned(y)
    cause = "The x axis and the y axis are exchanged"
    return _mended(check, cause, f'axes = ["{y}", "{x}", "{z}"]')


def _flipped(check: LayoutCheck, signs: AxisSigns, before: str = "") -> Finding:
    """Describe axes with the wrong sign."""
    what, one = " and ".join(signs.names), len(signs.names) == 1
    cause = f"{before}{what} {'is' if one else 'are'} flipped: "
    cause += f"{'counts' if one else 'count'} the wrong way"
    return _mended(check, cause[0].upper() + cause[1:], signs.line(check.axes))


def _mended(check: LayoutCheck, cause: str, line: str) -> Finding:
    """Describe axes that a line of the mapping file mends."""
    explained = f"the commands then explain {100 * check.explained:.0f} % of the acceleration"
    return Finding("signs", cause, explained, f"Correct the mapping file, under [pose]: {line}")


def _layout(check: LayoutCheck) -> list[Finding]:
    """Describe directions and masses of the vehicle file that are wrong as a whole."""
    found = []
    if check.reversed:
        count = f"{len(check.propellers)} of {len(check.propellers)}"
        remedy = (
            "direction_deg is the direction of the thrust, not of the air: add 180 to each in the "
            "vehicle file."
        )
        found.append(Finding("signs", "All propellers push the other way", count, remedy))
    if check.inertia_ratio != 1:
        cause = "Forces and moments of the propellers do not fit the vehicle file"
        agree = f"they agree if the inertia is about {check.inertia_ratio:.1g} times as large"
        remedy = "Correct inertia_kg_m2, mass_kg or the propellers' positions."
        found.append(Finding("mass", cause, agree, remedy))
    return found


def _floor(check: LayoutCheck) -> list[Finding]:
    """Describe a floor that is not level, flat and smooth."""
    found = []
    if check.tilt is not None and check.tilt_error is not None:
        x, y = (
            f"{1e3 * slope:.1f} ± {1e3 * error:.1f} mrad"
            for slope, error in zip(check.tilt, check.tilt_error, strict=True)
        )
        falls, remedy = f"it falls by {x} along x and {y} along y", "identify a model with +tilt."
        found.append(Finding("physics", "The table is tilted", falls, f"Level it, or {remedy}"))
    if check.dish is not None:
        slopes = ", ".join(f"{1e3 * change:.1f}" for change in check.dish)
        changes = f"its slope changes by {slopes} mrad/m along x, along y and across"
        remedy = "Identify a model with +tilt+dish."
        found.append(Finding("physics", "The table is not flat", changes, remedy))
    if check.friction is not None:
        dry = f"dry friction of {check.friction:.2g} m/s²"
        remedy = "Clean it, or identify a model with +drag+friction."
        found.append(Finding("physics", "The floor is rough", dry, remedy))
    return found
