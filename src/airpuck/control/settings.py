"""Settings of flights: excitations, set points, and what to fly next."""

from __future__ import annotations

import os
from dataclasses import asdict, dataclass
from typing import Annotated, ClassVar, Literal

from airpuck.boundary import numbers
from airpuck.boundary.settings import Setting, Settings

#: Largest signal: one number for all, or one each.
Amplitude = Annotated[
    float | tuple[float, ...],
    Setting("Largest random signal, as a fraction of commands", numbers.SIGNAL, "A", "--amplitude"),
]
Hold = Annotated[float, Setting("Time between changes of the signals", numbers.HOLD, "S", "--hold")]
Duration = Annotated[float, Setting("Length of flight", numbers.FLIGHT_DURATION, "S", "--duration")]
Margin = Annotated[
    float,
    Setting(
        "Distance to the rails at which the craft must be able to stop; otherwise signals pause",
        numbers.CLEARANCE,
        "M",
        "--margin",
    ),
]
#: Time at one of several set points, and its default, the paper's [s].
Dwell = Annotated[
    float,
    Setting(
        "Time at each set point; by default 2, and longer for a slow craft.",
        numbers.DWELL,
        "S",
        "--dwell",
    ),
]
DWELL = 2.0
#: "full": compensates the delay and rejects disturbances; the paper's did neither.
ControllerKind = Annotated[
    Literal["paper", "full"] | None,
    Setting(
        "paper: as flown; full: compensates the delay, rejects disturbances; by default paper, "
        "or full for laws other than lqr."
    ),
]
#: Criterion for comparing proposed flights: the largest relative error, or the geometric mean of
#: all.
Criterion = Annotated[
    Literal["worst", "mean"],
    Setting("worst: the largest relative error; mean: their geometric mean."),
]
ProposedDuration = Annotated[
    float, Setting("Length of the flight to propose.", numbers.DESIGN_DURATION, "S", "--duration")
]
ProposedMargin = Annotated[float, Setting("Smallest distance to the rails.", numbers.MARGIN, "M")]
Seed = Annotated[int, Setting("Seed of all random numbers.", numbers.SEED, "N")]
#: Number of processes to start, or a Dask scheduler, whose workers compute instead.
Workers = Annotated[
    str | int | None,
    Setting(
        "Processes to start, by default one per processor; or a Dask scheduler, tcp://HOST:PORT.",
        metavar="N",
    ),
]


@dataclass(frozen=True)
class ExcitationPlan(Settings):
    """An excitation experiment; by default the paper's.

    Attributes
    ----------
    amplitude : float or tuple of float
        Largest signal, either one number for all or one each: first the pairs, then the propellers
        without a partner. Individual values may be 0.
    hold_s : float
        Time between changes of the signals.
    duration_s : float
        Length of the flight.
    margin_m : float
        Distance from the rails at which the craft must be able to stop; otherwise the signals
        pause.

    Raises
    ------
    InputError
        If a number is out of range.
    """

    HEADING: ClassVar = "Excitation"

    amplitude: Amplitude = 1.0
    hold_s: Hold = 0.2
    duration_s: Duration = 90.0
    margin_m: Margin = 0.05

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the plan as TOML."""
        from airpuck.boundary.files import write_toml

        write_toml(path, asdict(self), header="An airpuck excitation experiment.")


def read_excitation_plan(path: str | os.PathLike[str]) -> ExcitationPlan:
    """Read the plan of an excitation experiment."""
    from airpuck.boundary.files import read_toml

    return read_toml(path, ExcitationPlan, base=ExcitationPlan())
