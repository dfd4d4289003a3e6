"""A reference is judged on the data of the fit that it is compared with."""

from dataclasses import replace

import numpy as np
import pytest

from airpuck.report.evaluation_report import sources_section
from airpuck.report.fit_report import FitStudy, study_sections

from ..apparatus.models import fit_of, model_of


def test_the_loss_of_a_reference_is_that_of_the_fits_own_objective(study):
    fit = study.fits[3]
    assert fit.objective is not None
    moved = replace(study.training, command_time=study.training.command_time + 3e-3)
    later = fit_of(fit.model, moved)
    losses = []
    for one in (fit, later):
        alone = FitStudy(study.training, (one,), {"M3": study.reference["M3"]})
        assert one.objective is not None
        expected = one.objective.quadratic(study.reference["M3"].parameters).loss
        assert alone.reference_losses["M3"] == pytest.approx(expected, rel=1e-6)
        losses.append(expected)
    # Packets that were moved are moved for both.
    assert abs(losses[1] / losses[0] - 1) > 1e-3


def test_a_reference_of_another_name_is_not_judged(study):
    other = FitStudy(
        study.training, study.fits[:1], {"M3": model_of(study.models[0].vehicle, "M3")}
    )
    assert other.reference_losses == {}
    assert np.isfinite(list(study.reference_losses.values())).all()


def test_recordings_are_named_so_that_those_of_one_folder_differ(study):
    recordings = [replace(study.training, source=f"/data/bags/{name}") for name in "ab"]
    [block] = sources_section(*recordings).blocks
    assert [row[0] for row in block.rows] == ["bags/a", "bags/b"]


def test_the_symbols_of_parameters_are_explained(study):
    section = next(s for s in study_sections(study) if s.anchor == "parameters")
    table = section.blocks[0]
    for symbol in ("I", "τ", "α", "r", "d"):
        assert f" {symbol}: " in table.caption
        assert any(row[0].split()[0] == symbol for row in table.rows)
