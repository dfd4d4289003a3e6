"""A page on how well models predict a recording: `airpuck evaluate -o` and `compare -o`."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from airpuck.data.trajectory import Trajectory
from airpuck.evaluation.evaluate import Evaluation
from airpuck.evaluation.fit_measures import FitMeasures
from airpuck.evaluation.verdict import verdict
from airpuck.model.model_file import Model
from airpuck.report.fit_figures import thrust_figure
from airpuck.report.fit_sections import craft_section, sources_section
from airpuck.report.judged_sections import Judged, fit_table, judged_sections, verdict_section
from airpuck.report.page import Origin, Picture, Section, Text, write_page


def evaluation_report(
    models: Sequence[Model],
    evaluations: Sequence[Evaluation],
    trajectory: Trajectory,
    out: str | os.PathLike[str],
    *,
    names: Sequence[str] = (),
    differences: Sequence[str] = (),
    fits: Sequence[FitMeasures] = (),
    origin: Origin | None = None,
) -> Path:
    """Write a page on models of one craft that were judged on one recording.

    Parameters
    ----------
    models : sequence of Model
        The models.
    evaluations : sequence of Evaluation
        How well they predict, in the same order.
    trajectory : Trajectory
        What they were judged on.
    out : path-like
        Folder to write to.
    names : sequence of str, optional
        What to call the models; by default their rungs.
    differences : sequence of str, optional
        Sentences on how the models differ.
    fits : sequence of FitMeasures, optional
        How well they fit, in the same order.
    origin : Origin, optional
        Command line and date, for the foot of the page.

    Returns
    -------
    Path
        The page.

    Raises
    ------
    InputError
        If the folder cannot be written to.
    """
    names = names or [model.name for model in models]
    models = [replace(model, name=name) for model, name in zip(models, names, strict=True)]
    named = [replace(one, model=name) for one, name in zip(evaluations, names, strict=True)]
    judged = Judged(trajectory, tuple(named))
    verdicts = {
        model.name: verdict(model, trajectory, one)
        for model, one in zip(models, named, strict=True)
    }
    vehicle = models[0].vehicle
    sections = [verdict_section(verdicts, judged.best.model), *judged_sections(judged, vehicle)]
    if differences:
        text = Text(differences, bullets=True)
        sections.append(Section("differences", "Do the models differ?", (text,)))
    if fits:
        sections.append(Section("fit", "Fit", (fit_table(names, fits),)))
    curves = Picture(
        "thrust",
        thrust_figure(models, trajectory, commands="commands of this flight"),
        "Thrust of each motor over its normalised speed. Bars: share of this flight's samples at "
        "each command, in twentieths of the range.",
    )
    sections += [
        Section("thrust", "Thrust curves", (curves,)),
        craft_section(vehicle),
        sources_section(trajectory),
    ]
    lead = (
        f"{', '.join(names)} on {trajectory.duration:.1f} s of flight, {len(trajectory)} samples, "
        f"{vehicle.n_propellers} propellers."
    )
    return write_page(out, f"Predictions of {vehicle.name}", lead, sections, origin)
