"""A report on flights to set points: what `airpuck track -o` writes."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from airpuck.flight.track import SetPointResult
from airpuck.report.page import Picture, Section, Table, write_page
from airpuck.report.tracking_figures import input_figure, tracking_figure
from airpuck.twin.tracking_study import Tracked


def tracking_report(flights: Sequence[Tracked], truth: str, out: str | os.PathLike[str]) -> Path:
    """Write a report on a tracking study."""
    sections = tracking_sections(flights)
    names = " and ".join(flight.model for flight in flights)
    lead = f"The set points of the paper, flown with {names} on a twin of {truth}."
    return write_page(out, "Tracking of set points", lead, sections)


def tracking_sections(flights: Sequence[Tracked]) -> list[Section]:
    """Return what a page says of a tracking study."""
    rows = []
    for flight in flights:
        rows += [[f"{flight.model}, twin", *_row(result)] for result in flight.results]
        if flight.real is not None:
            real = flight.real.moves()
            rows += [[f"{flight.model}, real flight", *_row(result)] for result in real]
    table = Table(
        "What became of each set point. Settled: within 20 mm and 0.05 rad. Steady-state error: "
        "mean over the last second, or the last quarter of a short dwell. Effort: mean of the sum "
        "of squared commands above the lowest.",
        ["flight", "set point", "settled [s]", "overshoot", "steady-state error", "effort"],
        rows,
    )
    blocks: list[Picture | Table] = [
        Picture(
            "tracking",
            tracking_figure(flights),
            "A model that explains the craft brings it to its set points; a poor one leaves an "
            "offset, unless disturbances are rejected.",
        ),
        table,
    ]
    apart = [(flight.model, flight.rmse) for flight in flights if flight.rmse is not None]
    if apart:
        blocks.append(
            Table(
                "Twin against the real flight, 0.5 to 6.5 s on the figure's axis, root mean "
                "square.",
                ["flight", "x [mm]", "y [mm]", "yaw [rad]"],
                [
                    [model, f"{1e3 * rmse[0]:.1f}", f"{1e3 * rmse[1]:.1f}", f"{rmse[2]:.3f}"]
                    for model, rmse in apart
                ],
            )
        )
    inputs = [
        Picture(f"inputs_{flight.model}", input_figure(flight), f"Commands of {flight.model}.")
        for flight in flights
    ]
    return [Section("tracking", "Tracking", blocks), Section("inputs", "Commands", inputs)]


def _row(result: SetPointResult) -> list[str]:
    """Lay out the figures of one set point."""
    settled = "no" if result.settling_time is None else f"{result.settling_time:.2f}"
    return [
        f"{result.pose[0]:.1f}, {result.pose[1]:.1f} m, {result.pose[2]:.1f} rad",
        settled,
        _triple(result.overshoot),
        "no poses" if result.steady_state_error is None else _triple(result.steady_state_error),
        f"{result.effort:.3f}",
    ]


def _triple(values: tuple[float, float, float]) -> str:
    """Write x, y and yaw."""
    x, y, yaw = values
    return f"{1e3 * x:.1f}, {1e3 * y:.1f} mm, {yaw:.3f} rad"
