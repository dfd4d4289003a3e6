"""Free-flyers with on/off thrusters: identified back from a twin, and steered to a set point.

    OPENBLAS_NUM_THREADS=1 python studies/on_off_thrusters.py identify atmos --flights 2
    OPENBLAS_NUM_THREADS=1 python studies/on_off_thrusters.py steer atmos

identify: each twin has forces up to 10 % off nominal, 5 % more inertia, 7 ms more delay, a lag of
1 to 9 ms instead of 5 ms, and an offset centre of mass. Flights that --out lists already are not
flown again; a summary of the file follows. steer: from rest, 1.17 m and 1.5 rad to a set point,
with LQR and with predictive control. On-time is the propellant: the sum over all thrusters of the
time open.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from airpuck.control.reference import SetPoint
from airpuck.control.tuning import Tuning, read_tuning
from airpuck.craft.vehicle import read_vehicle
from airpuck.identification.fit import identify
from airpuck.identification.settings import Loss, Preparation
from airpuck.model.model_file import Model, nominal_model
from airpuck.preprocessing.pipeline import preprocess
from airpuck.twin.experiments import excite, track
from airpuck.twin.settings import TwinSettings, read_twin_settings

FOLDER = Path(__file__).parents[1] / "examples" / "free_flyers"
#: Length of a prediction, and time between the starts of predictions [s]; by craft. Starts must see
#: pulses at all phases, so the time between them is no multiple of the PWM's period.
TIMES = {"atmos": (0.5, 0.19), "freeflyer2": (2.0, 0.23)}
#: Range of true lags, relative to the vehicle file's guess.
LAGS = (0.2, 1.8)
#: Time between changes of the signals [s].
HOLD = 0.5
GOAL, START = (0.5, 0.3, 1.5), (-0.5, -0.3, 0.0)
#: Errors within which a set point counts as reached [m, rad].
REACHED = 0.02, 0.05


def prepared(craft: str) -> tuple[Model, TwinSettings, Tuning]:
    """Return a craft's nominal model, its table and its tuning."""
    model = nominal_model(read_vehicle(FOLDER / f"{craft}.toml"))
    tuning = read_tuning(FOLDER / f"{craft}_tuning.toml")
    return model, read_twin_settings(FOLDER / "twin.toml"), tuning


def identified(craft: str, seeds: range, duration: float, out: Path | None) -> None:
    """Identify twins; print errors of parameters and how often intervals hold."""
    rows = {} if out is None or not out.exists() else _rows(out)
    for seed in (seed for seed in seeds if seed not in rows):
        rows[seed] = one_flight(craft, seed, duration)
        if out is not None:
            with out.open("a") as file:
                file.write(",".join(f"{value:.6g}" for value in (seed, *rows[seed])) + "\n")
    worst, rms, force, late, together, inertia, inside, told, held = np.array(list(rows.values())).T
    print(
        f"{craft}, {len(rows)} flights: forces {_rms(rms):.2f} % rms, {worst.max():.2f} % at most; "
        f"delay {_rms(late):.1f} ms rms, {np.abs(late).max():.1f} ms at most; delay and lag "
        f"together {_rms(together):.2f} and {np.abs(together).max():.2f} ms; inertia "
        f"{_rms(inertia):.2f} %; forces in their intervals {int(force.sum())}; intervals hold "
        f"{int(inside.sum())} of {int(told.sum())}; lag held in {int(held.sum())} flights"
    )


def _rows(out: Path) -> dict[int, tuple[float, ...]]:
    """Read the flights of earlier runs, by seed."""
    read = [[float(cell) for cell in line.split(",")] for line in out.read_text().splitlines()]
    return {int(seed): tuple(row) for seed, *row in read}


def one_flight(craft: str, seed: int, duration: float) -> tuple[float, ...]:
    """Fly and identify a twin; return errors, and how many intervals hold."""
    model, settings, tuning = prepared(craft)
    ahead, spacing = TIMES[craft]
    begun, rng = time.perf_counter(), np.random.default_rng(seed)
    nominal = model.parameters
    truth = replace(
        nominal,
        thrust=nominal.thrust * rng.uniform(0.9, 1.1, nominal.thrust.shape),
        inertia=1.05 * nominal.inertia,
        center_of_mass=rng.uniform(-5e-3, 5e-3, 2),
        transport_delay=nominal.transport_delay + 0.007,
        motor_time_constant=nominal.motor_time_constant * rng.uniform(*LAGS),
    )
    flown = excite(
        replace(model, parameters=truth), duration, seed, hold=HOLD, margin=0.3,
        settings=settings, tuning=tuning,
    )  # fmt: skip
    fit = identify(
        preprocess(flown, model.vehicle),
        loss=Loss(prediction_time=ahead, encoder_time=0.1, spacing=spacing),
        preparation=Preparation(faults="keep"),
    )
    found, known = fit.model.parameters, fit.model.uncertainty
    assert known is not None
    error = found.to_vector() - truth.to_vector()
    labels = np.array(found.labels(model.vehicle.propeller_names))
    inside = np.abs(error) <= known.quantile * known.standard_errors
    told = fit.model.free & np.isfinite(known.standard_errors)
    force = 100 * (found.thrust / truth.thrust - 1).ravel()
    late = 1e3 * (found.transport_delay - truth.transport_delay)
    slow = 1e3 * (found.motor_time_constant - truth.motor_time_constant)
    inertia = 100 * (found.inertia / truth.inertia - 1)
    held = not fit.model.free[truth.mask(frozenset({"motor_time_constant"}))].any()
    deviation = 1e3 * known.standard_errors[truth.mask(frozenset({"transport_delay"}))]
    print(
        f"{craft} {seed}: forces {_rms(force):.2f} % rms, {np.abs(force).max():.2f} % at most; "
        f"delay {late:+.1f} ± {deviation[0]:.1f} ms, lag {slow:+.1f} ms{' (held)' * held}, both "
        f"{late + slow:+.2f} ms; inertia {inertia:+.2f} %; outside their intervals: "
        f"{', '.join(labels[~inside & told]) or 'none'} ({time.perf_counter() - begun:.0f} s)",
        flush=True,
    )
    thrusts = inside[: force.size].sum()
    return (
        np.abs(force).max(), _rms(force), thrusts, late, late + slow, inertia,
        (inside & told).sum(), told.sum(), held,
    )  # fmt: skip


def steered(craft: str, duration: float) -> None:
    """Fly to a set point with both laws, and print time, error and on-time."""
    model, settings, tuning = prepared(craft)
    for law in ("lqr", "mpc"):
        log = track(
            model, SetPoint(*GOAL), duration, pose=START, settings=settings,
            tuning=tuning.with_law(law),
        )  # fmt: skip
        recording = log.recording
        pose = recording["pose"]
        left = np.abs(pose.values[:, :3] - GOAL)
        away = (np.hypot(left[:, 0], left[:, 1]) > REACHED[0]) | (left[:, 2] > REACHED[1])
        elapsed = 1e-9 * (pose.stamp_ns - pose.stamp_ns[0])
        reached = float(elapsed[np.flatnonzero(away)[-1]])
        held = elapsed > duration - 10
        on_time = log.command * tuning.period_s
        print(
            f"{craft} {law}: reached after {reached:.1f} s with "
            f"{_until(on_time, log.time, reached):.2f} s of on-time; then "
            f"{1e3 * _rms(left[held, :2].ravel()) * np.sqrt(2):.2f} mm, "
            f"{1e3 * _rms(left[held, 2]):.1f} mrad and "
            f"{on_time[log.time > duration - 10].sum() / 10:.3f} s of on-time per second",
            flush=True,
        )


def _until(on_time: Float[np.ndarray, "K n"], times: Float[np.ndarray, " K"], end: float) -> float:
    """Return the on-time of all thrusters until a time [s]."""
    return float(on_time[times <= end].sum())


def _rms(values: Float[np.ndarray, " k"]) -> float:
    """Return the root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def main() -> None:
    """Run the chosen measurement."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("what", choices=("identify", "steer"))
    parser.add_argument("craft", choices=tuple(TIMES))
    parser.add_argument("--flights", type=int, default=1)
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--duration", type=float, default=60.0)
    parser.add_argument("--out", type=Path, help="file of the flights so far; it is continued")
    given = parser.parse_args()
    if given.what == "identify":
        seeds = range(given.first, given.first + given.flights)
        identified(given.craft, seeds, given.duration, given.out)
    else:
        steered(given.craft, given.duration)


if __name__ == "__main__":
    from one_line import run

    run(main)
