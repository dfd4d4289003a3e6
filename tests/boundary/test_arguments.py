"""Public functions reject arguments of a wrong type by name, and suggest what was meant."""

import inspect
import itertools
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest

import airpuck
from airpuck.boundary.errors import InputError
from airpuck.boundary.settings import fits

M3 = airpuck.read_model("paper:M3")
FUNCTIONS = {
    name: getattr(airpuck, name)
    for name in dir(airpuck)
    if inspect.isfunction(getattr(airpuck, name))
}
#: Values that no argument accepts.
STRANGE = (object(), 1j, {1, 2}, NotImplemented)


@pytest.mark.parametrize("name", FUNCTIONS)
def test_an_argument_of_a_wrong_type_is_named(name):
    function = FUNCTIONS[name]
    parameters = inspect.signature(function).parameters.values()
    for parameter, strange in itertools.product(parameters, STRANGE):
        required = [
            p.name
            for p in inspect.signature(function).parameters.values()
            if p.default is p.empty and p.name != parameter.name
        ]
        with pytest.raises(InputError) as error:
            function(**{parameter.name: strange}, **dict.fromkeys(required, strange))
        assert error.value.field in {parameter.name, *required}, parameter
        assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (partial(airpuck.evaluate, M3, None), "trajectory: must be Trajectory, not None"),
        (
            partial(airpuck.tracking_study, [M3], M3, controller="papr"),
            "controller: must be 'paper' or 'full', not 'papr'; did you mean 'paper'?",
        ),
        (partial(airpuck.compare, [M3, "M3"], None), "Model, but contains 'M3'"),
        (partial(airpuck.read_vehicle, 5), "path: must be a text or a path, not 5"),
        (partial(airpuck.Twin, M3, pose=(0, 0)), r"sequence of 3 numbers, not \(0, 0\)"),
        (partial(airpuck.excite, M3, margin=np.nan), "margin: must be "),
        (partial(airpuck.Span, np.nan, 1.0, "gap"), "start: must be a finite number, not nan"),
        (partial(airpuck.LevenbergMarquardt, tolerance=np.inf), "tolerance: must be a finite"),
        (partial(airpuck.SetPoint, 0, 0, np.nan), "yaw: must be a finite number, not nan"),
        (
            partial(M3.simulate, np.zeros(12), np.full((3, 6), 1500.0)),
            "commands: go from 1500 to 1500, but motors take 0 to 1",
        ),
        (
            partial(airpuck.track, M3, airpuck.SetPoint(5, 0, 0), 0.1),
            r"setpoint: \(5, 0\) is outside the table, ±1.1 m by ±0.55 m",
        ),
        (
            partial(airpuck.track, M3, airpuck.SetPoint(0, 0, 90), 0.1),
            "setpoint: yaw = 90 rad is 14 turns; is it in degrees",
        ),
        (
            partial(
                airpuck.Recording.from_arrays, [0, 2, 1], np.zeros((3, 3)), [0, 1], np.ones((2, 6))
            ),
            "time: must not decrease",
        ),
    ],
)
def test_messages_name_the_wrong_argument(call, words):
    with pytest.raises(Exception, match=words) as error:
        call()
    # In tests, the checked signature of a constructor may reject the value first.
    assert isinstance(error.value, InputError)


@pytest.mark.parametrize("wrong", [np.nan, np.inf])
def test_numbers_are_finite(wrong, short):
    bands = partial(airpuck.prediction_bands, M3, short)
    gain = np.zeros((3, 6))
    gain[1, 2] = wrong
    track = partial(airpuck.track, M3, airpuck.SetPoint(0.1, 0, 0), 0.1)
    for call, field in (
        (partial(bands, horizon=wrong), "horizon"),
        (partial(track, gain=gain), "gain"),
    ):
        with pytest.raises(InputError, match=f"{field}: must be finite numbers"):
            call()
    for name in ("time", "state", "acceleration", "command_time", "command"):
        damaged = np.array(getattr(short, name), dtype=float)
        damaged.flat[-1] = wrong
        with pytest.raises(InputError, match=f"{name}: must be finite numbers"):
            replace(short, **{name: damaged})


@pytest.fixture(scope="module")
def short():
    time = np.arange(50) / 200
    names = M3.vehicle.propeller_names
    return airpuck.Trajectory(
        time, np.zeros((50, 6)), np.zeros((50, 3)), time, np.zeros((50, 6)), names
    )


def test_types_imported_for_type_checkers_only_are_not_checked():
    assert fits(5, Any) and fits("five", Any)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda: airpuck.identify(methd="lm"),
            r"identify\(\) has no argument 'methd'; did you mean 'method'\?",
        ),
        (
            lambda: airpuck.Goal(0.0, 0.0, yaww=1.0),
            r"Goal\(\) has no argument 'yaww'; did you mean 'yaw'\?",
        ),
        (lambda: airpuck.identify(), r"identify\(\) is missing .*'recordings'"),
        (lambda: airpuck.Goal(0, 0, 0, (0, 0, 0), "exact", 1), r"Goal\(\): too many"),
    ],
)
def test_a_wrong_call_names_the_function_and_suggests_an_argument(call, message):
    with pytest.raises(TypeError, match=message):
        call()
