"""The command that proposes what to fly next."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import airpuck
from airpuck.boundary import numbers
from airpuck.boundary.numbers import percent
from airpuck.boundary.settings import Setting
from airpuck.cli import options
from airpuck.cli.app import command
from airpuck.cli.inputs import load, read_controls
from airpuck.cli.output import draw, report, show_time_left, table, warn
from airpuck.control.settings import Criterion, ProposedDuration, ProposedMargin

if TYPE_CHECKING:
    from rich.table import Table

    from airpuck.experiment_design.design import CandidateFlight, CheckedFlights, Design
    from airpuck.model.model_file import Model
    from airpuck.recording.mapping import RecordingMapping

#: Candidates to print.
_SHOWN = 8


@command("Control and flight", rare=("criterion", "mapping", "tuning", "seed"))
def design(
    model: options.ModelName = "paper:M3",
    after: Annotated[
        list[Path] | None,
        Setting("Recording to fit first; repeat for several.", metavar="RECORDING"),
    ] = None,
    duration: ProposedDuration = 60.0,
    criterion: Criterion = "worst",
    margin: ProposedMargin = 0.08,
    output: Annotated[
        Path | None, options.output("FILE", "Plan file to write, for excite --plan.")
    ] = None,
    check: Annotated[
        int | None,
        Setting(
            "Fly the proposal N times on the twin, identify, and compare.",
            numbers.CHECK_FLIGHTS,
            "N",
        ),
    ] = None,
    figure: Annotated[
        Path | None, options.output("FILE", "Figure of the errors to write, a PNG.", "--figure")
    ] = None,
    twin: options.ReadTwin = None,
    tuning: options.TuningFile = None,
    mapping: options.ReadMapping = None,
    seed: options.Seed = 0,
    json_file: options.Json = None,
    quiet: options.Quiet = False,
) -> None:
    """Propose the excitation that best reduces the largest parameter errors."""
    from airpuck.experiment_design.design import check_design

    craft = airpuck.read_model(model)
    if after:
        craft = _fitted(craft, after, mapping, quiet)
    with show_time_left("trial flights", quiet) as progress:
        found = airpuck.design(
            craft,
            duration=duration,
            criterion=criterion,
            margin=margin,
            seed=seed,
            settings=twin,
            tuning=read_controls(tuning, None, craft),
            progress=progress,
        )
    figures, checked = found.to_json(), None
    if check is not None:
        with show_time_left("flights to check", quiet) as progress:
            usual, checked = check_design(found, check, progress=progress)
        figures["check"] = {"usual": usual.to_json(), "proposal": checked.to_json()}
    if output is not None:
        found.proposal.plan.save(output)
    draw(figure, "fit_figures.design_figure", found, checked)
    tables = _candidate_table(found), error_table(found, checked)
    report(figures, json_file, *tables, *summary(found), output, figure)


def _fitted(
    craft: Model, recordings: list[Path], mapping: RecordingMapping | None, quiet: bool
) -> Model:
    """Fit a model's rung to recordings, starting from it."""
    from airpuck.experiment_design.forecast import loss_of

    trajectories = [load(path, craft.vehicle, mapping, quiet=quiet) for path in recordings]
    fit = airpuck.identify(
        trajectories,
        craft.rung,
        vehicle=craft.vehicle,
        initial=craft.parameters,
        loss=loss_of(craft),
    )
    warn(fit.warnings, quiet)
    return fit.model


def summary(found: Design) -> list[str]:
    """Describe which errors a proposal reduces, and the basis of the forecast."""
    import numpy as np

    labels, counts = found.quantities.labels, np.isfinite(found.quantities.scales)
    usual, proposal = found.usual.relative, found.proposal.relative
    before, since = found.relative_before, "now"
    if not np.isfinite(before).any():
        before, since = usual, "with the usual excitation"
    worst_before, worst = (int(np.argmax(np.where(counts, e, -1))) for e in (before, proposal))
    text = [
        f"{labels[worst_before]}, the worst determined {since}: "
        f"from {percent(before[worst_before])} to {percent(proposal[worst_before])}",
        f"worst after the proposed flight: {labels[worst]}, {percent(proposal[worst])}"
        f" ({percent(usual[worst])} after the usual one)",
    ]
    missing = [labels[k] for k in np.flatnonzero(np.isinf(proposal))]
    if missing:
        text.append(f"stays undetermined: {', '.join(missing)}")
    level = found.residual_level
    if level == 1.0:
        return [*text, "assumes the twin's residuals; a real flight has larger ones (--after)"]
    return [*text, f"variance of the residuals: {level:.2g} times the twin's, as in the fit"]


def _candidate_table(found: Design) -> Table:
    """Tabulate the best candidates, and the usual one."""
    shown = list(found.candidates[:_SHOWN])
    if all(one.plan != found.usual.plan for one in shown):
        shown.append(found.usual)
    proposal, usual = found.proposal.plan, found.usual.plan
    plans = [one.plan for one in shown]
    names = ["proposal" if p == proposal else "usual" if p == usual else "" for p in plans]
    return table(
        ("", "amplitude", "hold s", "margin m", "clearance mm", "error", "remark"),
        [(name, *_row(one)) for name, one in zip(names, shown, strict=True)],
        title=f"Excitations of {proposal.duration_s:g} s, by the "
        + ("largest error" if found.criterion == "worst" else "mean error"),
        left=("", "amplitude", "remark"),
    )


def _row(one: CandidateFlight) -> tuple[str, ...]:
    """Return the cells of a candidate."""
    plan = one.plan
    amplitudes = plan.amplitude if isinstance(plan.amplitude, tuple) else (plan.amplitude,)
    return (
        " ".join(f"{amplitude:g}" for amplitude in amplitudes),
        f"{plan.hold_s:g}",
        f"{plan.margin_m:g}",
        f"{1e3 * one.clearance:.0f}",
        percent(one.score, "–"),
        one.refused and f"refused: {one.refused}",
    )


def error_table(found: Design, checked: CheckedFlights | None) -> Table:
    """Tabulate the standard errors of every quantity."""
    headings = ("", "100 % are", "now", "usual", "proposal")
    errors = [found.relative_before, found.usual.relative, found.proposal.relative]
    if checked is not None:
        headings += ("alone", "obtained", "ratio")
        errors += [checked.predicted, checked.typical]
    compared, rows = found.quantities, []
    for k, (label, unit) in enumerate(zip(compared.labels, compared.units, strict=True)):
        scale = compared.scales[k]
        size = f"{scale:.3g} {unit}" if scale < 1e12 else "no scale"
        row = [label, size, *(percent(each[k], "–") for each in errors)]
        if checked is not None:
            ratio = float(checked.ratio[k])
            row.append("–" if math.isnan(ratio) else f"{ratio:.2f}")
        rows.append(row)
    title = "Standard errors, relative to each quantity's scale"
    return table(headings, rows, title=title, left=("", "100 % are"))
