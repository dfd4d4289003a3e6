"""Tuning with fewer flights."""

import pytest


def fly_less(monkeypatch: pytest.MonkeyPatch, held_out: int = 1, halvings: int = 1) -> None:
    """Let `tune` fly two craft in each trial, and fewer flights afterwards."""
    for name, count in (("_TRIAL", 1), ("_HELD_OUT", held_out), ("_HALVINGS", halvings)):
        monkeypatch.setattr(f"airpuck.twin.tune.{name}", count)
