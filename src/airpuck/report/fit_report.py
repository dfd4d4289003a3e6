"""A report on models of any craft: what `airpuck demo` shows at its end."""

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
from airpuck.report.packet_delay_figure import packet_delay_figure
from airpuck.report.page import Picture, Section, Table, write_page
from airpuck.report.study import Study
from airpuck.report.study_sections import (
    craft_section,
    optimiser_section,
    parameter_section,
    prediction_section,
    thrust_section,
    timeline_section,
)


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
    """Write a report on one or several fits."""
    fits = (fits,) if isinstance(fits, Fit) else tuple(fits)
    if not fits:
        raise InputError("there is no fit to report on")
    if truth is not None:
        # What flew has no encoder: give it the convention of the fits, so that losses compare.
        truth = replace(truth, indexing=fits[0].model.indexing)
    study = Study(
        training=training,
        fits=fits,
        fitted=tuple(evaluations),
        reference={} if truth is None else {truth.name: truth},
        reference_label="true" if truth is not None else "reference",
    )
    vehicle = fits[0].model.vehicle
    names = ", ".join(fit.model.name for fit in fits)
    sections: list[Section] = [craft_section(vehicle)]
    if evaluations:
        sections += [prediction_section(study), timeline_section(study)]
    sections += [
        thrust_section(study),
        optimiser_section(study),
        parameter_section(study),
        *_delay_sections(fits[-1], training),
        *_fault_sections(fits[-1], training),
        *more,
        sources_section(training),
    ]
    lead = (
        f"{names}: identified from {training.duration:.1f} s of flight, {len(training)} samples, "
        f"{vehicle.n_propellers} propellers" + f"{_delay(fits[-1].model, training)}."
    )
    return write_page(out, title or f"Identification of {vehicle.name}", lead, sections)


def _delay(model: Model, training: Trajectory) -> str:
    """Say what the transport delay is, where the recording tells it."""
    if model.delay_learned:
        return f", transport delay {delay_words(model)}"
    return f", transport delay {1e3 * training.delay:.1f} ms" if training.delay_known else ""


def _delay_sections(fit: Fit, training: Trajectory) -> list[Section]:
    """Show when single packets arrived, where the delay was learned and some could be told."""
    if not fit.packet_delays or not len(fit.packet_delays[0]):
        return []
    delays = fit.packet_delays[0]
    caption = (
        f"Delay of the {len(delays)} packets that changed the thrust enough to show in the poses, "
        f"± two standard errors; transport delay {delay_words(fit.model)}. A packet that was lost "
        "looks late by the time until the next one. The jitter is what the spread has beyond the "
        "standard errors."
    )
    figure = packet_delay_figure(training.command_time, delays, fit.model)
    return [Section("delay", "Transport delay", (Picture("packet_delays", figure, caption),))]


def _fault_sections(fit: Fit, training: Trajectory) -> list[Section]:
    """Show what was left out, where faults were searched for."""
    if fit.exclusion is None:
        return []
    return [fault_section(training, fit.exclusion.faults[0], fit.model)]


def sources_section(*trajectories: Trajectory) -> Section:
    """List what the numbers come from."""
    from airpuck import __version__

    rows = []
    for trajectory in trajectories:
        spans = [f"{s.start:.2f}–{s.stop:.2f} s: {s.cause}" for s in trajectory.excluded]
        hashes = " ".join(trajectory.hashes.values()) or "none"
        rows.append(
            [
                Path(trajectory.source).parent.name or trajectory.source,
                str(len(trajectory)),
                f"{trajectory.duration:.2f}",
                hashes,
                "; ".join(spans) or "nothing",
            ]
        )
    caption = f"Recordings behind these numbers; computed by airpuck {__version__}."
    headings = ["recording", "samples", "seconds", "SHA-256", "left out"]
    return Section("sources", "Sources", (Table(caption, headings, rows),))
