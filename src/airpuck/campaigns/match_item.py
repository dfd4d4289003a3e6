"""A game of air hockey as an item of a campaign."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, ClassVar

import pydantic

from airpuck.campaigns.items import Item, Row, TwinTable
from airpuck.compute.process import low_latency
from airpuck.hockey.contestant import contestant
from airpuck.hockey.game import Game
from airpuck.hockey.rules import Rules
from airpuck.model.model_file import read_model
from airpuck.recording.bag_writer import write_bag
from airpuck.twin.settings import default_twin_settings


class Match(Item):
    """One game of air hockey between two players."""

    SOURCES: ClassVar = ("left", "right", "model")

    #: Who plays; see `airpuck.hockey.contestant.contestant`.
    left: str = "airpuck"
    right: str = "human"
    #: What a craft is.
    model: str = "paper:M3"
    rules: Rules = pydantic.Field(default_factory=Rules)
    twin: TwinTable = pydantic.Field(default_factory=default_twin_settings)
    #: Folder to write the game to; no part of what is computed.
    bag: Annotated[str | None, pydantic.Field(exclude=True)] = None

    def is_kept(self) -> bool:
        """Tell whether the bag is there; see `Item.is_kept`."""
        return self.bag is None or Path(self.bag).exists()

    def run(self) -> list[Row]:
        """Play; see `Item.run`."""
        low_latency()
        game = Game(
            contestant(self.left),
            contestant(self.right),
            settings=self.twin,
            rules=self.rules,
            model=read_model(self.model),
            seed=self.seed,
        )
        game.play()
        # The same game gives the same bag.
        if self.bag is not None and not self.is_kept():
            write_bag(game.recording(), self.bag)
        return [game.figures()]
