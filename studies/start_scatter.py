"""Dependence of root mean square errors on the start of the windows, and width of intervals.

    AIRPUCK_DATA=... python studies/start_scatter.py

Published M3 on each available real flight, errors after 0.2 s, in windows of 70 samples that do not
overlap and may begin at any of 70 samples. Prints the smallest and largest root mean square
relative to all starts, on the whole flight and on its last 40 %. It also prints the same for every
fourth start, the block bootstrap's interval, and the block length by the rule of Politis and White.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from airpuck import load_trajectory, read_model
from airpuck.data.windows import make_windows
from airpuck.estimate.encoder import PaperEncoder
from airpuck.evaluation.evaluate import hold_for, prediction_errors
from airpuck.evaluation.statistical_tests import rmse_interval
from airpuck.recording.dataset import dataset_folder

#: The paper's window, and the step at which errors count [samples].
LENGTH, ENCODER, STEP = 70, 20, 48


def automatic_block(values: Float[np.ndarray, " W"]) -> float:
    """Choose a block for the mean by Politis and White (2004), corrected in 2009 [samples]."""
    size, values = len(values), values - values.mean()
    quiet_for = max(5, int(np.sqrt(np.log10(size))))
    spectrum = np.fft.rfft(values, 2 * size)
    products = np.fft.irfft(spectrum * spectrum.conj())[:size] / size
    small = np.abs(products / products[0]) < 2 * np.sqrt(np.log10(size) / size)
    runs = np.convolve(small[1:], np.ones(quiet_for), "valid") == quiet_for
    reach = 2 * max(int(runs.argmax()), 1)
    lags = np.arange(-reach, reach + 1)
    taper = np.clip(2 * (1 - np.abs(lags) / reach), 0, 1)
    density = np.sum(taper * products[np.abs(lags)])
    slope = np.sum(taper * np.abs(lags) * products[np.abs(lags)])
    return float((2 * slope**2 / (4 / 3 * density**2)) ** (1 / 3) * size ** (1 / 3))


def rms(errors: Float[np.ndarray, "3 W"]) -> Float[np.ndarray, " 3"]:
    """Return root mean squares."""
    return np.sqrt(np.mean(errors**2, axis=1))


def percent(values: Float[np.ndarray, " 3"], digits: int = 0) -> str:
    """Write x, y, yaw in percent."""
    return " ".join(f"{100 * value:+.{digits}f}" for value in values) + " %"


def main() -> None:
    model = read_model("paper:M3")
    for file in sorted((dataset_folder() / "experiments").glob("*/data.pt")):
        trajectory = load_trajectory(file.parent)
        windows = hold_for(model, make_windows(trajectory, ENCODER, STEP, stride=1))
        errors = prediction_errors(model.dynamics, windows, PaperEncoder(model.indexing))[-1]
        start = windows.time[windows.present]
        period = trajectory.sample_period
        block = [period * automatic_block(row**2) for row in errors]
        print(f"{file.parent.name}: automatic block {' '.join(f'{b:.2f}' for b in block)} s")
        for share in (1.0, 0.4):
            part = slice(round(len(start) * (1 - share)), None)
            errors_here, start_here = errors[:, part], start[part]
            everything = rms(errors_here)
            offsets = np.array([rms(errors_here[:, k::LENGTH]) for k in range(LENGTH)])
            scatter = offsets / everything - 1
            thinned = rms(errors_here[:, ::4]) / everything - 1
            low, high = rmse_interval(errors_here, start_here) / everything - 1
            thin_low, thin_high = (
                rmse_interval(errors_here[:, ::4], start_here[::4]) / everything - 1
            )
            print(
                f"  last {100 * share:.0f} %, {len(start_here) // LENGTH} windows: "
                f"{percent(scatter.min(axis=0))} to {percent(scatter.max(axis=0))}, "
                f"sd {percent(scatter.std(axis=0))}; every fourth start {percent(thinned, 1)}\n"
                f"    95 %: {percent(low)} to {percent(high)}; "
                f"every fourth: {percent(thin_low)} to {percent(thin_high)}",
                flush=True,
            )


if __name__ == "__main__":
    from one_line import run

    run(main)
