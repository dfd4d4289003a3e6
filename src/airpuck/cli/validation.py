"""Commands that judge models and recordings, and show a vehicle file."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import Argument, Option

import airpuck
from airpuck.boundary import numbers
from airpuck.boundary.errors import InputError, about
from airpuck.boundary.settings import Setting
from airpuck.cli import options
from airpuck.cli.app import command
from airpuck.cli.identification import PANEL, value_texts
from airpuck.cli.output import draw, page, report, table, warn

if TYPE_CHECKING:
    from rich.table import Table

    from airpuck.control.authority import Authority
    from airpuck.data.trajectory import Span
    from airpuck.evaluation.drift import Drift
    from airpuck.evaluation.presentation import Presentation
    from airpuck.model.model_file import Model


#: Largest number of faults in a table.
_MOST_SPANS = 30
#: Suffixes of model files, which no recording has.
_MODEL_FILES = (".toml", ".json")


@command(PANEL)
def evaluate(
    model: options.ModelName,
    recording: options.RecordingPath,
    output: options.PageFolder = None,
    span: options.RecordingPart = None,
    protocol: options.ProtocolOption = "paper",
    horizon: options.Horizon = 0.2,
    encoder: options.EncoderName = "paper",
    budget: Annotated[
        bool, Option("--budget", help="Also show what causes the error: share of each cause.")
    ] = False,
    law: options.JudgedLaw = None,
    mapping: options.ReadMapping = None,
) -> None:
    """Measure how well a model predicts a recording."""
    from airpuck.evaluation.comparison import better_from, coasting
    from airpuck.evaluation.evaluate import PROTOCOLS
    from airpuck.judgement.study import judged_on, reference_faults
    from airpuck.preprocessing.quality import left_out_json, left_out_words
    from airpuck.report.tables import budget_table, error_tables

    judged = airpuck.read_model(model)
    trajectory = options.load(recording, judged.vehicle, mapping, span=span)
    chosen = PROTOCOLS[protocol].after(horizon).suited(judged, trajectory)
    found = airpuck.evaluate(judged, trajectory, protocol=chosen, encoder=encoder)
    said = judged_on(judged, trajectory, found, mapping, [law] if law else [])
    since = better_from(found, trajectory)
    faults = reference_faults(trajectory, judged.vehicle)
    owned = None
    if budget:
        given = {"protocol": chosen, "encoder": encoder}
        owned = airpuck.error_budget(judged, trajectory, faults, **given)
    content = [judged], [found], trajectory
    known = {"verdicts": {judged.name: said}, "faults": faults, "budget": owned}
    written = page(output, "evaluation_report.evaluation_report", *content, **known)
    shown = [budget_table(owned)] if owned else []
    shown += error_tables([model], [found], trajectory, faults)
    figures = {
        **found.to_json(),
        "healthy_start": found.healthy(faults).to_json(),
        **({"budget": owned.to_json()} if owned else {}),
        "constant_velocity": coasting(found, trajectory).to_json(),
        **since.to_json(),
        "name": model,
        "verdict": said.to_json(),
        **left_out_json(trajectory),
    }
    report(figures, *said.sentences, *shown, str(since), left_out_words(trajectory), written)
    said.check_recording(recording)


@command(PANEL)
def check(
    recording: options.RecordingPath,
    vehicle: options.ReadVehicle = None,
    mapping: options.ReadMapping = None,
) -> None:
    """Check that motor order and signs of a vehicle file agree with a recording."""
    from airpuck.data.trajectory import vehicle_of
    from airpuck.recording.mapping import RecordingMapping

    trajectory = options.load(recording, vehicle, mapping)
    craft = vehicle or vehicle_of([trajectory])
    axes = (mapping or RecordingMapping()).pose.axes
    result = airpuck.check_layout(trajectory, craft, axes=axes)
    report(result.to_json(), *result.lines)
    if not result.agrees:
        said = f"does not agree with the vehicle {craft.name!r}: {', '.join(result.wrong)}"
        problem = said if result.conclusive else "contains too little to judge the vehicle file"
        raise InputError(problem, file=recording)


@command(PANEL)
def faults(
    recording: options.RecordingPath,
    model: Annotated[
        str | None,
        Setting(
            "Model of the healthy craft; by default M3, or M3+tilt, fitted to the recording.",
            metavar="MODEL",
        ),
    ] = None,
    output: options.PageFolder = None,
    span: options.RecordingPart = None,
    vehicle: options.ReadVehicle = None,
    mapping: options.ReadMapping = None,
) -> None:
    """Find when motors, radio or cameras failed, or something hit the craft."""
    from airpuck.data.trajectory import vehicle_of
    from airpuck.faults.strengths import find_strengths, on_table_of, usual_rung
    from airpuck.preprocessing.quality import left_out_words
    from airpuck.report.tables import span_table

    healthy = options.read_given(model, vehicle, airpuck.read_model)
    craft = healthy.vehicle if healthy else vehicle
    trajectory = options.load(recording, craft, mapping, span=span)
    if healthy is None:
        craft = craft or vehicle_of([trajectory])
        fit = airpuck.identify(trajectory, usual_rung(trajectory, craft), vehicle=craft)
        warn(fit.exclusion.warnings if fit.exclusion else ())
        healthy = fit.model
    found = airpuck.find_faults(trajectory, on_table_of(healthy, trajectory))
    strengths = find_strengths(healthy, trajectory)
    written = page(output, "evaluation_report.fault_report", trajectory, found, healthy)
    spans = sorted((*trajectory.excluded, *found), key=lambda s: s.start)
    healthy_part = trajectory.leave_out(found)
    usable = float(healthy_part.usable.mean())
    names = {"start_s": "start", "stop_s": "stop", "cause": "cause", "confidence": "confidence"}
    figures = {
        "model": healthy.name,
        "duration_s": trajectory.duration,
        "usable": usable,
        "spans": [{key: getattr(s, name) for key, name in names.items()} for s in spans],
        "strengths": strengths.to_json(),
    }
    shown = span_table(listed_spans(spans, _MOST_SPANS)) if spans else None
    more = len(spans) - _MOST_SPANS
    folded = f"and {more} more; --json has all" if more > 0 else None
    what = "temporary faults" if strengths.remarkable else "any fault"
    share = f"{100 * usable:.1f} % of {trajectory.duration:.1f} s without {what}"
    left, throughout = left_out_words(healthy_part), strengths.sentences
    report(figures, shown, folded, left, share, *throughout, written)


@command(PANEL)
def present(model: options.ModelName) -> None:
    """Present a model: structure, parameters with errors, derived quantities, fit details."""
    from airpuck.judgement.verdict import verdict

    read = airpuck.read_model(model)
    presentation, said = airpuck.present(read), verdict(read)
    figures = {**presentation.to_json(), "verdict": said.to_json()}
    report(figures, *said.sentences, *_presented(presentation))


@command(PANEL)
def compare(
    models: Annotated[
        list[str],
        Argument(
            metavar="MODEL... RECORDING",
            help="Models, then the recording; for two models alone, report their differences.",
        ),
    ],
    output: options.PageFolder = None,
    span: options.RecordingPart = None,
    protocol: options.ProtocolOption = "paper",
    horizon: options.Horizon = 0.2,
    encoder: options.EncoderName = "paper",
    mapping: options.ReadMapping = None,
) -> None:
    """Compare models on one recording; report the drift between two learned models."""
    from airpuck.evaluation.comparison import model_differences
    from airpuck.evaluation.evaluate import PROTOCOLS
    from airpuck.evaluation.fit_measures import measure_fit
    from airpuck.judgement.study import reference_faults
    from airpuck.judgement.verdict import verdict
    from airpuck.report.tables import error_tables, fit_table

    chosen = PROTOCOLS[protocol].after(horizon)
    alone = models[-1].startswith("paper:") or models[-1].endswith(_MODEL_FILES)
    names = models if alone else models[:-1]
    if not names or (alone and (len(names) != 2 or output is not None)):
        raise InputError(
            "at least one MODEL and a RECORDING are needed; without -o, two MODELs suffice"
        )
    read, called = [airpuck.read_model(name) for name in names], _short_names(names)
    figures, shown = dict[str, Any](), list[Any]()
    if (drift := _drift_of(read, alone)) is not None:
        figures["drift"] = drift.to_json()
        shown += _drift_lines(called, drift)
    if not alone:
        trajectory = options.load(Path(models[-1]), read[0].vehicle, mapping, span=span)
        evaluations = airpuck.compare(read, trajectory, protocol=chosen, encoder=encoder)
        fits = [measure_fit(model, trajectory, horizon=horizon) for model in read]
        faults = reference_faults(trajectory, read[0].vehicle)
        figures["evaluations"] = [
            {
                **evaluation.to_json(),
                "healthy_start": evaluation.healthy(faults).to_json(),
                **fit.to_json(),
                "name": name,
                "verdict": verdict(model, trajectory, evaluation).to_json(),
            }
            for name, model, evaluation, fit in zip(names, read, evaluations, fits, strict=True)
        ]
        differences = model_differences(called, evaluations)
        typed = dict(zip(called, names, strict=True))
        figures["differences"] = [
            {**one.to_json(), "first": typed[one.first], "second": typed[one.second]}
            for one in differences
        ]
        verdicts = [one.verdict for one in differences]
        tables = error_tables(called, evaluations, trajectory, faults)
        shown = [*tables, *verdicts, fit_table(called, fits), *shown]
        said = {"names": called, "differences": verdicts, "fits": fits, "faults": faults}
        content = read, evaluations, trajectory
        shown.append(page(output, "evaluation_report.evaluation_report", *content, **said))
    report(figures, *shown)


def _drift_of(models: Sequence[Model], alone: bool) -> Drift | None:
    """Return the drift between two models; None if it was not requested and is not known."""
    if len(models) != 2 or not (alone or all(m.known is not None for m in models)):
        return None
    try:
        return airpuck.drift(*models)
    except InputError as error:
        if alone:
            raise
        return airpuck.Drift((), (f"drift is unknown: {error.problem}",))


def _short_names(names: Sequence[str]) -> list[str]:
    """Return names of models for tables and figures: file names without folder and suffix."""
    called = [Path(name).stem if name.endswith(_MODEL_FILES) else name for name in names]
    return called if len(set(called)) == len(called) else list(names)


@command(PANEL)
def resid(
    model: options.ModelName,
    recording: options.RecordingPath,
    span: options.RecordingPart = None,
    output: options.PageFolder = None,
    lags: Annotated[int, Setting("Largest lag, in samples.", numbers.LAGS, "N")] = 25,
    mapping: options.ReadMapping = None,
) -> None:
    """Test the one-step innovations of a model: whiteness, and remaining effects of commands."""
    from airpuck.evaluation.fit_measures import measure_fit
    from airpuck.evaluation.prediction_bands import bands_of_all_horizons
    from airpuck.preprocessing.quality import left_out_json, left_out_words
    from airpuck.report.tables import band_table, fit_table

    judged = airpuck.read_model(model)
    trajectory = options.load(recording, judged.vehicle, mapping, span=span)
    with about(recording):
        tests = airpuck.resid(judged, trajectory, lags=lags)
        fit = measure_fit(judged, trajectory, filtered=tests.innovations)
        bands = bands_of_all_horizons(judged, trajectory, tests.innovations)
    content = judged, trajectory, tests, fit
    written = page(output, "residual_report.residual_report", *content, bands=bands)
    figures = {**tests.to_json(), **fit.to_json(), **left_out_json(trajectory)}
    figures["bands"] = [one.to_json() for one in bands]
    outcome = "nothing rejected" if tests.passed else "rejected"
    lines = [f"{model}: {outcome}, {tests.samples} one-step innovations, 1 % level"]
    lines += [left_out_words(trajectory), *(f"  {sentence}" for sentence in tests.verdicts)]
    tables = band_table(bands), fit_table([model], [fit])
    report({**figures, "name": model}, *lines, *tables, written)


def listed_spans(spans: Sequence[Span], most: int) -> list[Span]:
    """Return the spans that a table has room for, by their starts.

    Drop-outs of the cameras can be many, so faults of motors and radio take precedence over them,
    and long spans over short ones.
    """
    important = sorted(spans, key=lambda s: (s.confidence == 1, s.start - s.stop))
    return sorted(important[:most], key=lambda s: s.start)


def _presented(presentation: Presentation) -> Iterator[str | Table]:
    """Yield the presentation of a model."""
    yield from presentation.structure
    headings = ("", "unit", "value", "95 % interval")
    parameters = map(value_texts, presentation.parameters)
    yield table(headings, parameters, title="Parameters ± standard error (with tolerances)")
    yield table(headings, map(value_texts, presentation.derived), title="Derived quantities")
    yield from (f"{key}: {value}" for key, value in presentation.conditions)
    yield from (f"note: {note}" for note in presentation.notes)


def _drift_lines(names: Sequence[str], found: Drift) -> list[str]:
    """Return lines on the changes from one model to the other."""
    sentences = [*found.verdicts, *(f"note: {note}" for note in found.notes)]
    header = f"from {names[0]} to {names[1]}, {len(found.changes)} quantities:"
    return [header, *(f"  {sentence}" for sentence in sentences)]


@command(PANEL)
def vehicle(
    file: Annotated[Path, Argument(metavar="FILE", help="Vehicle file.")],
    output: Annotated[
        Path | None,
        options.output(
            "FILE", "Drawing to write: craft.svg, .png or .pdf.", endings=options.FIGURES
        ),
    ] = None,
) -> None:
    """Show a vehicle file: its propellers, and the motions they can produce."""
    from airpuck.control.authority import control_authority
    from airpuck.model.model_file import nominal_model

    model = nominal_model(airpuck.read_vehicle(file))
    found = control_authority(model)
    draw(output, "craft.craft_figure", model.vehicle)
    report(
        {**model.vehicle.model_dump(mode="json"), "motions": found.to_json()},
        _propeller_table(model),
        _motion_table(found),
        *found.sentences,
        output,
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
