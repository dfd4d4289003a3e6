"""A game of air hockey on the twin's table: two sides, a puck, the rules."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator
from typing import Literal, NamedTuple, get_args

import numpy as np

from airpuck import (
    AirHockey,
    InputError,
    Model,
    Pilot,
    PuckState,
    Recording,
    Twin,
    TwinSettings,
    read_model,
)
from airpuck.extend import (
    COLUMNS,
    Action,
    Craft,
    HandMallet,
    MeasurementKind,
    SensorSet,
    World,
    check_seed,
    checked_class,
    control,
    default_twin_settings,
    log_stream,
    numbers,
    pose_sensor,
)
from airpuck_hockey.game.contestant import Contestant
from airpuck_hockey.game.hand import Hand
from airpuck_hockey.game.rules import Referee, Rules
from airpuck_hockey.player.tactic import Frame
from airpuck_hockey.puck.prediction import goal_within

#: Random stream of the game, and streams of the cameras of a game without craft; see
#: `airpuck.twin.sensors.pose_sensor`.
_STREAM = 20
_CAMERA_STREAMS: dict[MeasurementKind, int] = {"pose": 1, "puck": 4, "mallet": 5}
#: Time between commands [s].
PERIOD = 0.01
#: Initial distance of discs from their own goal line; distance of a served puck from the centre
#: line [m].
_BEGIN, _SERVE = 0.25, 0.30
#: Largest distance of a served puck from the table's long axis [m].
_ASIDE = 0.15
#: Prediction horizon for deciding whether a touched puck would have scored [s].
_FOLLOWED = 3.0
#: Contacts of a craft with a rail are distinct if they are further apart [s] or faster [m/s].
_AGAIN, _SLIDES = 0.1, 0.05
#: Time between reports of progress [s].
_TOLD = 1.0
#: A disc that touches the puck again within this time is still in the same contact [s].
_SAME = 0.2
#: A puck slower than this does not threaten the goal, a disc slower than this does not push [m/s].
_THREATENS, _PUSHES = 0.3, 0.05


#: ``hit``: a side's disc touched the puck, with an impulse [N s]; ``rail``, ``post``: the puck hit
#: one in the side's half; ``goal``: the side scored; ``own_goal``: the side's own touch led to the
#: goal; ``foul``, ``stuck``, ``serve``, ``over``: as `Ruling`; ``contact``: the side's craft hit a
#: rail, at a speed [m/s]; ``crossed``: the centre of the side's disc left its half.
EventKind = Literal[
    "serve",
    "goal",
    "own_goal",
    "foul",
    "stuck",
    "over",
    "hit",
    "rail",
    "post",
    "contact",
    "crossed",
]
#: Causes of an own goal, at the beginning of the contact: the puck was moving towards the goal; the
#: disc was; neither was, so the puck came back off a rail. The event's value is an index.
SLIPS = ("deflections", "pushes", "rebounds")
#: A recording stores an event as its index in this list.
KINDS: tuple[EventKind, ...] = get_args(EventKind)


class GameEvent(NamedTuple):
    """An event in a game."""

    #: Time [s].
    time: float
    kind: EventKind
    #: Sign of the side: -1 left, 1 right, 0 neither.
    side: int
    #: Impulse or speed.
    value: float = 0.0


class Side:
    """A side of a game: its disc, and the contestant that moves it.

    Attributes
    ----------
    sign : int
        Sign of the x of its half: -1 is left.
    kind : str
        ``craft`` or ``hand``.
    player : Pilot or None
        Pilot of a craft.
    hand : Hand or None
        Hand that moves a mallet.
    action : Action or None
        The latest intention of a craft's player.
    """

    def __init__(self, sign: int, name: str, body: Craft | HandMallet) -> None:
        self.sign, self.name, self.frame = sign, name, Frame(sign)
        self.kind: Literal["craft", "hand"] = "craft" if isinstance(body, Craft) else "hand"
        self.body = body
        self.player: Pilot | None = None
        self.hand: Hand | None = None
        self.twin: Twin | None = None
        self.action: Action | None = None
        self.radius = body.radius
        self._actions: Iterator[Action] = iter(())
        self.met = -math.inf
        self.beyond = False

    def fly(self, player: Pilot, twin: Twin) -> None:
        """Let a player steer the craft."""
        self.player, self.twin = player, twin
        self._actions = control(player, twin, math.inf, PERIOD)

    @property
    def state(self) -> tuple[float, float, float, float, float]:
        """x, y [m], yaw [rad], vx, vy [m/s] of its disc."""
        body = self.body
        if isinstance(body, HandMallet):
            return body.x, body.y, 0.0, body.vx, body.vy
        x, y, yaw, vx, vy = body.state[:5].tolist()
        return x, y, yaw, vx, vy

    def act(self, time: float, puck: PuckState | None, opponent: tuple[float, float]) -> None:
        """Observe, and send a command or move the mallet."""
        if self.hand is None:
            self.action = next(self._actions)
            return
        assert isinstance(self.body, HandMallet)
        own = self.frame.point(self.body.x, self.body.y)
        x, y = self.hand.target(time, own, self.frame.puck(puck), self.frame.point(*opponent))
        if not (math.isfinite(x) and math.isfinite(y)):
            raise InputError("target() must return two finite numbers", field=f"hand {self.name}")
        self.body.target = self.frame.point(x, y)


@checked_class
class Game:
    """A game between two contestants, stepped one control period at a time.

    Parameters
    ----------
    left, right : Contestant
        The two sides; see `contestant`.
    settings : TwinSettings, optional
        Table, puck, radio, noise; by default the paper's.
    rules : Rules, optional
        By default first to seven.
    model : Model, optional
        The craft; by default the published M3.
    seed : int, default 0
        Seed of all random numbers: the same seed gives the same game.
    logs : bool, default True
        Whether to keep everything for `recording`.
    believed : AirHockey, optional
        Table and puck that both contestants assume; by default the true ones.

    Attributes
    ----------
    time : float
        Now [s].
    sides : tuple of Side
        Left and right.
    referee : Referee
        Score and phase.
    events : list of GameEvent
        All events, if they are kept.

    Raises
    ------
    InputError
        If a contestant cannot play.

    Examples
    --------
    >>> rules = airpuck_hockey.Rules(limit_s=0.1)
    >>> players = airpuck_hockey.contestant("airpuck"), airpuck_hockey.contestant("human")
    >>> game = airpuck_hockey.Game(*players, rules=rules)
    >>> game.play()
    >>> game.score
    (0, 0)
    """

    SHOWN = "time_s=time phase score"

    def __init__(
        self,
        left: Contestant,
        right: Contestant,
        *,
        settings: TwinSettings | None = None,
        rules: Rules | None = None,
        model: Model | None = None,
        seed: int = 0,
        logs: bool = True,
        believed: AirHockey | None = None,
    ) -> None:
        check_seed(seed, limits=numbers.GAME_SEED)
        settings = settings or default_twin_settings()
        self._believed = believed or settings
        model = model or read_model("paper:M3")
        self.settings, self.seed, self._logs = settings, seed, logs
        self.time, self._steps = 0.0, 0
        self._random = np.random.default_rng([seed, _STREAM])
        self.referee = Referee(rules or Rules(), settings, int(self._random.choice([-1, 1])))
        self.events: list[GameEvent] = []
        self.world = World(settings, PuckState(0.0, 0.0))
        assert self.world.puck is not None
        self._puck = self.world.puck
        radii = [
            model.vehicle.radius_m if c.player is not None else settings.mallet.radius_m
            for c in (left, right)
        ]
        self.sides = (self._side(-1, left, model, radii[1]), self._side(1, right, model, radii[0]))
        self._cameras: SensorSet | None = None
        if all(side.twin is None for side in self.sides):
            kinds: dict[MeasurementKind, int] = _CAMERA_STREAMS
            sensors = [
                pose_sensor(settings.motion_capture, seed, logs, kind=kind, number=number)
                for kind, number in kinds.items()
            ]
            self._cameras = SensorSet(sensors, self._pose)
            self.world.observers.append(self._cameras)
        #: The side that last touched the puck, and whether the puck was going into that side's goal
        #: anyway.
        self._touched: tuple[int, bool] = (0, False)
        #: The kind of own goal that the last touch leads to, and when it was [s].
        self._slip, self._last_touch = SLIPS[0], -math.inf
        self._serve(self.referee.server)
        if logs:  # with an event, the recording of the shortest game has its score
            self.events.append(GameEvent(0.0, "serve", self.referee.server))

    @property
    def score(self) -> tuple[int, int]:
        """Goals of left and right."""
        return self.referee.score

    @property
    def phase(self) -> str:
        """``play``, ``goal`` (waiting for the serve) or ``over``."""
        return self.referee.phase

    @property
    def puck(self) -> PuckState | None:
        """State of the puck; None while it is in a goal."""
        return None if self._puck.goal else self._puck.state

    def step(self) -> list[GameEvent]:
        """Advance by a control period; return the events.

        Returns
        -------
        list of GameEvent
            Events in order.
        """
        left, right = self.sides
        puck, places = self.puck, (left.state[:2], right.state[:2])
        left.act(self.time, puck, places[1])
        right.act(self.time, puck, places[0])
        self._steps += 1
        self.time = self._steps * PERIOD
        self.world.run(self.time)
        events = [*self._contacts(), *self._judged()]
        if self._logs:
            self.events += events
        return events

    def play(self, progress: Callable[[float], None] = lambda share: None) -> None:
        """Play until the game is over.

        Parameters
        ----------
        progress : callable, optional
            Called every second of the game with a lower bound on the fraction completed.
        """
        rules, told = self.referee.rules, 0.0
        while self.phase != "over":
            self.step()
            if self.time >= told + _TOLD:
                told = self.time
                goals, limit = rules.goals or math.inf, rules.limit_s or math.inf
                progress(max(self.time / limit, max(self.score) / goals))

    def recording(self) -> Recording:
        """Return the flight as a recorder on the network would log it.

        Returns
        -------
        Recording
            As in `Twin.recording`, for the left craft, or for the right one if the left side is a
            hand; ``mallet`` is the other's disc. Also ``opponent_command`` if the opponent is a
            craft, and ``game``. Between two hands, ``pose`` is the left one's mallet.
        """
        flown = [side.twin.recording() for side in self.sides if side.twin is not None]
        if flown:
            streams = dict(flown[0].streams)
        else:
            assert self._cameras is not None
            streams = self._cameras.streams()
        if len(flown) > 1:
            streams["opponent_command"] = flown[1]["command"]
        rows, score = [], [0, 0]
        for event in self.events:
            score[event.side > 0] += event.kind == "goal"
            values = [*score, KINDS.index(event.kind), event.side, event.value]
            rows.append((event.time, np.array(values, dtype=float)))
        if rows:  # without logs there are none
            streams["game"] = log_stream(rows, COLUMNS["game"], latency=0.0)
        left, right = (side.name for side in self.sides)
        source, about = f"game of {left} against {right}", {"left": left, "right": right}
        return Recording(streams=streams, source=source, about=about)

    def figures(self) -> dict[str, float]:
        """Return the figures of the game, from the events that it kept.

        Returns
        -------
        dict
            Goals, own goals, fouls, contacts with a rail, the hardest contact, and crossings of the
            centre line, by side; duration, and how often the puck was stuck.
        """
        found: dict[str, float] = {}
        for side, goals in zip(self.sides, self.score, strict=True):
            name = "left" if side.sign < 0 else "right"
            mine = [event for event in self.events if event.side == side.sign]
            count = Counter(event.kind for event in mine)
            own = Counter(event.value for event in mine if event.kind == "own_goal")
            hardest = max((e.value for e in mine if e.kind == "contact"), default=0.0)
            found |= {
                f"{name}_goals": goals,
                f"{name}_own_goals": count["own_goal"],
                **{f"{name}_own_{slip}": own[number] for number, slip in enumerate(SLIPS)},
                f"{name}_fouls": count["foul"],
                f"{name}_hits": count["hit"],
                f"{name}_rail_contacts": count["contact"],
                f"{name}_hardest_rail_contact_m_s": hardest,
                f"{name}_crossings": count["crossed"],
            }
        stuck = sum(event.kind == "stuck" for event in self.events)
        return {**found, "stuck": stuck, "duration_s": self.time}

    def _side(self, sign: int, contestant: Contestant, model: Model, opponent: float) -> Side:
        """Put a disc on the table, and let the contestant move it."""
        settings = self.settings.without_on_board()
        x = sign * (settings.table.length_m / 2 - _BEGIN)
        seed = 2 * self.seed + (sign > 0)
        if contestant.hand is not None:
            mallet = HandMallet(settings.mallet, settings.table, x, 0.0)
            self.world.bodies.append(mallet)
            side = Side(sign, contestant.name, mallet)
            side.hand = contestant.hand(self._believed, seed)
            return side
        pose = (x, 0.0, 0.0 if sign < 0 else math.pi)
        assert contestant.player is not None
        twin = Twin(model, settings, seed=seed, pose=pose, logs=self._logs, world=self.world)
        side = Side(sign, contestant.name, twin.craft)
        side.fly(contestant.player(model, self._believed, sign, seed, opponent), twin)
        return side

    def _pose(self, kind: MeasurementKind) -> np.ndarray:
        """Return a true pose: of the left disc, the right one, the puck."""
        if kind == "puck":
            return self.world.puck_pose()
        return self.sides[kind == "mallet"].body.pose()

    def _contacts(self) -> Iterator[GameEvent]:
        """Yield contacts of the puck and the craft in the last period."""
        for time, met, impulse, before, disc in self._puck.touches:
            if disc is not None:
                side, (last, anyway) = self.sides[disc].sign, self._touched
                if last != side or time > self._last_touch + _SAME:
                    self._slip = _slip(side * before.vx, side * self.sides[disc].state[3])
                # A second touch by a side that stopped a shot counts separately.
                if last != side or (anyway and time > self._last_touch + _SAME):
                    self._touched = side, goal_within(self.settings, before, _FOLLOWED) == side
                self._last_touch = time
                yield GameEvent(time, "hit", side, impulse)
            elif met in ("rail", "post"):
                yield GameEvent(time, met, 1 if before.x > 0 else -1, impulse)
        self._puck.touches.clear()
        for side in self.sides:
            if isinstance(side.body, Craft):
                for time, speed in side.body.contacts:
                    if time > side.met + _AGAIN or speed > _SLIDES:
                        yield GameEvent(time, "contact", side.sign, speed)
                    side.met = time
                side.body.contacts.clear()
            beyond = side.state[0] * side.sign < 0
            if beyond and not side.beyond:
                yield GameEvent(self.time, "crossed", side.sign)
            side.beyond = beyond

    def _judged(self) -> Iterator[GameEvent]:
        """Yield the referee's rulings, and apply them."""
        state = self._puck.state
        speed = math.hypot(state.vx, state.vy)
        for kind, side in self.referee.judge(self.time, state.x, speed, self._puck.goal):
            yield GameEvent(self.time, kind, side)
            if kind == "goal" and self._touched == (-side, False):
                yield GameEvent(self.time, "own_goal", -side, SLIPS.index(self._slip))
            if kind == "serve":
                self._serve(side)

    def _serve(self, side: int) -> None:
        """Put the puck into a half, away from all discs."""
        serve(self.world, side, self._random)
        self._touched = (0, False)


def _slip(puck: float, disc: float) -> str:
    """Return the cause of an own goal, by the speeds of puck and disc towards the goal."""
    if puck > _THREATENS:
        return SLIPS[0]
    return SLIPS[1 if disc > _PUSHES else 2]


def serve(world: World, side: int, random: np.random.Generator) -> None:
    """Put the puck into a half of a world, at rest, away from all discs."""
    assert world.puck is not None
    x, y, radius = side * _SERVE, float(random.uniform(-_ASIDE, _ASIDE)), world.puck.radius
    for disc in (body.disc() for body in world.bodies):
        if math.dist((disc.x, disc.y), (x, y)) < disc.radius + radius:
            y = math.copysign(disc.radius + 2 * radius, -disc.y) + disc.y
    world.puck.place(PuckState(x, y))
