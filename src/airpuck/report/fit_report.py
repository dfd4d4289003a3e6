"""A report on models of any craft: what `airpuck identify --report` and `airpuck demo` write."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from airpuck.boundary.errors import InputError
from airpuck.data.trajectory import Trajectory, as_trajectories
from airpuck.evaluation.presentation import delay_words
from airpuck.evaluation.verdict import verdict
from airpuck.identification.fit_result import Fit
from airpuck.model.model_file import Model
from airpuck.report.fault_report import fault_section
from airpuck.report.fit_figures import packet_delay_figure
from airpuck.report.fit_sections import FitStudy, craft_section, sources_section, study_sections
from airpuck.report.judged_sections import Judged, judged_sections, path_section, verdict_section
from airpuck.report.page import Origin, Picture, Section, write_page


def fit_report(
    fits: Fit | Sequence[Fit],
    training: Trajectory | Sequence[Trajectory],
    out: str | os.PathLike[str],
    *,
    judged: Judged | None = None,
    truth: Model | None = None,
    title: str | None = None,
    more: Sequence[Section] = (),
    origin: Origin | None = None,
) -> Path:
    """Write a report on one or several fits.

    Parameters
    ----------
    fits : Fit or sequence of Fit
        Fits of one craft to one recording.
    training : Trajectory or sequence of Trajectory
        What they were learned from; of several, pictures show the first.
    out : path-like
        Folder to write to.
    judged : Judged, optional
        How well they predict another recording, in the same order.
    truth : Model, optional
        What flew, where it is known; the report compares the fits with it.
    title : str, optional
        By default the name of the craft.
    more : sequence of Section, optional
        Sections to add at the end.
    origin : Origin, optional
        Command line and date, for the foot of the page.

    Returns
    -------
    Path
        The page.

    Raises
    ------
    InputError
        If there is no fit, or the folder cannot be written to.
    """
    fits, learned = (fits,) if isinstance(fits, Fit) else tuple(fits), as_trajectories(training)
    training = learned[0]
    if not fits:
        raise InputError("there is no fit to report on")
    if truth is not None:
        # What flew has no encoder: give it the convention of the fits, so that losses compare.
        truth = replace(truth, indexing=fits[0].model.indexing)
    study = FitStudy(
        training=training,
        fits=fits,
        reference={} if truth is None else {truth.name: truth},
        reference_label="true" if truth is not None else "reference",
    )
    last, vehicle = fits[-1], fits[0].model.vehicle
    sections = [_verdicts(fits, judged, training)]
    if judged is None:
        sections.append(path_section(training, vehicle))
    else:
        sections += judged_sections(judged, vehicle)
    sections += [*study_sections(study), craft_section(vehicle)]
    if last.packet_delays and len(last.packet_delays[0]):
        sections.append(_delay_section(last, training))
    if last.exclusion is not None:
        sections.append(fault_section(training, last.exclusion.faults[0], last.model))
    sources = learned if judged is None else [*learned, judged.trajectory]
    sections += [*more, sources_section(*sources)]
    duration, samples = sum(one.duration for one in learned), sum(map(len, learned))
    lead = (
        f"{', '.join(fit.model.name for fit in fits)}: identified from {duration:.1f} s of flight, "
        f"{samples} samples, {vehicle.n_propellers} propellers"
    )
    if len(learned) > 1:
        lead += f", {len(learned)} recordings, of which pictures show the first"
    if last.model.delay_learned:
        lead += f", transport delay {delay_words(last.model)}"
    elif training.delay_known:
        lead += f", transport delay {1e3 * training.delay:.1f} ms"
    title = title or f"Identification of {vehicle.name}"
    return write_page(out, title, lead + ".", sections, origin)


def _verdicts(fits: Sequence[Fit], judged: Judged | None, training: Trajectory) -> Section:
    """Say in words which fits can be trusted."""
    if judged is None:
        verdicts = {fit.model.name: verdict(fit.model, training) for fit in fits}
        return verdict_section(verdicts, fits[-1].model.name)
    verdicts = {
        found.model: verdict(fit.model, judged.trajectory, found)
        for fit, found in zip(fits, judged.evaluations, strict=True)
    }
    return verdict_section(verdicts, judged.best.model)


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
