"""How long single packets took."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure

from airpuck.identification.packet_delays import PacketDelays
from airpuck.model.model_file import Model
from airpuck.report.style import BLUE, GREY, PAGE_WIDTH, VERMILLION, new_figure, styled, top_legend

#: Standard errors that a bar shows to each side, and bins of the histogram.
_BARS, _BINS = 2.0, 24


@styled
def packet_delay_figure(
    sent: Float[np.ndarray, " K"], delays: PacketDelays, model: Model
) -> Figure:
    """Draw the delay of every packet that is known, over time and as a distribution."""
    figure = new_figure(PAGE_WIDTH, 2.9)
    left, right = figure.subplots(1, 2, sharey=True, width_ratios=[2.6, 1.0])
    mean = 1e3 * model.transport_delay
    delay = mean + 1e3 * delays.deviation
    left.errorbar(
        sent[delays.packet],
        delay,
        _BARS * 1e3 * delays.standard_error,
        ls="",
        marker="o",
        ms=2.6,
        lw=0.7,
        color=BLUE,
    )
    handles = [left.axhline(mean, color=GREY, lw=1.0, label="mean, as learned with the model")]
    left.set(xlabel="time [s]", ylabel="delay of a packet [ms]")
    count, edges, _ = right.hist(delay, _BINS, orientation="horizontal", color=BLUE, alpha=0.55)
    right.axhline(mean, color=GREY, lw=1.0)
    right.set(xlabel="packets", xlim=(0, 1.08 * count.max()))
    if model.delay_jitter is not None and model.delay_jitter.standard_deviation_s > 0:
        spread = 1e3 * model.delay_jitter.standard_deviation_s
        center = mean + 1e3 * float(np.mean(delays.deviation))
        at = np.linspace(edges[0], edges[-1], 200)
        density = np.exp(-(((at - center) / spread) ** 2) / 2) / (spread * np.sqrt(2 * np.pi))
        expected = density * len(delay) * (edges[1] - edges[0])
        label = f"normal, jitter of {spread:.1f} ms"
        handles += right.plot(expected, at, color=VERMILLION, label=label)
    top_legend(figure, handles)
    return figure
