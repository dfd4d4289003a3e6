"""The command that shows a vehicle file."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Argument

import airpuck
from airpuck.boundary.errors import InputError
from airpuck.cli import options
from airpuck.cli.app import app
from airpuck.cli.identification import PANEL
from airpuck.cli.output import report, table

if TYPE_CHECKING:
    from rich.table import Table

    from airpuck.control.authority import Authority
    from airpuck.model.model_file import Model

#: File suffixes of a drawing.
_FORMATS = (".svg", ".png", ".pdf")


@app.command(rich_help_panel=PANEL)
def vehicle(
    file: Annotated[Path, Argument(metavar="FILE", help="Vehicle file.")],
    output: Annotated[
        Path | None, options.output("FILE", "Drawing to write: craft.svg, .png or .pdf.")
    ] = None,
    json_file: options.Json = None,
    quiet: options.Quiet = False,
) -> None:
    """Show a vehicle file: its propellers, and the motions they can produce."""
    from airpuck.boundary.outputs import replacing
    from airpuck.control.authority import control_authority
    from airpuck.model.model_file import nominal_model

    if output is not None and output.suffix not in _FORMATS:
        raise InputError(f"must end in {', '.join(_FORMATS)}", file=output, field="-o")
    model = nominal_model(airpuck.read_vehicle(file))
    found = control_authority(model)
    if output is not None:
        from airpuck.report.craft import draw_craft

        with replacing(output) as temporary:
            temporary.write_bytes(draw_craft(model.vehicle, output.suffix))
    report(
        {**model.vehicle.model_dump(mode="json"), "motions": found.to_json()},
        json_file,
        _propeller_table(model),
        _motion_table(found),
        *found.sentences,
        output,
        quiet=quiet,
    )


def _propeller_table(model: Model) -> Table:
    """Tabulate position and effect of each propeller at full command."""
    craft, effects = model.vehicle, model.propeller_effects
    rows = []
    for number, (channel, effect, curve) in enumerate(
        zip(craft.actuation.channels, effects.T, model.dynamics.thrust, strict=True), start=1
    ):
        x, y = channel.position_m
        turn = effect[2] / max(abs(effect).max(), 1e-300)
        turns = "left" if turn > 0.01 else "right" if turn < -0.01 else "neither way"
        numbers = [f"{value:.1f}" for value in (1e3 * x, 1e3 * y, channel.direction_deg)]
        strength = f"{sum(curve):.3f}"
        if channel.is_wheel:
            numbers, strength = ["", "", "wheel"], f"{sum(curve):.3g} N m"
        rows.append([str(number), channel.name, *numbers, strength, turns])
    headings = ("", "propeller", "x mm", "y mm", "pushes towards °", "full thrust N", "turns it")
    title = f"{craft.name}: {1e3 * craft.mass_kg:.4g} g, radius {1e3 * craft.radius_m:.4g} mm"
    return table(headings, rows, title=title, left=("propeller", "turns it"))


def _motion_table(found: Authority) -> Table:
    """Tabulate the strength of each motion."""
    units = {name: "rad/s²" if name.startswith("turn") else "m/s²" for name in found.alone}
    rows = [
        [name, *(f"{value:.2f}" if value else "none" for value in (found.alone[name], most)), unit]
        for (name, most), unit in zip(found.together.items(), units.values(), strict=True)
    ]
    headings = ("motion", "nothing else", "with others", "")
    return table(headings, rows, title="Largest accelerations", left=("motion", ""))
