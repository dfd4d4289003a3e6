"""A game of air hockey as an item of a campaign."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, ClassVar

import numpy as np
import pydantic

from airpuck import TwinSettings, read_model, write_bag
from airpuck.extend import (
    Item,
    Row,
    default_twin_settings,
    low_latency,
    of_code,
    of_file,
    of_recording,
)
from airpuck_hockey.game.contestant import PLAYERS, contestant
from airpuck_hockey.game.game import Game
from airpuck_hockey.game.rules import Rules
from airpuck_hockey.puck.prediction import drawn_puck

#: Identifies the table's stream of random numbers; see `airpuck_hockey.game.game`.
_DRAWN = 21


class Match(Item):
    """One game of air hockey between two players."""

    SOURCES: ClassVar = {"left": of_code, "right": of_code, "model": of_file}
    PACKAGED: ClassVar = ("paper", *PLAYERS)

    #: Players; see `airpuck_hockey.game.contestant.contestant`.
    left: str = "airpuck"
    right: str = "human"
    #: Model of the craft.
    model: str = "paper:M3"
    #: Rules of the game.
    rules: Rules = pydantic.Field(default_factory=Rules)
    #: Settings of the twin, which override the paper's.
    twin: TwinSettings = pydantic.Field(default_factory=default_twin_settings)
    #: Whether drag and bounces of the puck are drawn for each game, within their uncertainty. No
    #: player gets the true numbers.
    drawn: bool = False
    #: Folder to write the game to; does not affect the result.
    bag: Annotated[str | None, pydantic.Field(exclude=True)] = None

    #: See `Item.reporting`.
    _tell: Callable[[float], None] | None = None

    def reporting(self, tell: Callable[[float], None]) -> Match:
        """Return a game that reports its progress; see `Item.reporting`."""
        game = self.model_copy()
        game._tell = tell
        return game

    def written(self) -> str | None:
        """Hash the bag; see `Item.written`."""
        if self.bag is None:
            return None
        return of_recording(self.bag) if Path(self.bag).exists() else ""

    def run(self) -> list[Row]:
        """Play; see `Item.run`."""
        low_latency()
        settings = self.twin
        if self.drawn:
            random = np.random.default_rng([self.seed, _DRAWN])
            puck = drawn_puck(settings.puck, random)
            settings = settings.model_copy(update={"puck": puck})
        game = Game(
            contestant(self.left),
            contestant(self.right),
            settings=settings,
            believed=self.twin,
            rules=self.rules,
            model=read_model(self.model),
            seed=self.seed,
        )
        game.play(*([self._tell] if self._tell else []))
        if self.bag is not None:
            # Removes the bag of an interrupted run, or a damaged one.
            shutil.rmtree(self.bag, ignore_errors=True)
            write_bag(game.recording(), self.bag)
        return [game.figures()]
