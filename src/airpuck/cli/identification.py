"""Commands from a recording to a model."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Argument

from airpuck.boundary import numbers
from airpuck.boundary.errors import InputError
from airpuck.boundary.settings import Setting
from airpuck.cli import options
from airpuck.cli.app import command
from airpuck.cli.output import origin, report, show_progress, show_time_left, table, warn
from airpuck.identification.settings import (
    ComFrame,
    Degree,
    Loss,
    Preparation,
    Stride,
    YawWeight,
    of_structure,
)

if TYPE_CHECKING:
    from rich.table import Table

    from airpuck.evaluation.presentation import MainQuantity, Value
    from airpuck.identification.fit_result import Fit
    from airpuck.judgement.study import Study
    from airpuck.model.model_file import Model

PANEL = "From a recording to a validated model"

Recordings = Annotated[
    list[Path], Argument(metavar="RECORDING...", help="One or more recordings of one craft.")
]
_of_uncertainty = partial(Setting, heading="Uncertainty")


@command(PANEL)
def preprocess(
    recording: options.RecordingPath,
    output: Annotated[Path, options.output("FILE", "Trajectory file to write, such as traj.npz.")],
    vehicle: options.ReadVehicle = None,
    mapping: options.ReadMapping = None,
    delay: Annotated[
        float | None, Setting("Transport delay; by default it is estimated.", numbers.DELAY, "S")
    ] = None,
) -> None:
    """Turn a recording into a trajectory: states, commands, delay, excluded spans."""
    from airpuck.preprocessing.quality import left_out_json, left_out_words

    if output.suffix != ".npz":
        raise InputError("must end in .npz", file=output, field="-o")
    trajectory = options.load(recording, vehicle, mapping, delay=delay)
    trajectory.save(output)
    figures = {
        "samples": len(trajectory),
        "duration_s": trajectory.duration,
        "delay_s": trajectory.delay if trajectory.delay_known else None,
        **left_out_json(trajectory),
        "warnings": list(trajectory.warnings),
    }
    found = f"{1e3 * trajectory.delay:.1f} ms" if trajectory.delay_known else "compensated"
    report(
        figures,
        f"{len(trajectory)} samples, {trajectory.duration:.1f} s, transport delay {found}",
        left_out_words(trajectory),
        output,
    )


def _rung_names() -> list[str]:
    """Complete --model in the shell."""
    from airpuck.model.rungs import RUNGS

    return [*RUNGS, "auto"]


@command(
    PANEL,
    rare=(
        *("encoder_time", "prediction_time", "robust", "faults", "delay", "degree", "com_frame"),
        *("stride", "yaw_weight", "bootstrap", "seed", "each"),
    ),
)
def identify(
    recordings: Recordings,
    loss: Loss,
    preparation: Preparation,
    model: Annotated[
        str | None,
        Setting(
            "M0 … M5 or quadratic, with terms: M3+inflow+pair, M3+FILE.py:NAME. By default, or "
            "if it is auto: M3 with the terms that the recordings clearly show.",
            complete=_rung_names,
        ),
    ] = None,
    output: Annotated[Path, options.output("FILE", "Model file to write.")] = Path("model.toml"),
    report_folder: Annotated[
        Path | None, options.output("DIR", "Also write a page with figures.", "--report")
    ] = None,
    validation: Annotated[
        Path | None, Setting("Another recording, for validating the model.", metavar="RECORDING")
    ] = None,
    vehicle: options.ReadVehicle = None,
    mapping: options.ReadMapping = None,
    span: options.RecordingPart = None,
    verbose: options.Verbose = False,
    degree: Degree = None,
    com_frame: ComFrame = "body",
    stride: Stride = None,
    yaw_weight: YawWeight = 0.1,
    bootstrap: Annotated[
        int | None,
        _of_uncertainty("Also fit N resamplings, for bootstrap intervals", numbers.REPLICATES, "N"),
    ] = None,
    seed: Annotated[int, _of_uncertainty("Seed of the resamplings", numbers.SEED, "N")] = 0,
    each: Annotated[
        str,
        of_structure(
            "Parameters fitted for each recording separately, such as delay,tilt; all others are "
            "shared. model.toml has the last recording's values, model.toml#1 the first's.",
            metavar="NAMES",
        ),
    ] = "",
) -> None:
    """Identify a model from recordings and write it as TOML."""
    from airpuck.model.rungs import named_rung

    rung = named_rung("M3" if model in (None, "auto") else model, degree=degree, frame=com_frame)
    if degree is not None and rung.powers is not None:
        raise InputError(f"is fixed for the model {model}", field="--degree")
    if com_frame != "body" and "center_of_mass" not in rung.free:
        raise InputError(
            f"has no effect on {model}, which learns no centre of mass; leave it out",
            field="--com-frame",
        )
    if seed and bootstrap is None:
        raise InputError("has no effect without --bootstrap; leave it out", field="--seed")
    training = [options.load(path, vehicle, mapping, span=span) for path in recordings]
    other = None if validation is None else options.load(validation, vehicle, mapping)
    # These take a second to import, too long before a recording is refused.
    from airpuck.judgement.study import study
    from airpuck.report.tables import error_tables

    loss = replace(loss, weights=(1.0, 1.0, yaw_weight))
    if stride is not None:
        loss = replace(loss, spacing=stride * training[0].sample_period)
    with show_progress() as progress, show_time_left("resamplings") as tell:
        found = study(
            training,
            vehicle,
            model,
            other,
            mapping=mapping,
            degree=degree,
            frame=com_frame,
            loss=loss,
            preparation=preparation,
            bootstrap=bootstrap or 0,
            seed=seed,
            each=[name.strip() for name in each.split(",") if name.strip()],
            progress=progress,
            resampled=partial(tell, total=bootstrap),
        )
    found.model.save(output)
    if report_folder is not None:
        _write_report(found, report_folder)
    warn(found.fit.warnings)
    judged = []
    if found.evaluation is not None and other is not None:
        judged = error_tables([found.model.name], [found.evaluation], other)[:1]
    told = *found.sentences, *judged, *_fit_summary(found.fit, verbose), output
    report(found.to_json(), *told)
    found.verdict.check_recording(recordings[0])


def _write_report(study: Study, folder: Path) -> None:
    """Write a page on a fit, and on its predictions of another recording."""
    from airpuck.report.evaluation_report import JudgedModels
    from airpuck.report.fit_report import fit_report

    judged = None
    if study.validation is not None and study.evaluation is not None:
        judged = JudgedModels(study.validation, (study.evaluation,))
    fit_report(
        study.fit,
        study.training,
        folder,
        judged=judged,
        strengths=study.strengths,
        verdicts={study.model.name: study.verdict},
        origin=origin(),
    )


def _fit_summary(fit: Fit, verbose: bool) -> Iterator[str | Table]:
    """Yield lines on how a fit ended, its main quantities with errors, and what is undetermined."""
    from airpuck.identification.fit_result import knowledge_words, outcome_words

    yield from outcome_words(fit)
    uncertainty = fit.uncertainty
    if uncertainty is None:
        return
    own = fit.model.recordings
    headings = ["", "unit", "value", "95 % interval"]
    if uncertainty.bootstrap is not None:
        headings.append(f"95 %, {uncertainty.bootstrap.replicates} resampled")
    yield table(
        headings,
        [row[: len(headings)] for row in _rows(fit.model)],
        title=f"Learned values ± standard error, from {uncertainty.clusters} blocks and tolerances"
        + (f"; separate values are for {Path(own[-1].source).name}" if own else ""),
        left=("", "unit"),
    )
    if own:
        yield _each_recording(fit.model)
    if verbose:
        yield from knowledge_words(fit)


def _each_recording(model: Model) -> Table:
    """Tabulate what recordings of one craft do not share."""
    from airpuck.evaluation.presentation import main_quantities, value_of
    from airpuck.model.sections import of_recording

    models = [of_recording(model, k + 1, "") for k in range(len(model.recordings))]
    rows = []
    for quantity in main_quantities(model, speeds=(0.5, 1.0)):
        texts = [value_texts(value_of(one, quantity)) for one in models]
        if quantity.used(model) and len({float(quantity.value(one)) for one in models}) > 1:
            rows.append([*texts[0][:2], *(text[2] for text in texts)])
    names = [Path(one.source).name for one in model.recordings]
    return table(["", "unit", *names], rows, title="Of each recording", left=("", "unit"))


def _rows(model: Model) -> list[list[str]]:
    """Return the texts of the main quantities that were learned."""
    from airpuck.evaluation.presentation import main_quantities, value_of

    return [
        [*value_texts(value_of(model, quantity)), _resampled(model, quantity)]
        for quantity in main_quantities(model, speeds=(0.5, 1.0))
        if quantity.used(model) and quantity.learned(model)
    ]


def value_texts(value: Value) -> list[str]:
    """Return the texts of one quantity: value ± standard error, and the interval."""
    from airpuck.evaluation.presentation import NOT_IDENTIFIED

    if value.learned and not value.identified and math.isfinite(value.quantile):
        return [value.label, value.unit, NOT_IDENTIFIED, "none"]
    if value.interval is None:
        return [value.label, value.unit, f"{value.value:.4g}", "none" if value.learned else "fixed"]
    digits = _digits(value.standard_error)
    low, high = (f"{end:.{digits}f}" for end in value.interval)
    shown = f"{value.value:.{digits}f} ± {value.standard_error:.{digits}f}"
    return [value.label, value.unit, shown, f"{low} … {high}"]


def _resampled(model: Model, quantity: MainQuantity) -> str:
    """Return the text of a bootstrap's interval."""
    import numpy as np

    found = model.known and model.known.bootstrap
    if not found or quantity.entry is None:
        return ""
    entries = np.flatnonzero(model.parameters.mask(frozenset({quantity.parameter})))
    position = entries[quantity.entry]
    if not math.isfinite(found.lower[position]):
        return ""
    low, high = (quantity.factor * float(e[position]) for e in (found.lower, found.upper))
    digits = _digits((high - low) / 4)
    return f"{low:.{digits}f} … {high:.{digits}f}"


def _digits(error: float) -> int:
    """Return the number of decimals that shows two significant digits of an error."""
    return max(0, 1 - math.floor(math.log10(error))) if error > 0 else 3
