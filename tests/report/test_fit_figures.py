"""Table 1, tables of parameters, intervals, and references judged on the data of a fit."""

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.collections import LineCollection, PolyCollection

from airpuck.model.model_file import published_model
from airpuck.report.evaluation_report import sources_section
from airpuck.report.fit_figures import (
    coefficient_rows,
    effect_rows,
    ladder_table,
    main_rows,
    parameter_figure,
    thrust_figure,
)
from airpuck.report.fit_report import FitStudy, study_sections

from ..apparatus.beliefs import believed
from ..apparatus.models import fit_of, model_of

RUNGS = ("M0", "M1", "M2", "M3", "M4")


def test_table_1_matches_the_paper():
    table = ladder_table([published_model(name) for name in RUNGS])
    texts = {name: texts for name, _, *texts in table.rows}
    disc, direct = "0.000337", "from the others"
    assert texts == {
        "M0": ["free", disc, "0", "0", "0, 0", direct],
        "M1": ["free", "free", "0", "0", "0, 0", direct],
        "M2": ["free", disc, "free", "0", "0, 0", direct],
        "M3": ["free", "free", "free", "free", "free", direct],
        "M4": ["free", "–", "free", "–", "–", "free"],
    }
    assert all(len(row) == len(table.headings) for row in table.rows)
    texts = {(i, j): text for i, row in enumerate(table.rows) for j, text in enumerate(row)}
    assert table.marked == {place for place, text in texts.items() if text == "free"}


def test_parameters_have_units_and_show_whether_they_were_learned():
    rows = {row.label: row for row in main_rows([published_model("M0"), published_model("M4")])}
    assert rows["τ"].unit == "ms"
    assert [cell.text for cell in rows["τ"].cells] == ["0.00", "28.91"]
    assert [cell.free for cell in rows["τ"].cells] == [False, True]
    assert [cell.text for cell in rows["I"].cells] == ["0.3370", "–"]


def test_every_propeller_and_coefficient_has_a_row(study):
    n = study.models[0].vehicle.n_propellers
    assert len(coefficient_rows(study.models)) == 3 * n
    assert len(effect_rows(study.models)) == 3 * n
    assert len(main_rows(study.models)) == 6 + n


PLAIN = published_model("M3")


@pytest.fixture
def known():
    return believed(PLAIN)


def bands(figure):
    return [c for axes in figure.axes for c in axes.collections if isinstance(c, PolyCollection)]


def test_thrust_curves_have_bands_if_their_errors_are_known(known):
    assert not bands(thrust_figure([PLAIN]))
    changed = known.with_delay(0.03)
    assert not bands(thrust_figure([changed]))
    found = bands(thrust_figure([known]))
    assert len(found) == 6
    ends = found[0].get_paths()[0].vertices
    full = ends[np.isclose(ends[:, 0], 1.0), 1]
    reach = 2.0 * 0.01 * np.linalg.norm(PLAIN.parameters.thrust[0])
    middle = PLAIN.parameters.thrust[0].sum()
    assert full.min() == pytest.approx(middle - reach, rel=1e-6)
    assert full.max() == pytest.approx(middle + reach, rel=1e-6)


def test_ratios_have_intervals_if_their_errors_are_known(known):
    def widths(model):
        axes = parameter_figure([model], {"M3": PLAIN}).axes[0]
        segments = [c.get_segments() for c in axes.collections if isinstance(c, LineCollection)]
        return np.ptp(np.array(segments[0])[:, :, 0], axis=1)

    # 2.0 errors of 1 % of each coefficient on both sides, in percent of the sum.
    curves = np.asarray(PLAIN.parameters.thrust)
    expected = 2 * 2.0 * np.linalg.norm(curves, axis=1) / curves.sum(axis=1)
    np.testing.assert_allclose(widths(known), expected, rtol=1e-4)
    # Changed after its fit: unknown.
    np.testing.assert_array_equal(widths(known.with_delay(0.03)), 0.0)


def test_the_table_has_the_standard_error(known):
    lag = next(row for row in main_rows([PLAIN, known]) if row.label == "τ")
    without, with_error = (cell.text for cell in lag.cells)
    assert "±" not in without
    assert with_error == f"{without} ± {0.01 * float(without):.2f}"


def test_the_loss_of_a_reference_uses_the_fits_own_objective(study):
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


def test_a_reference_of_another_rung_is_not_compared(study):
    other = FitStudy(
        study.training, study.fits[:1], {"M3": model_of(study.models[0].vehicle, "M3")}
    )
    assert other.reference_losses == {}
    assert np.isfinite(list(study.reference_losses.values())).all()


def test_recordings_are_named_distinctly_within_one_folder(study):
    recordings = [replace(study.training, source=f"/data/bags/{name}") for name in "ab"]
    [block] = sources_section(*recordings).blocks
    assert [row[0] for row in block.rows] == ["bags/a", "bags/b"]


def test_the_symbols_of_parameters_are_explained(study):
    section = next(s for s in study_sections(study) if s.anchor == "parameters")
    table = section.blocks[0]
    for symbol in ("I", "τ", "α", "r", "d"):
        assert f" {symbol}: " in table.caption
        assert any(row[0].split()[0] == symbol for row in table.rows)
