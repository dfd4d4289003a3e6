"""A game on its page: its phases in real time, and the table, positions and intentions shown."""

from __future__ import annotations

import gc
import math
import time
from collections.abc import Sequence
from itertools import count
from pathlib import Path
from typing import Any

from airpuck import AirHockey, InputError, Model, PuckState, SetPoint, TwinSettings, write_bag
from airpuck.extend import (
    Clock,
    Histogram,
    PageKind,
    Pages,
    TokenBucket,
    default_twin_settings,
    invite,
    low_latency,
    packed_state,
    prioritize,
    served,
    table_of,
    until_stopped,
)
from airpuck_hockey.game.contestant import Contestant, craft_contestant, tactic_maker
from airpuck_hockey.game.game import PERIOD, Game, GameEvent
from airpuck_hockey.game.hand import GuidedHand
from airpuck_hockey.game.rules import Rules
from airpuck_hockey.player.all_rounder import AllRounder
from airpuck_hockey.player.player import LEVELS, Player
from airpuck_hockey.player.tactic import Intention, View
from airpuck_hockey.web.settings import ArenaSettings

#: The page of a game; the first page that connects plays.
GAME_PAGE = PageKind("airpuck_hockey", "play")
#: Plain words for what the craft intends; a user's tactic may have words of its own.
_INTENTIONS = {
    "strike": "straight shot",
    "bank": "shot off a rail",
    "defend": "block",
    "prepare": "catch",
    "free": "push into the open",
    "clear": "clearing hit",
    "wait": "waiting for the puck",
    "home": "back to its goal",
}


def hello_of(model: Model, equipment: AirHockey) -> dict[str, Any]:
    """Return the data that a page needs before it can show anything."""
    mallet, rules = equipment.mallet, Rules()
    return table_of(model, equipment.table, equipment) | {
        "mallet": {"speed": mallet.speed_m_s, "acceleration": mallet.acceleration_m_s2},
        "period": PERIOD,
        "names": ["airpuck", "you"],
        "sides": ["craft", "hand"],
        "levels": list(LEVELS),
        "first_to": rules.goals,
        "foul_s": rules.foul_s,
    }


def state_of(game: Game, heard: int = 0) -> bytes:
    """Return the message with all positions in a game; see `packed_state`."""
    left, right = game.sides
    commands: list[float] = []
    for side in game.sides:
        if side.action is not None:
            commands += side.action.step.command.tolist()
    x, y, yaw, vx, vy = right.state
    return packed_state(
        game.world.time,
        heard,
        game.puck is None,
        game.puck or (0.0, 0.0, 0.0),
        (x, y, vx, vy) if right.kind == "hand" else (x, y, yaw, 0.0),
        left.state,
        commands,
    )


def news_of(event: GameEvent) -> dict[str, Any] | None:
    """Return the message to a page about an audible or announced event, or None."""
    kind = event.kind
    if kind == "hit":
        kind = "craft" if event.side < 0 else "mallet"
    elif kind not in ("rail", "post", "goal", "foul"):
        return None
    return {"is": "event", "kind": kind, "side": event.side, "strength": event.value}


def thought_of(player: Player, time: float) -> dict[str, Any]:
    """Return the craft's expectations and intention, for the page."""
    intention, predicted = player.intention, player.predicted
    thought: dict[str, Any] = {"is": "thought", "words": "", "meet": None, "path": None}
    thought["predicted"] = None if predicted is None else predicted.round(4).tolist()
    decision, control = (1e3 * took for took in player.took)
    said = "" if player.sight == "seen" else f"The puck is {player.sight}. "
    if intention is not None:
        words = _INTENTIONS.get(intention.kind, intention.kind)
        said += words[:1].upper() + words[1:]
        if intention.chance is not None and math.isfinite(intention.chance):
            words += f": {100 * intention.chance:.0f} %"
        thought["words"] = words
        if intention.meet is not None:
            when, x, y = intention.meet
            thought["meet"] = [round(x, 4), round(y, 4)]
            said += f" in {max(when - time, 0.0):.2f} s"
        if intention.path is not None:
            thought["path"] = intention.path.round(4).tolist()
        said += ". "
    computed = f"Computing time: {decision:.1f} ms to decide, {control:.1f} ms to steer."
    thought["said"] = said + computed
    return thought


#: Polling period for the first page, and time for which the page shows the winner [s].
_LOOK, _END = 0.02, 3.0


def watch_in_browser(game: Game, model: Model, arena: ArenaSettings, tell: Any = print) -> None:
    """Play a game in real time, once the first page is connected; pages only show it.

    Parameters
    ----------
    game : Game
        The game; it is played to its end.
    model : Model
        The craft.
    arena : ArenaSettings
        Where to serve the page.
    tell : callable, default print
        Receives the line with the page's address.

    Raises
    ------
    InputError
        If websockets is not installed, or the address is not free.
    """
    names, kinds = ([getattr(side, what) for side in game.sides] for what in ("name", "kind"))
    hello = hello_of(model, game.settings)
    hello |= {"live": True, "levels": [], "names": names, "sides": kinds}
    with served(arena.host, arena.port, hello, page=GAME_PAGE) as pages:
        pages.say_status("watch", game.score, "")
        invite(pages, arena.browser, tell, "Watch")
        _show(game, pages)
        if pages.lost:
            tell("The page server has ended; the game was played to its end without a page.")


def _show(game: Game, pages: Pages) -> None:
    """Play a game to its end, and show it."""
    while not pages.hear()[0] and not pages.lost:  # the first page takes the seat
        time.sleep(_LOOK)
    thinker = next((s.player for s in game.sides if isinstance(s.player, Player)), None)
    clock, began = Clock(), game.time
    while game.phase != "over":
        events = game.step()
        pages.show(state_of(game))
        for event in events:
            news = news_of(event)
            if event.kind in ("stuck", "over"):
                news = {"is": "event", "kind": event.kind, "side": event.side}
            if news is not None:
                pages.say(news)
        pages.say_status("watch", game.score, "")
        pages.hear()
        if thinker is not None:
            pages.think(lambda: thought_of(thinker, game.time))
        if not pages.lost:
            clock.sleep_until(game.time - began)
    if not pages.lost:
        time.sleep(_END)


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
        low_latency()  # imports JAX, while the server starts
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
        self._seed, self._games, self._score = seed, 0, (0, 0)
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
            "score": list(self._score),
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
        name = self._name or f"airpuck:{self._level}"
        self._game = Game(
            craft_contestant(name, self._make_tactic, LEVELS[self._level]),
            Contestant("you", hand=lambda *_: self._hand),
            settings=self._settings,
            rules=Rules(limit_s=_NO_LIMIT),
            model=self._model,
            seed=self._seed + self._games,
            logs=self._record is not None,
        )
        player = self._game.sides[0].player
        assert isinstance(player, Player)
        self._player, self._tactic = player, player.tactic
        for _ in range(_WARM_UP):
            self._game.step()

    def _keep(self) -> None:
        """Remember the score of a game that has begun, and save it if games are recorded."""
        self._score = self._game.score if self._begun else self._score
        if self._record is not None and self._begun:
            paths = (self._record / f"game-{number}" for number in count(1))
            write_bag(self._game.recording(), next(path for path in paths if not path.exists()))

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
        self._pages.say_status("starting", self._game.score, self._level)
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
        self._pages.say_status(self.phase, game.score, self._level)
        if self.phase == "play":
            self._pages.think(lambda: thought_of(self._player, game.time))
