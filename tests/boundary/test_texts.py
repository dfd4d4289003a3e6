"""What public functions return is shown in a few lines, with its numbers."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

import airpuck
from airpuck.boundary.files import Section
from airpuck.boundary.results import Brief, brief
from airpuck.model.uncertainty import Uncertainty

from ..apparatus.excited_flights import fit_of_flown, flown

MODEL = airpuck.read_model("paper:M4")
HERE = airpuck.SetPoint(0.1, 0.0, 0.0)
MOST_LINES, MOST_CHARACTERS = 5, 400


def reached(value: Any, path: str) -> Iterator[tuple[str, Any]]:
    """Yield an object, and what its public attributes and entries hold of ours."""
    yield path, value
    for name in [one for one in dir(value) if not one.startswith("_")]:
        inner = vars(value).get(name) if hasattr(value, "__dict__") else None
        several = inner if isinstance(inner, list | tuple) else [inner]
        for one in several[:3]:
            public = getattr(airpuck, type(one).__name__, None) if one is not None else None
            if isinstance(one, Brief | Section) or type(one) is public:
                yield from reached(one, f"{path}.{name}")


def check_shown(objects: dict[str, Any]) -> None:
    for name, value in objects.items():
        for path, one in reached(value, name):
            for shown in (repr(one), str(one)):
                assert len(shown) <= MOST_CHARACTERS, (path, shown)
                assert shown.count("\n") < MOST_LINES, (path, shown)
                assert " at 0x" not in shown and "<function" not in shown, (path, shown)


def test_models_settings_and_controllers_have_short_representations():
    twin, tuning = airpuck.Twin(MODEL), airpuck.default_tuning()
    controller = airpuck.TrackingController(MODEL, HERE, law="mpc", compiled=False)
    log = airpuck.fly(controller, twin, duration=0.05)
    check_shown(
        {
            "model": MODEL,
            "drag": airpuck.named_rung("M3+drag").initial(MODEL.vehicle),
            "tuning": tuning,
            "twin": twin,
            "batch": airpuck.TwinBatch(MODEL, 2, 1.0),
            "controller": controller,
            "laws": airpuck.LQR(MODEL, tuning),
            "inverse": airpuck.InverseThrust(MODEL.dynamics.thrust),
            "mapping": airpuck.RecordingMapping(),
            "settings": airpuck.TwinSettings(radio={"delay_s": 0.03}),
            "table": airpuck.Table(),
            "log": log,
            "step": controller.step(0.05),
            "estimate": controller.predict(0.05),
            "path": airpuck.TimedPath([0.0, 1.0], [(0.0, 0.0, 0.0), (0.1, 0.0, 0.0)]),
            "points": airpuck.SetPoints([0.0, 1.0], [(0.0, 0.0, 0.0), (0.1, 0.0, 0.0)]),
            "meeting": airpuck.Rendezvous(1.0, np.zeros(6)),
            "limits": airpuck.SafetyLimits((-1.0, -0.5, 1.0, 0.5)),
            "loss": airpuck.Loss(),
            "method": airpuck.LevenbergMarquardt(),
            "presentation": airpuck.present(MODEL),
        }
    )


@pytest.mark.slow
def test_results_of_a_flight_have_short_representations():
    fit, trajectory = fit_of_flown(0.007, 40.0), flown(0.007, 40.0).trajectory.slice(0, 0.2)
    log = airpuck.track(MODEL, HERE, 2.0)
    judged = airpuck.study(trajectory, model="M0")
    check_shown(
        {
            "fit": fit,
            "uncertainty": fit.model.uncertainty,
            "study": judged,
            "verdict": judged.verdict,
            "evaluation": airpuck.evaluate(fit.model, trajectory),
            "tests": airpuck.resid(fit.model, trajectory),
            "budget": airpuck.error_budget(fit.model, trajectory),
            "bands": airpuck.prediction_bands(fit.model, trajectory),
            "strengths": airpuck.find_strengths(fit.model, trajectory),
            "layout": airpuck.check_layout(trajectory, MODEL.vehicle),
            "replay": airpuck.replay(log.recording, MODEL),
            "result": log.metrics()[0] if log.metrics() else log,
        }
    )


def test_settings_show_what_differs_from_their_defaults():
    assert repr(airpuck.TwinSettings()) == "TwinSettings()"
    assert repr(airpuck.TwinSettings(radio={"delay_s": 0.03})) == (
        "TwinSettings(radio={delay_s: 0.03})"
    )
    assert repr(airpuck.Loss()) == "Loss()" and repr(airpuck.Limits(spin=9)) == "Limits(spin=9)"
    assert str(airpuck.Table(width_m=0.9)) == "Table(width_m=0.9)"
    assert repr(MODEL.parameters).startswith("Parameters(thrust_N=6×3 values from -0.66 to 1.26, ")


def test_laws_of_a_user_and_objects_whose_constructor_failed_are_shown():
    for kind in (airpuck.Twin, airpuck.TrackingController, airpuck.TimedPath, airpuck.Loss):
        assert repr(object.__new__(kind)).startswith(f"{kind.__name__}(")
    law = dataclass(type("Own", (airpuck.Law,), {"__annotations__": {"x": float}, "x": 1 / 3}))
    assert brief(law()) == "Own(x=0.3333)" == brief(law(), {"x": np.array(1 / 3)})
    eye = np.eye(2)
    assert repr(Uncertainty(eye[0], eye, eye[0], eye, 3, 4.3, ("far",), ("far",))).count("far") == 1
