"""The command that identifies a puck."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from typer import Argument

from airpuck.extend import command, options, report, table, warn


@command("Air hockey")
def identify_puck(
    recordings: Annotated[
        list[Path], Argument(metavar="RECORDING...", help="One or more recordings of one puck.")
    ],
    play: options.ReadTable = None,
    output: Annotated[Path | None, options.output("FILE", "Table file to write.")] = None,
    vehicle: options.ReadVehicle = None,
    mapping: options.ReadMapping = None,
) -> None:
    """Identify drag and bounces of a puck from recordings."""
    from airpuck_hockey.puck import identification

    seen = [options.read_recording(path, mapping, needs=("puck",)) for path in recordings]
    fit = identification.identify_puck(seen, play, vehicle)
    if output is not None:
        fit.play.save(output)
    warn(fit.notes)
    puck = fit.play.puck
    rows = [
        [name, f"{identification.value_of(puck, name):.4g}", f"{error:.2g}"]
        for name, error in puck.standard_error.items()
    ]
    used = ", ".join(f"{count} off the {name}" for name, count in fit.bounces.items() if count)
    summary = f"{fit.flights} flights ({fit.seconds:.1f} s), bounces: {used or 'none'}"
    along = f"a puck without spin keeps {puck.kept_along_rail:.2f} of its speed along a rail"
    if len(fit.rail_ratio) > 1:
        summary += f"; the restitution of single bounces scatters by {fit.rail_scatter:.3f}"
    if "rail.grip" in puck.assumed:
        along += " (assumed)"
    found = table(("puck", "value", "standard error"), rows, title="identified on this table")
    report(fit.to_json(), found, summary, along, output or "add -o table.toml to keep it")
