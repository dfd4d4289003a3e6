"""How a model is learned, as a picture (fig:learning_architecture of the paper)."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import FancyArrowPatch, FancyBboxPatch, Rectangle

from airpuck.report.style import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    VERMILLION,
    new_figure,
    styled,
)

#: Heights of the rows of the drawing, from the recording at the top to the optimiser at the bottom.
_RECORDING, _MODEL, _OUTPUT, _ERROR, _LOSS = 5.35, 3.55, 2.45, 1.45, 0.25
#: Horizontal centres: the encoder, the first steps, the last step.
_ENCODER, _STEPS = 2.2, (4.9, 6.55, 9.35)


@styled
def learning_architecture_figure(encoder_length: int = 20, prediction_length: int = 50) -> Figure:
    """Draw the way from a recording to parameters.

    A window of the recording gives the encoder E samples; from the state that it estimates, the
    model predicts T steps under the recorded commands; the differences from the recorded poses,
    over all windows, and the regulariser make the loss that the optimiser lowers by changing the
    parameters θ (green), which encoder, model and regulariser share.
    """
    figure = new_figure(8.6, 5.0)
    axes = figure.add_subplot()
    axes.set_axis_off()
    axes.set(xlim=(0, 11), ylim=(-0.25, 6.5))
    _draw_recording(axes, encoder_length, prediction_length)
    _draw_prediction(axes)
    _draw_loss(axes)
    return figure


def _draw_recording(axes: Axes, encoder_length: int, prediction_length: int) -> None:
    """Draw a stretch of the recording with one window in it."""
    low, high = _RECORDING - 0.35, _RECORDING + 0.5
    present, end = 3.6, 10.15
    for left, right, color, text in (
        (0.9, present, ORANGE, f"encoder window, E = {encoder_length} samples"),
        (present, end, BLUE, f"prediction window, T = {prediction_length} steps"),
    ):
        axes.add_patch(
            Rectangle((left, low), right - left, high - low, facecolor=color, alpha=0.13, lw=0)
        )
        axes.text((left + right) / 2, high + 0.1, text, ha="center", va="bottom", color=BLACK)
    rng = np.random.default_rng(3)
    time = np.linspace(0.3, 10.7, 64)
    pose = 0.16 * np.sin(1.1 * time) + 0.08 * np.sin(2.3 * time + 1)
    axes.plot(time, _RECORDING + 0.22 + pose, "o", color=BLACK, ms=2.2)
    held = 0.3 * rng.integers(0, 4, 13).repeat(5)[: len(time)] / 3
    axes.step(time[: len(held)], low + 0.04 + held * 0.75, where="post", color=GREY, lw=1.1)
    axes.text(0.22, _RECORDING + 0.3, "poses $y$", ha="right", va="center", fontsize=8.5)
    axes.text(0.22, low + 0.12, "commands $u$", ha="right", va="center", fontsize=8.5, color=GREY)
    axes.plot([present] * 2, [low, high], color=BLACK, lw=1.0, ls=(0, (4, 3)))
    axes.text(present + 0.06, low - 0.05, "present $t$", ha="left", va="top", fontsize=8)
    axes.text(0.3, high + 0.42, "recording", ha="left", va="bottom", fontweight="bold")


def _draw_prediction(axes: Axes) -> None:
    """Draw encoder and rollout, with what flows between them."""
    low = _RECORDING - 0.35
    _box(axes, _ENCODER, _MODEL, 1.9, 0.78, "encoder $\\psi_{\\theta}$", ORANGE)
    _arrow(axes, (_ENCODER, low), (_ENCODER, _MODEL + 0.39), BLACK)
    axes.text(
        _ENCODER - 0.1,
        low - 0.42,
        "$y_{t-E+1}$ … $y_t$\n$u_{t-E+1}$ … $u_t$",
        ha="right",
        va="center",
        fontsize=8,
    )
    names = ("t", "t+1", "t+T-1")
    previous = _ENCODER + 0.95
    for x, name in zip(_STEPS, names, strict=True):
        _box(axes, x, _MODEL, 1.0, 0.78, "$f^d_{\\theta}$\nRK4", BLUE)
        _arrow(axes, (x, low), (x, _MODEL + 0.39), GREY)
        axes.text(x + 0.08, low - 0.5, f"$u_{{{name}}}$", ha="left", va="center", color=GREY)
        if x != _STEPS[-1]:
            _arrow(axes, (previous, _MODEL), (x - 0.5, _MODEL), BLACK)
        previous = x + 0.5
    axes.text(4.02, _MODEL + 0.1, "$\\hat z_{t|t}$", ha="center", va="bottom", fontsize=8.5)
    gap = (_STEPS[1] + 0.5, _STEPS[2] - 0.5)
    _arrow(axes, (gap[0], _MODEL), (gap[0] + 0.62, _MODEL), BLACK)
    axes.text(sum(gap) / 2, _MODEL, "…", ha="center", va="center", fontsize=13)
    _arrow(axes, (gap[1] - 0.62, _MODEL), (gap[1], _MODEL), BLACK)

    for step, name in zip(_STEPS, ("t+1", "t+2", "t+T"), strict=True):
        _arrow(axes, (step, _MODEL - 0.39), (step, _OUTPUT + 0.22), BLACK)
        predicted = f"$\\hat y_{{{name}|t}} = C\\,\\hat z_{{{name}|t}}$"
        axes.text(step, _OUTPUT, predicted, ha="center", va="center")
        _arrow(axes, (step, _OUTPUT - 0.22), (step, _ERROR + 0.2), BLACK)
        axes.text(step, _ERROR, "–", ha="center", va="center", fontsize=10)
        axes.plot(step, _ERROR, "o", ms=13, mfc="none", mec=BLACK, mew=1.0)
        axes.text(step + 0.66, _ERROR, f"$y_{{{name}}}$", ha="left", va="center")
        _arrow(axes, (step + 0.6, _ERROR), (step + 0.19, _ERROR), GREY)
        _arrow(axes, (step, _ERROR - 0.2), (step, _LOSS + 0.34), BLACK)


def _draw_loss(axes: Axes) -> None:
    """Draw loss, regulariser, optimiser, and the parameters that go back."""
    left, right = _STEPS[0] - 0.6, _STEPS[2] + 0.6
    _box(
        axes,
        (left + right) / 2,
        _LOSS,
        right - left,
        0.66,
        "loss $\\mathcal{L}(\\theta)$: squares of the weighted errors,\n"
        "mean over steps, channels and windows",
        VERMILLION,
    )
    _box(axes, _ENCODER, _LOSS, 1.9, 0.66, "optimiser\n(LM or Adam)", GREEN)
    _arrow(axes, (left, _LOSS), (_ENCODER + 0.95, _LOSS), BLACK)
    _box(
        axes,
        _ENCODER,
        _ERROR + 0.05,
        1.9,
        0.62,
        "thrust must rise:\nregulariser, constraint",
        VERMILLION,
        size=7.5,
    )
    _arrow(axes, (_ENCODER, _ERROR - 0.26), (_ENCODER, _LOSS + 0.33), BLACK)
    spine = 0.55
    axes.plot([_ENCODER - 0.95, spine], [_LOSS, _LOSS], color=GREEN, lw=1.6)
    axes.plot([spine, spine], [_LOSS, _MODEL], color=GREEN, lw=1.6)
    _arrow(axes, (spine, _MODEL), (_ENCODER - 0.95, _MODEL), GREEN)
    _arrow(axes, (spine, _ERROR + 0.05), (_ENCODER - 0.95, _ERROR + 0.05), GREEN)
    axes.text(
        spine - 0.1, (_LOSS + _MODEL) / 2, "θ", color=GREEN, ha="right", va="center", fontsize=13
    )
    # The model's copies hang on the same parameters.
    rail = _MODEL - 0.72
    axes.plot([spine, _STEPS[2] - 0.32], [rail, rail], color=GREEN, lw=1.2)
    for x in _STEPS:
        _arrow(axes, (x - 0.32, rail), (x - 0.32, _MODEL - 0.39), GREEN)


def _box(
    axes: Axes,
    x: float,
    y: float,
    width: float,
    height: float,
    text: str,
    color: str,
    size: float = 9,
) -> None:
    """Draw a box with a text in it."""
    axes.add_patch(
        FancyBboxPatch(
            (x - width / 2, y - height / 2),
            width,
            height,
            boxstyle="round,pad=0,rounding_size=0.08",
            facecolor=_tint(color),
            edgecolor=color,
            lw=1.2,
            zorder=3,
        )
    )
    axes.text(x, y, text, ha="center", va="center", fontsize=size, zorder=4)


def _tint(color: str) -> tuple[float, ...]:
    """Return a light, opaque version of a colour."""
    return tuple(1 - 0.14 * (1 - channel) for channel in to_rgb(color))


def _arrow(axes: Axes, start: tuple[float, float], end: tuple[float, float], color: str) -> None:
    """Draw an arrow from one point to another."""
    axes.add_patch(
        FancyArrowPatch(
            start,
            end,
            arrowstyle="-|>",
            mutation_scale=9,
            shrinkA=0,
            shrinkB=0,
            color=color,
            lw=1.1,
        )
    )
