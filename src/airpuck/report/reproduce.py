"""The paper's tables and figures, from its published parameters and from our own fits."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from airpuck.boundary.errors import InputError
from airpuck.boundary.files import replacing
from airpuck.data.trajectory import Span, Trajectory
from airpuck.evaluation.evaluate import compare
from airpuck.identification.fit import identify
from airpuck.model.model_file import published_model
from airpuck.report.fit_report import sources_section
from airpuck.report.page import Section, write_page
from airpuck.report.paper_sections import (
    conventions_section,
    learning_section,
    summary_section,
    table_2,
    table_2_json,
)
from airpuck.report.side_claims import SideClaims, retest_side_claims
from airpuck.report.study import Study
from airpuck.report.study_sections import (
    craft_section,
    optimiser_section,
    parameter_section,
    prediction_section,
    thrust_section,
    timeline_section,
)

RUNGS = ("M0", "M1", "M2", "M3", "M4")
TRAINING = "2023_10_18-11_28_12_sysid_h1_old"
VALIDATION = "2023_11_22-11_57_44_sysid_h1_old"

#: Where the measured acceleration of the validation recording stays below half of what the commands
#: should cause. Causes as far as they can be told: at first the craft rests; about every 30 s all
#: motors stop while commands are logged; twice a single motor stops.
FAULTS = (
    Span(0.0, 2.2, "motors off"),
    Span(28.25, 28.75, "radio out"),
    Span(30.1, 30.25, "motor fails"),
    Span(43.7, 43.9, "unknown"),
    Span(58.1, 58.75, "radio out"),
    Span(60.2, 60.65, "motor fails"),
    Span(88.25, 88.6, "radio out"),
)


@dataclass(frozen=True, eq=False)
class Reproduction:
    """The paper's study, done again."""

    #: Fits, evaluations and published models.
    study: Study
    #: Tests of the side claims, where they were asked for.
    side_claims: SideClaims | None
    #: The report.
    page: Path
    #: Time that everything took [s].
    wall_s: float

    def to_json(self) -> dict[str, Any]:
        """Return the figures for ``--json``."""
        return _figures(self.study, self.side_claims) | {"wall_s": self.wall_s}


def reproduce(
    data: str | os.PathLike[str] | None,
    out: str | os.PathLike[str],
    *,
    side_claims: bool = False,
    progress: Callable[[str], None] = lambda _: None,
) -> Reproduction:
    """Reproduce the paper's tables and figures, published against ours.

    Writes ``index.html``, one self-contained page; ``figures/*.png``; ``models/M0.toml`` …
    ``M4.toml``; and ``reproduce.json``, the numbers.

    Parameters
    ----------
    data : path-like or None
        Folder of the public dataset; None: ``$AIRPUCK_DATA``, or downloaded.
    out : path-like
        Folder to write to.
    side_claims : bool, default False
        Test the paper's side claims again as well, which takes minutes.
    progress : callable, optional
        Told what is being done.

    Returns
    -------
    Reproduction
        All numbers.

    Raises
    ------
    InputError
        If a recording is missing or damaged, or the folder cannot be written to. Nothing is
        written before all numbers are there.
    """
    started = time.perf_counter()
    training, validation = _experiments(data)
    published = {name: published_model(name) for name in RUNGS}
    reference = tuple(compare(list(published.values()), validation))
    progress("evaluated the published parameters")
    fits = []
    for name in RUNGS:
        # As in the paper, whose fits saw the faults of the recording, too.
        fits.append(identify(training, name, faults="keep"))
        progress(f"identified {name} in {fits[-1].wall_s:.1f} s, {fits[-1].iterations} iterations")
    study = Study(
        training=training,
        fits=tuple(fits),
        fitted=tuple(compare([fit.model for fit in fits], validation)),
        reference=published,
        reference_evaluations=reference,
        faults=FAULTS,
    )
    computed = time.perf_counter() - started
    claims = retest_side_claims(study, validation, say=progress) if side_claims else None

    progress("drawing")
    folder = Path(out)
    page = _write_report(folder, study, claims, validation, computed)
    for fit in study.fits:
        fit.model.save(folder / "models" / f"{fit.model.name}.toml")
    result = Reproduction(study, claims, page, time.perf_counter() - started)
    with replacing(folder / "reproduce.json") as temporary:
        temporary.write_text(json.dumps(result.to_json(), indent=2) + "\n", encoding="utf-8")
    return result


def _experiments(data: str | os.PathLike[str] | None) -> tuple[Trajectory, Trajectory]:
    """Read the paper's training and validation recordings."""
    from airpuck.recording.dataset import dataset_folder
    from airpuck.recording.torch_archive import read_authors_experiment

    folder = dataset_folder() if data is None else Path(data)
    if not (folder / "experiments").is_dir():
        raise InputError(
            "has no folder `experiments`; give a copy of the public dataset, or none to use "
            "$AIRPUCK_DATA or a download",
            file=folder,
            field="data",
        )
    training, validation = (
        read_authors_experiment(folder / "experiments" / name / "data.pt")
        for name in (TRAINING, VALIDATION)
    )
    return training, validation


def _write_report(
    out: Path, study: Study, claims: SideClaims | None, validation: Trajectory, wall_s: float
) -> Path:
    """Write the page."""
    sections: list[Section] = [
        summary_section(study, wall_s),
        craft_section(study.models[0].vehicle),
        learning_section(study),
        prediction_section(study, table_2(study)),
        timeline_section(study),
        thrust_section(study),
        optimiser_section(study),
        parameter_section(study),
    ]
    if claims is not None:
        from airpuck.report.side_claim_section import side_claims_section

        sections.append(side_claims_section(claims))
    sections += [conventions_section(), sources_section(study.training, validation)]
    return write_page(
        out,
        "Identifying a hovercraft: the paper's study, done again",
        "R. Schwan, N. Schmid, E. Chassaing, K. Samaha, C. N. Jones: On identifying the non-linear "
        "dynamics of a hovercraft using an end-to-end deep learning approach (IFAC-PapersOnLine "
        "58-15, 2024, 289–294). Its published parameters and our own fits, learned from the same "
        "recording, judged on the same other recording.",
        sections,
    )


def _figures(study: Study, claims: SideClaims | None) -> dict[str, Any]:
    """Collect all numbers."""
    figures: dict[str, Any] = {
        "published": {e.model: e.to_json() for e in study.reference_evaluations},
        "fitted": {e.model: e.to_json() for e in study.fitted},
        "fits": {fit.model.name: fit.to_json() for fit in study.fits},
        "table_2": table_2_json(study),
    }
    if claims is not None:
        figures["side_claims"] = claims.to_json()
    return figures
