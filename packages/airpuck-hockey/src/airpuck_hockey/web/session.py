"""A game in real time for the page: its phases, and the messages to the page."""

from __future__ import annotations

import gc
import math
import time
from collections.abc import Sequence
from itertools import count
from pathlib import Path
from typing import Any

from airpuck import InputError, Model, PuckState, SetPoint, TwinSettings, write_bag
from airpuck.extend import (
    Clock,
    Histogram,
    Pages,
    TokenBucket,
    default_twin_settings,
    invite,
    prioritize,
    served,
    until_stopped,
)
from airpuck_hockey.game.contestant import Contestant, tactic_maker
from airpuck_hockey.game.game import PERIOD, Game, GameEvent
from airpuck_hockey.game.hand import GuidedHand
from airpuck_hockey.game.rules import Rules
from airpuck_hockey.player.all_rounder import AllRounder
from airpuck_hockey.player.level import LEVELS
from airpuck_hockey.player.player import Player
from airpuck_hockey.player.tactic import Intention, Tactic, View
from airpuck_hockey.web.page import GAME_PAGE, hello_of, news_of, state_of, thought_of
from airpuck_hockey.web.settings import ArenaSettings

#: Rate limit of new games [1/s], and its burst: starting one stops the physics for 0.2 s. Orders
#: that arrive meanwhile count as one.
_GAMES_RATE, _GAMES_BURST = 1.0, 3.0
#: Time limit of a game at the page: practically none [s].
_NO_LIMIT = 1e6
#: Number of warm-up steps before a game.
_WARM_UP = 20
#: Number of steps in which the craft flies home after the player has left; then the game pauses.
_HOMEWARD = 300
#: Time for which a player who has left can resume the game [s].
_KEPT = 60.0
#: Position of the puck meanwhile, from which the player begins [m].
_LAID = 0.3
#: Least time left to other processes in each period [s].
_BREATH = 5e-4
#: If the loop is this late, the machine was suspended, and the game resumes at the present time
#: [s].
_SLEPT = 0.25


def play_in_browser(
    model: Model,
    arena: ArenaSettings | None = None,
    *,
    level: str = "medium",
    tactic: str | None = None,
    settings: TwinSettings | None = None,
    seed: int = 0,
    record: Path | None = None,
    tell: Any = print,
) -> dict[str, Any]:
    """Let a person play against the craft, on a page served here.

    Parameters
    ----------
    model : Model
        The craft; its player uses the same model.
    arena : ArenaSettings, optional
        Where to serve, and for how long.
    level : str, default "medium"
        Level of the craft; the page can change it.
    tactic : str, optional
        The craft's tactic, FILE.py:NAME; by default the package's own.
    settings : TwinSettings, optional
        Table, puck, radio, noise; by default the paper's.
    seed : int, default 0
        Seed of all random numbers.
    record : path, optional
        Folder for the games, one bag each: ``game-1`` and so on. The page says that it is recorded.
    tell : callable, default print
        Receives the line with the page's address.

    Returns
    -------
    dict
        Results for ``--json``.

    Raises
    ------
    InputError
        If websockets is not installed, the level is unknown, or the address is not free.
    """
    if level not in LEVELS:
        raise InputError(f"must be {', '.join(LEVELS)}, not {level!r}", field="--level")
    arena = arena or ArenaSettings()
    settings = settings or default_twin_settings()
    hello = hello_of(model, settings) | {"recorded": record is not None}
    with served(arena.host, arena.port, hello, page=GAME_PAGE) as pages:
        session = Session(pages, model, settings, level, seed, tactic, record)
        invite(pages, arena.browser, tell)
        return session.run(arena.duration)


class GoHome:
    """Fly home and wait for a player; a `Tactic`."""

    def decide(self, view: View) -> Intention:
        """Return the intention; see `Tactic`."""
        return Intention("home", SetPoint(*view.pitch.home, 0.0))


class Session:
    """Games one after the other, in real time."""

    def __init__(
        self,
        pages: Pages,
        model: Model,
        settings: TwinSettings,
        level: str,
        seed: int,
        tactic: str | None = None,
        record: Path | None = None,
    ) -> None:
        self._make_tactic = AllRounder if tactic is None else tactic_maker(tactic)
        self._name = tactic
        self._pages, self._model, self._settings = pages, model, settings
        self._record = record
        self._level = self._first_level = level
        self._seed, self._games = seed, 0
        #: When a game without a player is given up [s, monotonic].
        self._given_up = math.inf
        self._seated = self._runs = self._begun = False
        self._heard = 0
        self._until_home = 0
        #: Whether a requested new game starts running; None: no game is requested.
        self._renewal: bool | None = None
        self._renewals = TokenBucket(_GAMES_RATE, _GAMES_BURST)
        self._clock = Clock()
        #: Delay of the physics behind real time, and duration of a step [s].
        self._behind, self._took = Histogram(), Histogram()
        self._begin()

    def run(self, duration: float | None = None) -> dict[str, Any]:
        """Play until the time is over; return the results for ``--json``."""
        try:
            with until_stopped():
                self._run(math.inf if duration is None else duration)
        finally:  # a tactic of the user's may fail
            self._keep()
        return {
            "duration_s": self._clock.now,
            "games": self._games,
            "score": list(self._game.score),
            "periods": self._took.count,
            "step_ms": self._took.to_json(),
            "behind_real_time_ms": self._behind.to_json(),
            "page_server_ended": self._pages.lost,
        }

    def _run(self, duration: float) -> None:
        """Play until the time is over."""
        clock = self._clock
        prioritize(first=True)
        gc.collect()
        gc.freeze()
        clock.restart()
        due = 0.0
        while clock.now < duration and not self._pages.lost:
            self._hear()
            self._give_up()
            if self._renewal is not None and self._renewals.take(time.monotonic()):
                self._renew(runs=self._renewal)
                due = clock.now  # starting a game takes about 0.2 s
            events: Sequence[GameEvent] = ()
            if self._moves:
                began = clock.now
                events = self._game.step()
                self._took.add(clock.now - began)
            self._tell(events)
            due += PERIOD
            behind = clock.now - due
            if self._moves:
                self._behind.add(max(behind, 0.0))
            if behind > _SLEPT:
                due = clock.now
            # The page server, and a browser, need time even if this process is late.
            clock.sleep_until(max(due, clock.now + _BREATH))

    @property
    def phase(self) -> str:
        """``starting``, ``waiting`` (for a player), ``ready``, ``play``, ``paused`` or ``over``."""
        if self._renewal is not None:
            return "starting"
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
        """Prepare a new game; it waits for the player to start it."""
        self._keep()
        self._runs = self._begun = False
        self._renewal = None
        self._hand = GuidedHand()
        self._games += 1
        self._game = Game(
            Contestant(self._name or f"airpuck:{self._level}", player=self._make_player),
            Contestant("you", hand=lambda *_: self._hand),
            settings=self._settings,
            rules=Rules(limit_s=_NO_LIMIT),
            model=self._model,
            seed=self._seed + self._games,
            logs=self._record is not None,
        )
        for _ in range(_WARM_UP):
            self._game.step()

    def _keep(self) -> None:
        """Save a game that has begun, if games are recorded."""
        if self._record is not None and self._begun:
            paths = (self._record / f"game-{number}" for number in count(1))
            write_bag(self._game.recording(), next(path for path in paths if not path.exists()))

    def _make_player(
        self, model: Model, equipment: Any, side: int, seed: int, other: float
    ) -> Player:
        """Make the pilot of the craft, and remember its tactic."""
        level = LEVELS[self._level]
        self._player = Player(
            model,
            equipment,
            self._make_tactic(),
            level=level,
            side=side,
            seed=seed,
            opponent_radius=other,
        )
        self._tactic: Tactic = self._player.tactic
        return self._player

    def _hear(self) -> None:
        """Process messages from the page; only the last of several targets counts."""
        orders, wish = self._pages.hear()
        for order in orders:
            self._obey(order)
        if wish is not None and self._seated:
            self._heard = wish.number
            self._hand.wanted = wish.x, wish.y

    def _obey(self, order: dict[str, Any]) -> None:
        """Carry out the page's request."""
        match order["do"]:
            case "sit":
                self._seated, self._heard = True, 0
                self._until_home, self._given_up = 0, math.inf
                self._player.tactic = self._tactic
            case "leave":
                self._leave()
            case "pause" | "go" as deed:
                self._runs = deed == "go"
                self._begun = self._begun or self._runs
                if self._renewal is not None:
                    self._renewal = self._runs
            case "restart":
                self._renewal = True
            case "level" if order["level"] in LEVELS:
                self._level, self._renewal = order["level"], False

    def _renew(self, *, runs: bool) -> None:
        """Start a new game; meanwhile the page shows that this takes a moment."""
        self._tell_status("starting")
        # The page and its server need not wait for the compiler.
        prioritize(first=False)
        self._begin()
        self._runs = self._begun = runs
        prioritize(first=True)

    def _leave(self) -> None:
        """Let the craft fly home: the player has left, but may come back."""
        self._seated = self._runs = False
        if self._renewal is not None:
            self._renewal = False
        if not self._begun or self._game.phase == "over":
            self._given_up = 0.0
            return
        self._given_up = time.monotonic() + _KEPT
        self._player.tactic, self._until_home = GoHome(), _HOMEWARD
        self._hand.wanted = None
        puck = self._game.world.puck
        if self._game.phase == "play" and puck is not None:
            puck.place(PuckState(_LAID, 0.0))

    def _give_up(self) -> None:
        """Prepare the next visitor's game, at the first level, if the player has left for good."""
        if time.monotonic() < self._given_up:
            return
        self._given_up = math.inf
        if self._begun or self._level != self._first_level:
            self._level, self._renewal = self._first_level, False

    def _tell(self, events: Sequence[GameEvent]) -> None:
        """Send the current state to the page."""
        game = self._game
        self._until_home = max(self._until_home - 1, 0)
        self._pages.show(state_of(game, self._heard))
        for news in map(news_of, events):
            if news is not None:
                self._pages.say(news)
        self._tell_status(self.phase)
        if self.phase == "play":
            self._pages.think(lambda: thought_of(self._player, game.time))

    def _tell_status(self, phase: str) -> None:
        """Send the status of the game to the page."""
        self._pages.say_status(phase, self._game.score, self._level)
