"""Descriptions of what must not be used of a trajectory."""

from __future__ import annotations

from collections import Counter
from typing import Any

from airpuck.data.trajectory import Trajectory

#: Causes that are described in words, singular and plural.
_NOUNS = {
    "gap": ("gap", "gaps"),
    "frozen pose": ("frozen pose", "frozen poses"),
    "jumping pose": ("jump", "jumps"),
    "no commands": ("pause of the commands", "pauses of the commands"),
    "contact": ("contact", "contacts"),
}


def left_out_words(trajectory: Trajectory) -> str:
    """Describe which fraction of the time must not be used, and why.

    Parameters
    ----------
    trajectory : Trajectory
        The trajectory, possibly with faults excluded, too.

    Returns
    -------
    str
        For example ``left out: 3.1 % (2 gaps, 14 jumps; longest 0.21 s at 31.2 s)``.
    """
    first, last = trajectory.time[[0, -1]]
    spans = [s for s in trajectory.excluded if s.stop >= first and s.start <= last]
    if not spans:
        return "left out: nothing"
    causes = Counter(span.cause for span in spans)
    counted = ", ".join(_counted(cause, count) for cause, count in causes.items())
    longest = max(spans, key=lambda span: span.stop - span.start)
    return (
        f"left out: {100 * (1 - trajectory.usable_share):.1f} % ({counted}; longest "
        f"{longest.stop - longest.start:.2f} s at {longest.start:.1f} s)"
    )


def left_out_json(trajectory: Trajectory) -> dict[str, Any]:
    """Return the usable fraction of the time, and all excluded spans."""
    return {
        "usable": trajectory.usable_share,
        "excluded": [vars(span) for span in trajectory.excluded],
    }


def _counted(cause: str, count: int) -> str:
    """Write how often a cause occurred."""
    if cause in _NOUNS:
        return f"{count} {_NOUNS[cause][count > 1]}"
    return cause if count == 1 else f"{count} × {cause}"
