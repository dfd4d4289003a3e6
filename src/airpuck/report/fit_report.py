"""A report on models of any craft: what `airpuck identify --report` and `airpuck demo` write."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from airpuck.boundary.errors import InputError
from airpuck.data.trajectory import Trajectory
from airpuck.evaluation.evaluate import Evaluation
from airpuck.evaluation.presentation import delay_words
from airpuck.identification.fit_result import Fit
from airpuck.model.model_file import Model
from airpuck.report.fault_report import fault_section
from airpuck.report.fit_figures import packet_delay_figure
from airpuck.report.fit_sections import FitStudy, craft_section, sources_section, study_sections
from airpuck.report.page import Picture, Section, write_page


def fit_report(
    fits: Fit | Sequence[Fit],
    evaluations: Sequence[Evaluation],
    training: Trajectory,
    out: str | os.PathLike[str],
    *,
    truth: Model | None = None,
    title: str | None = None,
    more: Sequence[Section] = (),
) -> Path:
    """Write a report on one or several fits.

    Parameters
    ----------
    fits : Fit or sequence of Fit
        Fits of one craft to one recording.
    evaluations : sequence of Evaluation
        How well they predict another recording, in the same order; can be empty.
    training : Trajectory
        What they were learned from.
    out : path-like
        Folder to write to.
    truth : Model, optional
        What flew, where it is known; the report compares the fits with it.
    title : str, optional
        By default the name of the craft.
    more : sequence of Section, optional
        Sections to add at the end.

    Returns
    -------
    Path
        The page.

    Raises
    ------
    InputError
        If there is no fit, or the folder cannot be written to.
    """
    fits = (fits,) if isinstance(fits, Fit) else tuple(fits)
    if not fits:
        raise InputError("there is no fit to report on")
    if truth is not None:
        # What flew has no encoder: give it the convention of the fits, so that losses compare.
        truth = replace(truth, indexing=fits[0].model.indexing)
    study = FitStudy(
        training=training,
        fits=fits,
        fitted=tuple(evaluations),
        reference={} if truth is None else {truth.name: truth},
        reference_label="true" if truth is not None else "reference",
    )
    last, vehicle = fits[-1], fits[0].model.vehicle
    sections = [craft_section(vehicle), *study_sections(study)]
    if last.packet_delays and len(last.packet_delays[0]):
        sections.append(_delay_section(last, training))
    if last.exclusion is not None:
        sections.append(fault_section(training, last.exclusion.faults[0], last.model))
    sections += [*more, sources_section(training)]
    lead = (
        f"{', '.join(fit.model.name for fit in fits)}: identified from {training.duration:.1f} s "
        f"of flight, {len(training)} samples, {vehicle.n_propellers} propellers"
    )
    if last.model.delay_learned:
        lead += f", transport delay {delay_words(last.model)}"
    elif training.delay_known:
        lead += f", transport delay {1e3 * training.delay:.1f} ms"
    return write_page(out, title or f"Identification of {vehicle.name}", lead + ".", sections)


def _delay_section(fit: Fit, training: Trajectory) -> Section:
    """Show when single packets arrived."""
    delays = fit.packet_delays[0]
    caption = (
        f"Delay of the {len(delays)} packets that changed the thrust enough to show in the poses, "
        f"± two standard errors; transport delay {delay_words(fit.model)}. A packet that was lost "
        "looks late by the time until the next one. The jitter is what the spread has beyond the "
        "standard errors."
    )
    figure = packet_delay_figure(training.command_time, delays, fit.model)
    return Section("delay", "Transport delay", (Picture("packet_delays", figure, caption),))
