"""Every public name has an example in its docstring, and it runs."""

import doctest
import inspect

import numpy as np
import pytest

import airpuck
import airpuck_hockey

from .apparatus.fewer_flights import fly_less

#: Examples that take over 1.5 s alone.
SLOW = {"ControllerComparison", "Game", "PredictionBands", "ResidualTests", "Study"}
SLOW |= {"animate", "compare_controllers", "plan", "race", "resid", "study", "tune"}
FLAGS = doctest.NORMALIZE_WHITESPACE | doctest.ELLIPSIS | doctest.IGNORE_EXCEPTION_DETAIL


@pytest.fixture(scope="module")
def shared():
    """Names that examples may use; `docs/_ext/reference_pages.py` tells readers."""
    model = airpuck.read_model("paper:M3")
    recording = airpuck.excite(model, 10.0, seed=1)
    trajectory = airpuck.preprocess(recording)
    fit = airpuck.identify(trajectory, "M0")
    return {
        "airpuck": airpuck,
        "airpuck_hockey": airpuck_hockey,
        "np": np,
        "model": model,
        "recording": recording,
        "trajectory": trajectory,
        "fit": fit,
    }


@pytest.mark.parametrize(
    ("package", "name"),
    [
        pytest.param(package, name, marks=[pytest.mark.slow] if name in SLOW else [], id=name)
        for package in (airpuck, airpuck_hockey)
        for name in dir(package)
    ],
)
def test_examples_of_public_names_run(package, name, shared, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    fly_less(monkeypatch)
    text = inspect.getdoc(getattr(package, name)) or ""
    assert ">>> " in text, "no example"
    found = doctest.DocTestParser().get_doctest(text, dict(shared), name, None, None)
    run = [one for one in found.examples if doctest.SKIP not in one.options]
    assert any(name in one.source for one in run), "the example does not use it"
    said: list[str] = []
    doctest.DocTestRunner(optionflags=FLAGS).run(found, out=said.append)
    assert not said, "".join(said)
