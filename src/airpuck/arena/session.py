"""A game in real time, for the page: whose turn it is to do what, and what the page hears of it."""

from __future__ import annotations

import gc
import json
import math
import multiprocessing
import webbrowser
from collections.abc import Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Any

from airpuck.arena.address import listen
from airpuck.arena.messages import Wish, packed_state, read_message
from airpuck.arena.server import NEWS, STATE, THOUGHT, WISH, serve
from airpuck.boundary import numbers
from airpuck.boundary.errors import InputError
from airpuck.compute.process import prioritize
from airpuck.control.reference import SetPoint
from airpuck.hockey.contestant import Contestant
from airpuck.hockey.game import PERIOD, Game, GameEvent
from airpuck.hockey.level import LEVELS
from airpuck.hockey.player import Player
from airpuck.hockey.rules import Rules
from airpuck.hockey.tactic import Intention, Tactic, View
from airpuck.live.clock import Clock, Histogram
from airpuck.model.model_file import Model
from airpuck.physics.puck import PuckState
from airpuck.report.table_canvas import COLORS, craft_shape, hockey_shape
from airpuck.twin.settings import TwinSettings, default_twin_settings

#: Nobody is hurried at the page [s].
_NO_LIMIT = 1e6
#: Steps before a game, for what is slow the first time.
_WARM_UP = 20
#: Steps from one thought that is shown to the next.
_THOUGHTS_EVERY = 3
#: For so long the craft goes home when the player has left; then time stands still [steps].
_HOMEWARD = 300
#: Where the puck lies meanwhile: the player begins [m].
_LAID = 0.3
#: At least so long others may run in each period [s].
_BREATH = 5e-4
#: If time is this late, the machine slept: the game goes on from now [s].
_SLEPT = 0.25


@dataclass(frozen=True)
class ArenaSettings:
    """Where a game is served, and for how long.

    Parameters
    ----------
    port : int, default 8088
        Port of the page.
    interface : str, optional
        Network interface; by default loopback, so that only this machine can play.
    browser : bool, default True
        Whether to open the page.
    duration : float, optional
        How long to go on [s]; by default until SIGINT or SIGTERM.

    Raises
    ------
    InputError
        If a number is out of range.
    """

    port: int = 8088
    interface: str | None = None
    browser: bool = True
    duration: float | None = None

    def __post_init__(self) -> None:
        numbers.PORT.check(self.port, "--port")
        if self.duration is not None:
            numbers.LIVE_DURATION.check(self.duration, "--duration")


def play_in_browser(
    model: Model,
    arena: ArenaSettings | None = None,
    *,
    level: str = "medium",
    settings: TwinSettings | None = None,
    seed: int = 0,
    tell: Any = print,
) -> dict[str, Any]:
    """Let a person play against the craft, in a page that this serves.

    Parameters
    ----------
    model : Model
        The craft, as it is and as its player believes it to be.
    arena : ArenaSettings, optional
        Where, and for how long.
    level : str, default "medium"
        How well the craft plays; the page can change it.
    settings : TwinSettings, optional
        Table, puck, radio, noise; by default the packaged ones.
    seed : int, default 0
        Of everything random.
    tell : callable, default print
        Takes the line that says where the page is.

    Returns
    -------
    dict
        Figures for ``--json``.

    Raises
    ------
    InputError
        If websockets is not installed, there is no such level, or the address is not free.
    """
    from importlib.util import find_spec

    if find_spec("websockets") is None:
        raise InputError("the page needs websockets: pip install 'airpuck[play]'")
    if level not in LEVELS:
        raise InputError(f"give {', '.join(LEVELS)}, not {level!r}", field="--level")
    arena = arena or ArenaSettings()
    settings = settings or default_twin_settings()
    with listen(arena.interface, arena.port) as listening:
        host, port = listening.getsockname()[:2]
        context = multiprocessing.get_context("spawn")
        pipe, far = context.Pipe()
        hello = hello_of(model, settings)
        server = context.Process(target=serve, args=(far, listening, host, hello), daemon=True)
        server.start()
        far.close()
    try:
        session = Session(pipe, model, settings, level, seed)
        url = f"http://{host}:{port}"
        tell(f"Play at {url} (Ctrl-C ends)")
        if arena.browser:
            webbrowser.open(url)
        return session.run(arena.duration)
    finally:
        pipe.close()
        server.join(2)
        server.kill()


def hello_of(model: Model, settings: TwinSettings) -> dict[str, Any]:
    """Return what a page must know before it can show anything."""
    table, mallet = settings.table, settings.mallet
    x, y = table.length_m / 2, table.width_m / 2
    rules = Rules()
    return {
        "table": [table.length_m, table.width_m],
        "view": [-x, x, -y, y],
        "craft": craft_shape(model.vehicle),
        "colors": COLORS,
        "hockey": hockey_shape(settings),
        "mallet": {"speed": mallet.speed_m_s, "acceleration": mallet.acceleration_m_s2},
        "period": PERIOD,
        "names": ["airpuck", "you"],
        "levels": list(LEVELS),
        "first_to": rules.goals,
        "foul_s": rules.foul_s,
    }


class PageHand:
    """The person at the page; a `Hand`."""

    def __init__(self) -> None:
        #: Where the mallet is wanted, in the world's frame [m]; None: where it is.
        self.wanted: tuple[float, float] | None = None

    def target(
        self, time: float, own: tuple[float, float], puck: Any, opponent: tuple[float, float]
    ) -> tuple[float, float]:
        """Return where the mallet is wanted, in its own frame, which is turned by π."""
        return own if self.wanted is None else (-self.wanted[0], -self.wanted[1])


class GoHome:
    """Nobody plays against it: the craft goes home and waits; a `Tactic`."""

    def decide(self, view: View) -> Intention:
        """Return what to do now; see `Tactic`."""
        return Intention("home", SetPoint(*view.pitch.home, 0.0))


class Session:
    """Games one after the other, in real time."""

    def __init__(
        self, pipe: Connection, model: Model, settings: TwinSettings, level: str, seed: int
    ) -> None:
        self._pipe, self._model, self._settings = pipe, model, settings
        self._level, self._seed, self._games = level, seed, 0
        self._seated = self._runs = self._thinks = False
        self._heard = 0
        self._status: dict[str, Any] = {}
        self._until_home = 0
        self._clock = Clock()
        #: How far the physics is behind real time, and how long a step takes [s].
        self._behind, self._took = Histogram(), Histogram()
        self._begin()

    def run(self, duration: float | None = None) -> dict[str, Any]:
        """Play until the time is over; return the figures for ``--json``."""
        try:
            self._run(math.inf if duration is None else duration)
        except KeyboardInterrupt:
            pass  # that is how a person ends it
        except (EOFError, OSError) as error:
            raise RuntimeError("the server of the page has ended") from error
        return {
            "duration_s": self._clock.now,
            "games": self._games,
            "score": list(self._game.score),
            "periods": self._took.count,
            "step_ms": self._took.to_json(),
            "behind_real_time_ms": self._behind.to_json(),
        }

    def _run(self, duration: float) -> None:
        """Play until the time is over."""
        clock, steps = self._clock, 0
        prioritize(first=True)
        gc.collect()
        gc.freeze()
        clock.restart()
        due = 0.0
        while clock.now < duration:
            begun = self._games
            self._hear()
            if self._games != begun:
                due = clock.now  # beginning a game takes a while
            events: Sequence[GameEvent] = ()
            if self._moves:
                began = clock.now
                events = self._game.step()
                steps += 1
                self._took.add(clock.now - began)
            self._tell(events, steps)
            due += PERIOD
            late = clock.now - due
            if self._moves:
                self._behind.add(max(late, 0.0))
            if late > _SLEPT:
                due = clock.now
            # The server of the page, and a browser, must get on even if this one is late.
            clock.sleep_until(max(due, clock.now + _BREATH))

    @property
    def phase(self) -> str:
        """``waiting`` (nobody is there), ``ready``, ``play``, ``paused`` or ``over``."""
        if not self._seated:
            return "waiting"
        if self._game.phase == "over":
            return "over"
        if self._runs:
            return "play"
        return "paused" if self._begun else "ready"

    @property
    def _moves(self) -> bool:
        """Whether time passes on the table."""
        return self.phase == "play" or self._until_home > 0

    def _begin(self) -> None:
        """Begin a new game; it waits for the player's word."""
        self._runs = self._begun = False
        self._hand = PageHand()
        self._games += 1
        self._game = Game(
            Contestant("airpuck", player=self._make_player),
            Contestant("you", hand=lambda *_: self._hand),
            settings=self._settings,
            rules=Rules(limit_s=_NO_LIMIT),
            model=self._model,
            seed=self._seed + self._games,
            logs=False,
        )
        for _ in range(_WARM_UP):
            self._game.step()

    def _make_player(self, model: Model, play: Any, side: int, seed: int, other: float) -> Player:
        """Make who steers the craft, and remember what it would play."""
        level = LEVELS[self._level]
        self._player = Player(model, play, level=level, side=side, seed=seed, opponent_radius=other)
        self._tactic: Tactic = self._player.tactic
        return self._player

    def _hear(self) -> None:
        """Take what the page has sent; of wishes only the last counts."""
        wish = None
        while self._pipe.poll():
            message = self._pipe.recv_bytes()
            if message[:1] == WISH:
                wish = read_message(message[1:])
            else:
                self._obey(json.loads(message[1:]))
        if isinstance(wish, Wish) and self._seated:
            self._heard = wish.number
            self._hand.wanted = wish.x, wish.y

    def _obey(self, order: dict[str, Any]) -> None:
        """Do what the page asks for."""
        match order["do"]:
            case "sit":
                self._seated, self._heard = True, 0
                self._until_home = 0
                self._player.tactic = self._tactic
            case "leave":
                self._leave()
            case "think":
                self._thinks = order["on"]
            case "pause":
                self._runs = False
            case "go":
                self._runs = self._begun = True
            case "restart":
                self._renew()
                self._runs = self._begun = True
            case "level" if order["level"] in LEVELS:
                self._level = order["level"]
                self._renew()

    def _renew(self) -> None:
        """Begin a new game, and tell the page that it takes a moment."""
        self._tell_status("starting")
        # The page and its server need not wait for the compiler.
        prioritize(first=False)
        self._begin()
        prioritize(first=True)

    def _leave(self) -> None:
        """Let the craft go home: the player has left, but may come back."""
        self._seated = self._runs = False
        if not self._begun or self._game.phase == "over":
            return
        self._player.tactic, self._until_home = GoHome(), _HOMEWARD
        self._hand.wanted = None
        puck = self._game.world.puck
        if self._game.phase == "play" and puck is not None:
            puck.place(PuckState(_LAID, 0.0))

    def _tell(self, events: Sequence[GameEvent], steps: int) -> None:
        """Tell the page what is new."""
        game = self._game
        self._until_home = max(self._until_home - 1, 0)
        craft, mallet = game.sides[0], game.sides[1].state
        puck, action = game.puck, craft.action
        commands = () if action is None else action.step.command.tolist()
        state = packed_state(
            game.world.time,
            self._heard,
            puck is None,
            (0.0, 0.0, 0.0) if puck is None else puck,
            (mallet[0], mallet[1], mallet[3], mallet[4]),
            craft.state,
            commands,
        )
        self._pipe.send_bytes(STATE + state)
        for event in events:
            self._report(event)
        self._tell_status(self.phase)
        if self._thinks and steps % _THOUGHTS_EVERY == 0 and self.phase == "play":
            self._pipe.send_bytes(
                THOUGHT + json.dumps(thought_of(self._player, game.time)).encode()
            )

    def _tell_status(self, phase: str) -> None:
        """Tell the page how the game stands, if that has changed."""
        score = list(self._game.score)
        status = {"is": "status", "phase": phase, "score": score, "level": self._level}
        if status != self._status:
            self._status = status
            self._say(status)

    def _report(self, event: GameEvent) -> None:
        """Tell the page of what can be heard or called out."""
        kind = event.kind
        if kind == "hit":
            kind = "craft" if event.side < 0 else "mallet"
        elif kind not in ("rail", "post", "goal", "foul"):
            return
        self._say({"is": "event", "kind": kind, "side": event.side, "strength": event.value})

    def _say(self, news: dict[str, Any]) -> None:
        self._pipe.send_bytes(NEWS + json.dumps(news).encode())


def thought_of(player: Player, time: float) -> dict[str, Any]:
    """Return what the craft expects and wants, for the page."""
    intention, predicted = player.intention, player.predicted
    thought: dict[str, Any] = {"is": "thought", "words": "", "meet": None, "path": None}
    thought["predicted"] = None if predicted is None else predicted.round(4).tolist()
    decision, control = (1e3 * took for took in player.took)
    said = [] if player.sight == "seen" else [f"the puck is {player.sight}"]
    if intention is not None:
        words = intention.kind
        if intention.chance is not None and math.isfinite(intention.chance):
            words += f" {100 * intention.chance:.0f} %"
        said.append(intention.kind)
        thought["words"] = words
        if intention.meet is not None:
            when, x, y = intention.meet
            thought["meet"] = [round(x, 4), round(y, 4)]
            said.append(f"in {max(when - time, 0.0):.2f} s")
        if intention.path is not None:
            thought["path"] = intention.path.round(4).tolist()
    said.append(f"decided in {decision:.1f} ms, controlled in {control:.1f} ms")
    thought["said"] = ", ".join(said)
    return thought
