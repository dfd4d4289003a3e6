"""Keep faults out of a fit: find them with a first model, and leave out the windows they touch."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import astuple, dataclass, replace
from pathlib import Path
from typing import Any

from airpuck.data.trajectory import Span, Trajectory
from airpuck.faults.find import find_faults
from airpuck.model.model_file import Model

#: Largest share of the windows that faults may take; if more, the model is wrong instead.
MOST = 0.5
#: Time constants of the motors after which an encoder knows their speeds again.
_SETTLING = 3.0


@dataclass(frozen=True, eq=False)
class Exclusion:
    """The faults that a fit leaves out."""

    #: The recordings without their faults.
    trajectories: tuple[Trajectory, ...]
    #: The faults found in each recording.
    faults: tuple[tuple[Span, ...], ...]
    #: Share of the windows that they took.
    share: float
    #: Names recordings that lost too many windows to be plausible: these keep all.
    warnings: tuple[str, ...] = ()

    def to_json(self) -> dict[str, Any]:
        """Return the figures for ``--json`` and the model file."""
        names = ("recording", "start_s", "stop_s", "cause", "confidence")
        return {
            "share_of_windows": self.share,
            "spans": [
                dict(zip(names, (Path(trajectory.source).name, *astuple(span)), strict=True))
                for trajectory, faults in zip(self.trajectories, self.faults, strict=True)
                for span in faults
            ],
        }


def exclude_faults(
    trajectories: Sequence[Trajectory], model: Model, length: int, stride: int
) -> Exclusion:
    """Find the faults of recordings, and leave them out until the motors have caught up."""
    settling = _SETTLING * float(model.dynamics.motor_time_constant)
    kept, found, warnings = [], [], []
    before = after = 0
    for trajectory in trajectories:
        faults = find_faults(trajectory, model)
        healthy = trajectory.leave_out([replace(f, stop=f.stop + settling) for f in faults])
        windows = len(trajectory.window_starts(length, stride))
        left = len(healthy.window_starts(length, stride))
        if left < (1 - MOST) * windows:
            name = Path(trajectory.source).name or "a recording"
            warnings.append(
                f"{100 * (1 - left / windows):.0f} % of the windows of {name} look faulty; none of "
                "these is left out, since it is the model that does not fit: check the vehicle "
                "file with `airpuck check`"
            )
            healthy, faults, left = trajectory, (), windows
        kept.append(healthy)
        found.append(faults)
        before, after = before + windows, after + left
    return Exclusion(tuple(kept), tuple(found), 1 - after / before, tuple(warnings))
