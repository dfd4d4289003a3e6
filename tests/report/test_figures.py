"""Every figure can be drawn, labels its axes with units, and leaves no global state."""

import io
import re
import subprocess
import sys

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image

from airpuck.craft.vehicle import Vehicle, default_vehicle
from airpuck.physics.thrust import thrust
from airpuck.report.craft import craft_figure
from airpuck.report.fit_figures import parameter_figure, thrust_figure
from airpuck.report.prediction_figures import (
    error_distribution_figure,
    error_timeline_figure,
    horizon_figure,
    path_figure,
    prediction_figure,
)
from airpuck.report.style import RESOLUTION, drawn, propeller_colors, propeller_groups

from ..apparatus.models import model_of

FIGURES = {
    "craft": lambda s, j: craft_figure(s.models[0].vehicle),
    "horizon": lambda s, j: horizon_figure(j.evaluations, j.reference),
    "horizon alone": lambda s, j: horizon_figure(j.evaluations),
    "timeline": lambda s, j: error_timeline_figure(j.evaluations[3], j.faults),
    "timeline without faults": lambda s, j: error_timeline_figure(j.evaluations[3]),
    "distribution": lambda s, j: error_distribution_figure(j.evaluations),
    "prediction": lambda s, j: prediction_figure(j.trajectory, j.evaluations[2:4]),
    "path": lambda s, j: path_figure(j.trajectory, s.models[0].vehicle),
    "thrust": lambda s, j: thrust_figure(s.models[3:], s.training, list(s.reference.values())[3:]),
    "thrust alone": lambda s, j: thrust_figure(s.models[:1]),
    "parameters": lambda s, j: parameter_figure(s.models, s.reference),
}
UNIT = re.compile(r"\[.+\]$")


def unlabelled(figure: Figure) -> list[str]:
    """Return axes of a drawn figure that show numbers without a label and a unit."""
    missing = []
    for number, axes in enumerate(figure.axes):
        if not (axes.axison and axes.get_visible()):
            continue
        for axis in (axes.xaxis, axes.yaxis):
            if not axis.get_visible():
                continue
            texts = [t for t in axis.get_ticklabels() if t.get_visible() and t.get_text()]
            numeric = [t for t in texts if re.fullmatch(r"[−\d.]+", t.get_text())]
            if numeric and not UNIT.search(axis.label.get_text()):
                missing.append(f"axes {number}: {axis.axis_name} {axis.label.get_text()!r}")
    return missing


@pytest.mark.parametrize("name", FIGURES)
def test_all_axes_have_units(study, judged, name):
    before = dict(mpl.rcParams)
    figure = FIGURES[name](study, judged)
    picture = drawn(figure, "png")
    assert dict(mpl.rcParams) == before
    width, height = Image.open(io.BytesIO(picture)).size
    assert 600 <= width <= 1200
    assert 300 <= height <= 900
    assert len(picture) < 250_000
    np.testing.assert_allclose((width, height), RESOLUTION * figure.get_size_inches(), atol=1)
    assert any(axes.axison for axes in figure.axes)
    assert not unlabelled(figure)


def test_drawing_is_repeatable():
    first, again = (thrust_figure([model_of(default_vehicle(), "M3")]) for _ in range(2))
    assert drawn(first, "png") == drawn(again, "png")
    assert drawn(first, "pdf") == drawn(again, "pdf")


def test_drawing_does_not_need_pyplot():
    code = (
        "import sys, airpuck.report.reproduce, airpuck.report.fit_report, airpuck.report.craft; "
        "print('matplotlib.pyplot' in sys.modules)"
    )
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert ran.stdout.strip() == "False"


def test_pairs_share_a_colour_and_single_propellers_have_their_own():
    six = propeller_colors(default_vehicle())
    assert six[0] == six[1] != six[2] == six[3] != six[4] == six[5]
    alone = default_vehicle().model_copy(update={"pairs": ()})
    assert len(set(propeller_colors(alone))) == 6
    assert propeller_groups(alone) == [(k,) for k in range(6)]


@pytest.mark.parametrize("n", [1, 2, 3, 5, 8])
def test_any_number_of_propellers_can_be_drawn(n):
    angles = 2 * np.pi * np.arange(n) / n
    vehicle = Vehicle.model_validate(
        {
            "name": f"{n} propellers",
            "mass_kg": 0.1,
            "propellers": [
                {
                    "name": f"p{k}",
                    "position_m": (0.05 * np.cos(a), 0.05 * np.sin(a)),
                    "direction_deg": np.rad2deg(a) + 90,
                }
                for k, a in enumerate(angles)
            ],
            "nominal": {"thrust_N": (0.5,), "inertia_kg_m2": 3e-4},
        }
    )
    for figure in (craft_figure(vehicle), thrust_figure([model_of(vehicle, "M3")])):
        assert len(drawn(figure, "png")) > 1000


def test_the_thrust_figure_shows_the_curve(study):
    model = study.models[3]
    figure = thrust_figure([model])
    axes = next(a for a in figure.axes if a.get_title("left") == model.vehicle.propeller_names[0])
    x, y = axes.lines[0].get_data()
    expected = thrust(np.asarray(model.parameters.thrust)[:1], np.asarray(x)[None])[0]
    np.testing.assert_allclose(y, expected)
