"""Table 1, and tables of parameters."""

from airpuck.model.model_file import published_model
from airpuck.report.fit_figures import coefficient_rows, effect_rows, ladder_table, main_rows

RUNGS = ("M0", "M1", "M2", "M3", "M4")


def test_table_1_is_the_papers():
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


def test_parameters_carry_units_and_say_what_was_learned():
    rows = {row.label: row for row in main_rows([published_model("M0"), published_model("M4")])}
    assert rows["τ"].unit == "ms"
    assert [cell.text for cell in rows["τ"].cells] == ["0.00", "28.91"]
    assert [cell.free for cell in rows["τ"].cells] == [False, True]
    assert [cell.text for cell in rows["I"].cells] == ["0.3370", "–"]


def test_every_propeller_and_coefficient_has_its_row(study):
    n = study.models[0].vehicle.n_propellers
    assert len(coefficient_rows(study.models)) == 3 * n
    assert len(effect_rows(study.models)) == 3 * n
    assert len(main_rows(study.models)) == 6 + n
