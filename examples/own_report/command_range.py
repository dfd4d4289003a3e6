"""A report of your own: a page that shows which part of each motor's range a flight used."""

import numpy as np
from matplotlib.figure import Figure

from airpuck.extend import PageSection, PageTable, Picture, write_page


def command_range(trajectory):
    """Return a section; `write_page` and `fit_report(…, more=[…])` take it."""
    figure = Figure((6.0, 3.0), layout="constrained")
    axes = figure.add_subplot(xlabel="motor", ylabel="command")
    axes.boxplot(trajectory.input)
    quartiles = np.quantile(trajectory.input, [0.25, 0.5, 0.75], axis=0).T
    rows = [[f"{k}", *(f"{u:.2f}" for u in row)] for k, row in enumerate(quartiles, 1)]
    table = PageTable("Quartiles of the commands", ["motor", "25 %", "50 %", "75 %"], rows)
    return PageSection("range", "Range of the commands", [table, Picture("range", figure, "")])


def report(recording, folder):
    """Write the page of a recording that `airpuck.load_trajectory` has read; return its path."""
    lead = f"{recording.duration:.0f} s of flight"
    return write_page(folder, "Command range", lead, [command_range(recording)])
