"""A player: estimates craft, puck and opponent, decides, and steers the craft."""

from __future__ import annotations

import math
import time as clock
from collections import deque
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from jaxtyping import Float

from airpuck import (
    AirHockey,
    Fence,
    InputError,
    KeepOut,
    Measurement,
    Model,
    Pilot,
    Rendezvous,
    SetPoint,
    Step,
    TrackingController,
    Tuning,
    default_tuning,
)
from airpuck.extend import (
    MinimalTimes,
    check_steerable,
    checked_class,
    minimal_times_of,
    numbers,
    thrust,
)
from airpuck_hockey.player.all_rounder import AllRounder
from airpuck_hockey.player.rival import Rival, RivalWatcher
from airpuck_hockey.player.tactic import Frame, Intention, Pitch, Tactic, View
from airpuck_hockey.puck.prediction import drawn_path
from airpuck_hockey.puck.puck_filter import PuckFilter

#: Number of commands at which the thrust is computed.
_COMMANDS = 500
_SHARE = numbers.Range(0.05, 1.0, "the craft must move", "of the full thrust")
_REACTION = numbers.Range(0.0, 1.0, "with a longer one, the player reacts too late", "s")
_NOISE = numbers.Range(0.0, 1.0, "with more, no shot would go forward", "rad")


@dataclass(frozen=True)
class Level:
    """A handicap.

    Attributes
    ----------
    thrust : float
        Fraction of the craft's thrust that is used.
    reaction_s : float
        Delay with which puck and opponent are seen.
    shot_noise_rad : float
        Standard deviation of the direction of shots.

    Raises
    ------
    InputError
        If a number is out of range.

    Examples
    --------
    >>> easy = airpuck_hockey.Level(thrust=0.6, reaction_s=0.15)
    >>> easy.thrust
    0.6
    """

    thrust: float = 1.0
    reaction_s: float = 0.0
    shot_noise_rad: float = 0.0

    def __post_init__(self) -> None:
        _SHARE.check(self.thrust, "thrust")
        _REACTION.check(self.reaction_s, "reaction_s")
        _NOISE.check(self.shot_noise_rad, "shot_noise_rad")


#: By name.
LEVELS = {
    "easy": Level(thrust=0.45, reaction_s=0.15, shot_noise_rad=0.15),
    "medium": Level(thrust=0.55, reaction_s=0.12, shot_noise_rad=0.1),
    "hard": Level(),
}


def weakened(model: Model, share: float) -> Model:
    """Return a craft whose largest command gives a share of the full thrust."""
    if share >= 1.0:
        return model
    vehicle = model.vehicle
    commands = np.linspace(vehicle.command_min, vehicle.command_max, _COMMANDS)
    given = np.array(
        [np.sum(thrust(model.dynamics.thrust, np.full(vehicle.n_propellers, c))) for c in commands]
    )
    most = float(commands[np.searchsorted(given, share * given[-1])])
    return replace(model, vehicle=vehicle.model_copy(update={"command_max": most}))


def slower(times: MinimalTimes, share: float) -> MinimalTimes:
    """Return the shortest times of a craft that accelerates with a fraction of the thrust.

    With the acceleration a, the distance d from the speed v takes
    T(d, v, a) = T(d, v / √s, a / s) / √s.
    """
    root = share**0.5
    return replace(times, speed=times.speed * root, time=times.time / root)


#: Visibility of the puck. ``frozen``: the same pose repeated for a puck that was moving; ``lost``:
#: no pose for a while.
Sight = Literal["seen", "hidden", "frozen", "lost"]

#: Age of the last pose above which the puck counts as hidden, and as lost [s].
_HIDDEN, _LOST = 0.15, 1.0
#: A pose repeated this often, for a puck faster than this [m/s], is not a measurement.
_FROZEN, _MOVING = 6, 0.1
#: Poses further beyond a rail cannot be the puck's [m].
_BEYOND = 0.1
#: A disc outside the table, which restricts nothing: x, y, radius [m].
_NOWHERE = (50.0, 50.0, 0.1)
#: Clearance between the craft's edge and the centre line [m].
_MARGIN = 0.01
#: Distance over which the craft's mean acceleration is computed [m].
_SHORT = 0.3
#: Weight of the newest frame in the opponent's velocity: a compromise of noise and delay.
_SMOOTHING = 0.3
#: Half the size of the fence of a craft that is too large for its half [m].
_NO_ROOM = 1e-3
#: Clearance between the craft's edge at home and its goal line [m].
_HOME = 0.10


def check_player(model: Model) -> None:
    """Raise InputError if a craft cannot play: before its shortest times take minutes to plan."""
    check_steerable(model)
    name, actuation = model.vehicle.name, model.vehicle.actuation
    if actuation.two_way.any():
        raise InputError(
            f"{name!r} has wheels or reversible propellers, and hockey is for propellers that push "
            "one way; steer it with the LQR or MPC (`airpuck track`)"
        )
    kind, period = actuation.kind, default_tuning().period_s
    if (kind.pwm_period_s or 0.0) > period:
        raise InputError(
            f"{name!r} takes one command every {1e3 * (kind.pwm_period_s or 0.0):g} ms "
            f"(pwm_period_s), and hockey needs one every {1e3 * period:g} ms; steer it with "
            "`airpuck track`"
        )


@checked_class
class Player(Pilot):
    """A craft that plays air hockey on one half of the table: a `Pilot`.

    Parameters
    ----------
    model : Model
        The craft.
    equipment : AirHockey
        Table and puck.
    tactic : Tactic, optional
        Makes decisions; by default the package's own tactic.
    level : Level, optional
        A handicap; by default none.
    side : {-1, 1}, default -1
        Sign of the x of its half.
    tuning : Tuning, optional
        Tuning of the controller, whose predictive law is used; by default the one for the model.
    seed : int, default 0
        Seed of the noise of its shots.
    opponent_radius : float, optional
        Radius of the opponent's disc [m]; by default the radius of the human's mallet.
    learns : bool, default True
        Whether it learns puck, rails and opponent during play.

    Attributes
    ----------
    reference : Reference
        Reference of the craft, in the world's frame.
    intention : Intention or None
        The latest intention, in the world's frame.
    sight : str
        Visibility of the puck: ``seen``, ``hidden``, ``frozen``, ``lost``.
    took : tuple of float
        Computing time of decision and control in the last step [s].

    Raises
    ------
    InputError
        If the side is neither -1 nor 1, another number is out of range, or the craft cannot be
        controlled.

    Examples
    --------
    >>> weaker = airpuck_hockey.Level(thrust=0.8)
    >>> player = airpuck_hockey.Player(model, airpuck.AirHockey(), level=weaker)
    >>> twin = airpuck.Twin(model, puck=airpuck.PuckState(0.0, 0.0))
    >>> log = airpuck.fly(player, twin, duration=0.1)
    >>> len(log.status)
    10
    """

    def __init__(
        self,
        model: Model,
        equipment: AirHockey,
        tactic: Tactic | None = None,
        *,
        level: Level = LEVELS["hard"],
        side: int = -1,
        tuning: Tuning | None = None,
        seed: int = 0,
        opponent_radius: float | None = None,
        learns: bool = True,
    ) -> None:
        if side not in (-1, 1):
            raise InputError(f"must be -1 or 1, not {side!r}", field="side")
        numbers.SEED.check(seed, "seed")
        if opponent_radius is not None:
            numbers.DISTANCE.check(opponent_radius, "opponent_radius")
        self.watches = ("puck", "mallet")
        self.tactic: Tactic = tactic or AllRounder()
        self.level, self.side, self.equipment = level, side, equipment
        self.frame = Frame(side)
        self.filter = PuckFilter(equipment, learns=learns)
        self._times = slower(minimal_times_of(model), level.thrust)
        self.pitch = pitch_of(model, equipment, self._times, opponent_radius)
        self._fence = Fence(*self.frame.box(self.pitch.fence).ravel().tolist())
        self._controller = TrackingController(
            weakened(model, level.thrust),
            SetPoint(*self.pitch.home, 0.0),
            tuning,
            law="mpc",
            limits=(self._fence, KeepOut(*_NOWHERE)),
        )
        self.reference = self._controller.reference
        self.intention: Intention | None = None
        self.sight: Sight = "lost"
        self.took = (0.0, 0.0)
        self._random = np.random.default_rng(seed)
        #: Angle by which the present shot is turned; nan: there is none [rad].
        self._noise = math.nan
        #: Poses that wait for the reaction time to pass: stamp and pose.
        self._puck_poses: deque[tuple[float, Float[np.ndarray, " 3"]]] = deque()
        self._opponent_poses: deque[tuple[float, Float[np.ndarray, " 3"]]] = deque()
        #: The opponent at its last pose: stamp, x, y, vx, vy.
        self._opponent: tuple[float, Float[np.ndarray, " 4"]] | None = None
        self._watcher = RivalWatcher(self.pitch.goal_line)
        self._learns = learns
        self._same, self._before_same = 0, 0.0
        self._last_puck: Float[np.ndarray, " 3"] | None = None
        self._craft: tuple[float, Float[np.ndarray, " 6"]] | None = None

    def measured(self, measurement: Measurement) -> None:
        """Receive a measurement.

        Parameters
        ----------
        measurement : Measurement
            A measurement of the craft (see `TrackingController.measured`), or a pose of the puck or
            of the opponent's disc. Poses that are not finite or off the table are ignored.
        """
        time, values = measurement.stamp, measurement.values
        if measurement.kind == "puck":
            _queue(self._puck_poses, time, values)
        elif measurement.kind == "mallet":
            _queue(self._opponent_poses, time, values)
        else:
            self._controller.measured(measurement)
            if measurement.kind == "pose" and self._craft is None and np.isfinite(values).all():
                self._craft = time, np.concatenate([values, np.zeros(3)])

    def sent(self, time: float, command: Float[np.ndarray, " n"]) -> None:
        """Receive the command that was actually sent; see `Pilot.sent`."""
        self._controller.sent(time, command)

    def step(self, time: float) -> Step:
        """Decide, and compute the command to send now.

        Parameters
        ----------
        time : float
            Current time, on the clock of the poses [s].

        Returns
        -------
        Step
            A command in every case; see `TrackingController.step`.

        Raises
        ------
        InputError
            If the tactic does not return an `Intention`.
        """
        began = clock.perf_counter()
        if math.isfinite(time):
            self._see(time)
            self._decide(time)
        decided = clock.perf_counter()
        step = self._controller.step(time)
        if step.estimate is not None:
            self._craft = step.estimate.time, step.estimate.state
        self.took = decided - began, clock.perf_counter() - decided
        return step

    @property
    def predicted(self) -> Float[np.ndarray, "N 2"] | None:
        """Predicted path of the puck, in the world's frame; None if it is not seen."""
        belief = self.filter.belief
        if belief is None or self.sight != "seen":
            return None
        return self.frame.points(drawn_path(self.filter.model.equipment, belief))

    def _see(self, time: float) -> None:
        """Update puck and opponent with the poses that are visible by now."""
        seen = time - self.level.reaction_s
        for waiting, see in (
            (self._puck_poses, self._see_puck),
            (self._opponent_poses, self._see_opponent),
        ):
            while waiting and waiting[0][0] <= seen:
                stamp, pose = waiting.popleft()
                see(stamp, self.frame.states(pose))
        belief = self.filter.belief
        age = math.inf if belief is None else seen - belief.time
        if self._same >= _FROZEN and self._before_same > _MOVING:
            self.sight = "frozen"
        elif age <= _HIDDEN:
            self.sight = "seen"
        else:
            self.sight = "hidden" if age <= _LOST else "lost"

    def _see_puck(self, stamp: float, pose: Float[np.ndarray, " 3"]) -> None:
        """Update the puck with a pose, unless it is off the table."""
        table, (x, y) = self.equipment.table, pose[:2].tolist()
        if abs(x) > table.length_m / 2 + _BEYOND or abs(y) > table.width_m / 2 + _BEYOND:
            return
        if self._last_puck is not None and pose.tolist() == self._last_puck.tolist():
            self._same += 1
        else:
            belief = self.filter.belief
            self._same = 0
            self._before_same = 0.0 if belief is None else math.hypot(*belief.mean[3:5].tolist())
        self._last_puck = pose
        hits = len(self.filter.events)
        self.filter.pose(stamp, pose)
        belief = self.filter.belief
        if belief is not None:
            self._watcher.puck(stamp, float(pose[0]), float(belief.mean[3]))
        hit = any(event.kind == "hit" for event in self.filter.events[hits:])
        if hit and pose[0] < 0 and self._opponent is not None:
            shot = self.intention
            banked = shot.chance or 0.0 if shot is not None and shot.kind == "bank" else 0.0
            self._watcher.shot(self.filter.events[-1].time, self._opponent[1], banked)

    def _see_opponent(self, stamp: float, pose: Float[np.ndarray, " 3"]) -> None:
        """Update the opponent's position, and its velocity, smoothed over a few frames."""
        place, velocity = pose[:2], np.zeros(2)
        if self._opponent is not None:
            last, state = self._opponent
            if stamp <= last:
                return
            if stamp - last < _HIDDEN:
                velocity = state[2:] + _SMOOTHING * (
                    (place - state[:2]) / (stamp - last) - state[2:]
                )
        self._opponent = stamp, np.concatenate([place, velocity])
        if self.filter.belief is not None:
            x, y = self.filter.belief.mean[:2].tolist()
            self._watcher.seen(stamp, self._opponent[1], (x, y))

    def _decide(self, time: float) -> None:
        """Ask the tactic, and convert its intention to the world's frame."""
        if self._craft is None:
            return
        intention = self.tactic.decide(self._view(time, *self._craft))
        if not isinstance(intention, Intention):
            raise InputError(
                f"decide() must return an Intention, not {type(intention).__name__}",
                field=f"tactic {type(self.tactic).__name__}",
            )
        self.intention = self._in_world(self._with_noise(intention))
        self.reference = self._controller.reference = self.intention.reference
        avoid = KeepOut(*(self.intention.avoid or _NOWHERE))
        self._controller.limits = self._fence, avoid

    def _view(self, time: float, stamp: float, craft: Float[np.ndarray, " 6"]) -> View:
        """Return the tactic's view of the game."""
        own = self.frame.states(craft)
        # The estimate is for when the last command acted, which is recent enough.
        own[:3] += own[3:] * (time - stamp)
        opponent = self._opponent and self._opponent[1]
        puck = self.filter.belief if self.sight == "seen" else None
        learned = self.filter.model.equipment
        if learned is not self.pitch.equipment:
            self.pitch = replace(self.pitch, equipment=learned)
        return View(
            time,
            own,
            puck,
            self.filter.model,
            opponent,
            self.pitch,
            self._times,
            self._watcher.rival if self._learns else Rival(),
        )

    def _with_noise(self, intention: Intention) -> Intention:
        """Turn the contact of a shot about the puck, by the same angle until the shot is over."""
        shoots = intention.kind in ("strike", "bank", "clear")
        if not shoots or not self.level.shot_noise_rad:
            self._noise = math.nan
            return intention
        if math.isnan(self._noise):
            self._noise = float(self._random.normal(0.0, self.level.shot_noise_rad))
        reference, meet = intention.reference, intention.meet
        if meet is None or not isinstance(reference, Rendezvous):
            return intention
        cos, sin = math.cos(self._noise), math.sin(self._noise)
        turn = np.array([[cos, -sin], [sin, cos]])
        state = reference.state.copy()
        state[:2] = self.pitch.clipped(np.array(meet[1:]) + turn @ (state[:2] - meet[1:]))
        state[3:5] = turn @ state[3:5]
        turned = Rendezvous(
            reference.time, state, precision=reference.precision, then=reference.then
        )
        return replace(intention, reference=turned)

    def _in_world(self, intention: Intention) -> Intention:
        """Return an intention in the world's frame."""
        # A user's tactic may return lists or arrays for all of these.
        frame, (meet, path, avoid) = self.frame, (intention.meet, intention.path, intention.avoid)
        return replace(
            intention,
            reference=frame.reference(intention.reference),
            meet=None if meet is None else (meet[0], *frame.point(*map(float, meet[1:]))),
            path=None if path is None else frame.points(np.asarray(path, float)),
            avoid=None if avoid is None else (*frame.point(*map(float, avoid[:2])), avoid[2]),
        )


def pitch_of(
    model: Model,
    equipment: AirHockey,
    times: MinimalTimes | None = None,
    opponent_radius: float | None = None,
) -> Pitch:
    """Return the constants of a game."""
    times = times or minimal_times_of(model)
    # There and back at full thrust: d = a T² / 4.
    acceleration = 4 * _SHORT / float(times((_SHORT, 0.0), (0.0, 0.0))) ** 2
    vehicle = model.vehicle
    x, y = equipment.table.reach(vehicle.radius_m + _MARGIN)
    # A craft that is too large for the table stays in the centre of its half.
    front = -vehicle.radius_m - _MARGIN
    fence = np.array([[min(-x, front - _NO_ROOM), -max(y, _NO_ROOM)], [front, max(y, _NO_ROOM)]])
    home = -equipment.table.length_m / 2 + vehicle.radius_m + _HOME
    return Pitch(
        equipment=equipment,
        craft_radius=vehicle.radius_m,
        craft_mass=vehicle.mass_kg,
        craft_inertia=float(model.parameters.inertia),
        opponent_radius=equipment.mallet.radius_m if opponent_radius is None else opponent_radius,
        fence=fence,
        home=(min(home, front - _NO_ROOM / 2), 0.0),
        delay=model.transport_delay,
        acceleration=acceleration,
    )


def _queue(
    poses: deque[tuple[float, Float[np.ndarray, " 3"]]], time: float, pose: Float[np.ndarray, " 3"]
) -> None:
    """Store a pose until it becomes visible."""
    pose = np.array(pose, dtype=float)
    if pose.shape == (3,) and all(map(math.isfinite, (time, *pose.tolist()))):
        poses.append((time, pose))
