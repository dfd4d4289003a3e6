"""The command that exports a model for other tools."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import airpuck
from airpuck.boundary.settings import Setting
from airpuck.cli import inputs, options
from airpuck.cli.app import command
from airpuck.cli.output import report, table
from airpuck.export.kinds import KINDS, check_given, kind_named, known_kinds


@command("Control and flight")
def export(
    model: options.ModelName,
    kind: Annotated[
        str,
        Setting(
            f"What to write: {'; '.join(f'{n} ({k.summary})' for n, k in KINDS.items())}.",
            metavar="KIND",
            option="--to",
            complete=known_kinds,
        ),
    ],
    output: Annotated[Path, options.output("DIR", "Folder for the files.")],
    tuning: options.TuningFile = None,
    law: options.LawName = None,
    plan: Annotated[
        Path | None, Setting("A plan by `airpuck plan` that the controller tracks.", metavar="FILE")
    ] = None,
    twin: options.TwinFile = None,
    json_file: options.Json = None,
    quiet: options.Quiet = False,
) -> None:
    """Write a model, or its whole controller, for other tools."""
    from airpuck.planning.plan import read_plan

    check_given(kind, tuning=tuning, law=law, twin=twin, plan=plan)
    exported = airpuck.read_model(model)
    # The controller is the same as in the other commands; it depends on the craft.
    controls = "tuning" in kind_named(kind).uses
    written = airpuck.export.write(
        exported,
        kind,
        output,
        tuning=inputs.read_controls(tuning, law, exported) if controls else None,
        twin=None if twin is None else airpuck.read_twin_settings(twin),
        plan=None if plan is None else read_plan(plan, exported),
        inputs=[one for one in (model, tuning, twin, plan) if one is not None],
    )
    rows = [(name, str(value)) for name, value in written.facts.items()]
    shown = [table(("", ""), rows, left=("",))] if rows else []
    report(
        written.to_json(),
        json_file,
        *shown,
        *(output / name for name in written.files),
        quiet=quiet,
    )
