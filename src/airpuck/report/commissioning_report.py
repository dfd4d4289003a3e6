"""The page of `airpuck commission`: what was learned when, the flights, the verdict."""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from airpuck.commissioning.commission import Commissioning
from airpuck.deviation.time_scale import response_time
from airpuck.evaluation.presentation import WAYS, largest_acceleration
from airpuck.model.model_file import Model, nominal_model
from airpuck.report import style
from airpuck.report.page import Origin, PageSection, PageTable, Picture, Text, write_page

#: Factor by which a vehicle file's thrusts may be wrong.
_ROUGH = 2.0
#: Width of a flight from above [in].
_FLIGHT_WIDTH = style.PAGE_WIDTH / 3
#: Quantities whose intervals are drawn: label, and value of a model.
_SHOWN: tuple[tuple[str, Callable[[Model], float]], ...] = (
    *(
        (f"{WAYS[k][0]} [{WAYS[k][3]}]", lambda model, k=k: float(largest_acceleration(model)[k]))
        for k in (0, 2, 4)
    ),
    ("lag and delay [ms]", lambda model: 1e3 * float(np.max(response_time(model)))),
)


def commissioning_report(
    found: Commissioning, out: str | os.PathLike[str], origin: Origin | None = None
) -> Path:
    """Write a page on a run."""
    lead = " ".join(found.sentences[:2])
    folder = Path(out).name
    next_ = (
        f"Fly it: `airpuck fly {folder}/model.toml`. Race it on the twin: "
        f"`airpuck race {folder}/model.toml`."
        if found.trusted
        else f"{found.findings[0].remedy} Then run `airpuck commission` again."
    )
    rows = [(one.step, f"{one.time:.1f}", f"{one.flight_s:.1f}", one.words) for one in found.steps]
    headings = ("step", "time [s]", "flight so far [s]", "result")
    steps = PageTable("What each step found.", headings, rows)
    study, said = found.study, ["No model was identified."]
    verdict = Text(said if study is None else study.verdict.sentences)
    sections = [PageSection("summary", "Verdict", [verdict, Text([next_])])]
    sections.append(PageSection("steps", "What was learned, and when", [steps]))
    if any(one.model is not None for one in found.steps):
        caption = (
            "Largest accelerations and the response time, with 95 % intervals. The first bars are "
            "the vehicle file's values, with thrusts known within a factor of two; a cross marks a "
            "value without an interval."
        )
        picture = Picture("intervals", interval_figure(found), caption)
        sections.append(PageSection("intervals", "Shrinking intervals", [picture]))
    if any("pose" in one.recording.streams for one in found.flights):
        caption = "All flights from above, in order; a dot marks the end."
        picture = Picture("flights", flights_figure(found), caption)
        sections.append(PageSection("flights", "Flights from above", [picture]))
    if found.findings:
        texts = [finding.sentence for finding in found.findings]
        sections.append(PageSection("findings", "Findings", [Text(texts, bullets=True)]))
    return write_page(out, "From the box to a trusted flight", lead, sections, origin)


@style.styled
def interval_figure(found: Commissioning, width: float = style.PAGE_WIDTH) -> Figure:
    """Draw how the intervals shrink from step to step; width in inches."""
    figure = style.new_figure(width, 4.4)
    models = [(one.flight_s, one.model) for one in found.steps if one.model is not None]
    stated = nominal_model(found.given)
    for axes, (label, value) in zip(style.panels(figure, 4, 2), _SHOWN, strict=True):
        if not label.endswith("[ms]"):
            middle = value(stated)
            bar = [[middle * (1 - 1 / _ROUGH)], [middle * (_ROUGH - 1)]]
            axes.errorbar(0.0, middle, bar, fmt="o", color=style.GREY, capsize=3)
        for flown, model in models:
            error = float(model.standard_error(value))
            quantile = math.nan if model.known is None else model.known.quantile
            known = math.isfinite(error * quantile)
            reach = quantile * error if known else 0.0
            mark = "o" if known else "x"
            axes.errorbar(flown, value(model), reach, fmt=mark, color=style.BLUE, capsize=3)
        axes.set(title=label, xlabel="flight time [s]")
    return figure


@style.styled
def flights_figure(found: Commissioning, width: float = style.PAGE_WIDTH) -> Figure:
    """Draw every flight from above; width in inches."""
    flown = [one for one in found.flights if "pose" in one.recording.streams]
    columns = round(width / _FLIGHT_WIDTH)
    figure = style.new_figure(width, 0.3 + 1.45 * math.ceil(len(flown) / columns))
    half = np.array(found.table.reach(0.0))
    for axes, flight in zip(style.panels(figure, len(flown), columns), flown, strict=True):
        x, y, _ = flight.recording["pose"].values.T
        style.draw_rails(axes, found.table, lw=1)
        axes.plot(x, y, color=style.BLUE, lw=0.9)
        axes.plot(x[-1], y[-1], "o", color=style.VERMILLION, ms=3)
        axes.set(aspect="equal", title=f"{flight.name}, {flight.span[0]:.0f} s")
        axes.set(xlim=1.04 * half[0] * np.array([-1, 1]), ylim=1.04 * half[1] * np.array([-1, 1]))
        axes.set(xticks=[], yticks=[])
    return figure
