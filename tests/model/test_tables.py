"""Labelled tables of parameters, and display of results in a notebook."""

import importlib.util
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest

import airpuck
from airpuck.model.model_file import published_model

from ..apparatus.beliefs import believed
from ..apparatus.synthetic_flights import fly

M4 = published_model("M4")


def test_the_table_has_every_parameter_with_its_unit_and_interval():
    table = believed(M4).table()
    assert list(table.index) == M4.parameters.labels(M4.vehicle.propeller_names)
    lag = table.loc["motor_time_constant"]
    assert lag["value"] == float(M4.parameters.motor_time_constant) and lag["unit"] == "s"
    assert lag["upper_95"] - lag["lower_95"] == pytest.approx(4 * 0.01 * lag["value"])
    units = {label: row["unit"] for label, row in table.iterrows()}
    assert units["configuration_matrix y motor_a_1"] == "1/kg"
    assert units["configuration_matrix yaw motor_a_1"] == "1/(kg m)"
    assert units["thrust motor_c_2 φ^3"] == "N"
    assert np.isnan(table.loc["angle_offset", "standard_error"])


def test_the_covariance_is_labelled():
    model = believed(M4)
    table = model.covariance()
    lag = "motor_time_constant"
    assert list(table.index) == list(table.columns) and len(table) == M4.free.sum()
    assert table.loc[lag, lag] == pytest.approx((0.01 * M4.parameters.motor_time_constant) ** 2)
    assert np.isnan(M4.covariance().loc[lag, lag])


def test_without_pandas_rows_are_dictionaries(monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    row = believed(M4).table()["motor_time_constant"]
    assert row["unit"] == "s" and row["learned"] is True


class _Cells(HTMLParser):
    """Counts the cells of each row, and fails on a tag that is not closed."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.rows: list[int] = []
        self.feed(text)
        assert not self.open

    def handle_starttag(self, tag, attrs):
        self.open.append(tag)
        if tag == "tr":
            self.rows.append(0)
        self.rows[-1:] = [n + (tag in ("td", "th")) for n in self.rows[-1:]]

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


SHOWN = {
    "model": lambda: replace(believed(M4), source="<b>bag</b>"),
    "trajectory": lambda: fly(M4, 1.0),
    "evaluation": lambda: airpuck.evaluate(M4, fly(M4, 1.0)),
    "presentation": lambda: airpuck.present(replace(believed(M4), source="<b>bag</b>")),
}


@pytest.mark.parametrize("made", SHOWN.values(), ids=SHOWN)
def test_results_have_notebook_one_line_and_table_forms(made):
    result = made()
    assert len(repr(result)) < 200 and "\n" not in repr(result)
    text = result._repr_html_()
    assert len(set(_Cells(text).rows)) == 1 and "<b>" not in text
