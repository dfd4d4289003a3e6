"""Workloads measured inside a process: each prints its figures as one line of JSON.

python -m benchmarks.workloads step --stride 1
"""

from __future__ import annotations

import argparse
import json
import resource
import statistics
import sys
import time
from pathlib import Path

import numpy as np

TRAINING = "experiments/2023_10_18-11_28_12_sysid_h1_old"
VALIDATION = "experiments/2023_11_22-11_57_44_sysid_h1_old"


#: Program with the computations of `reproduce`, without its figures.
STUDY = f"""
from airpuck import evaluate, identify, load_trajectory
from airpuck.recording.dataset import dataset_folder

folder = dataset_folder()
training, validation = (load_trajectory(folder / n) for n in ({TRAINING!r}, {VALIDATION!r}))
for name in ("M0", "M1", "M2", "M3", "M4"):
    evaluate(identify(training, name).model, validation)
"""


def training(copies: int = 1):
    """Return the paper's training experiment, repeated if requested."""
    from dataclasses import replace

    from airpuck import load_trajectory
    from airpuck.recording.dataset import dataset_folder

    whole = load_trajectory(dataset_folder() / TRAINING)
    # `identify` rejects a recording that is given twice; it compares hashes.
    return [replace(whole, hashes={f"copy {k}": str(k)}) for k in range(copies)]


def problem(stride: int = 7, horizon: int = 50, copies: int = 1, share: float = 1.0):
    """Return the loss of M3 over the training experiment, or a part of its windows."""
    from dataclasses import replace

    from airpuck.craft.vehicle import default_vehicle
    from airpuck.data.windows import make_windows
    from airpuck.estimate.encoder import PaperEncoder
    from airpuck.identification.objective import PredictionLoss

    encoder = PaperEncoder()
    windows = make_windows(training(copies), 40, horizon, stride)
    kept = windows.starts[: max(1, round(share * len(windows)))]
    return PredictionLoss(replace(windows, starts=kept), default_vehicle(), encoder)


def repeated(function, runs: int) -> list[float]:
    """Time a function after one call that compiles it."""
    function()
    times = []
    for _ in range(runs):
        begun = time.perf_counter()
        function()
        times.append(time.perf_counter() - begun)
    return times


def identify_again(options):
    """Identify M3 a second time in one process."""
    from airpuck import identify

    (trajectory,) = training()
    times = repeated(lambda: identify(trajectory, "M3"), options.runs)
    return {"wall_s": statistics.median(times)}


def step(options):
    """Time one Gauss-Newton step: loss, gradient and Hessian; the factorisation is negligible."""
    from airpuck.model.rungs import named_rung

    loss = problem(options.stride, options.horizon, options.copies, options.share)
    # M4 has more free parameters than M3.
    start = named_rung(options.model, degree=options.degree).initial(loss.vehicle)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    times = repeated(lambda: loss.quadratic(start), options.runs)
    after = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return {
        "wall_s": statistics.median(times),
        "windows": len(loss.windows),
        "parameters": int(named_rung(options.model).mask(start).sum()),
        "grown_mib": (after - before) / 1024,
    }


def peer(options):
    """Fit M3 by NumPy and SciPy to the windows of `identify`, and compare the losses."""
    from airpuck.model.rungs import named_rung

    from .peer import Peer

    loss = problem()
    w = loss.windows
    rollouts = Peer(w.time, w.state, w.input, w.starts, 40, 50, loss.vehicle)
    start = named_rung("M3").initial(loss.vehicle)
    ours = loss.quadratic(start).loss
    theirs = float(np.mean(rollouts.residual(start.to_vector()) ** 2))
    if abs(theirs / ours - 1) > 1e-9:
        raise SystemExit(f"another problem: {theirs} is not {ours}")
    once = repeated(lambda: rollouts.residual(start.to_vector()), options.runs)
    begun, used = time.perf_counter(), time.process_time()
    found = rollouts.fit(start.to_vector())
    return {
        "wall_s": time.perf_counter() - begun,
        "cpu_s": time.process_time() - used,
        "rollout_s": statistics.median(once),
        "evaluations": found.nfev,
        "loss": 2 * found.cost / len(found.fun),
    }


def adam(options):
    """Run Adam with the published fits' settings, until it reaches the loss of the peer's fit."""
    sys.path.append(str(Path(__file__).parents[1] / "studies"))
    from adam import Adam

    from airpuck import Loss, identify

    class Reached(Exception):
        pass

    (trajectory,) = training()
    every = Loss(spacing=trajectory.sample_period)
    goal = identify(trajectory, "M3", loss=every).loss
    begun, told = time.perf_counter(), []

    def progress(iteration):
        told.append((iteration.number, iteration.loss, time.perf_counter() - begun))
        if iteration.loss <= goal * (1 + 1e-3):
            raise Reached

    reached = True
    try:
        identify(
            trajectory, "M3", loss=every, method=Adam(epochs=options.epochs), progress=progress
        )
        reached = False
    except Reached:
        pass
    number, last, wall = told[-1]
    return {"wall_s": wall, "epochs": number, "reached": reached, "loss": last, "goal": goal}


def bootstrap(options):
    """Fit M3 to resampled data, starting from the full fit; on a GPU if JAX sees one."""
    import jax

    from airpuck import identify
    from airpuck.identification.bootstrap import resampled_estimates

    fit = identify(training()[0], "M3")
    wall = statistics.median(repeated(lambda: resampled_estimates(fit, options.replicates), 1))
    device = jax.devices()[0].device_kind
    return {"wall_s": wall, "fits_per_s": options.replicates / wall, "device": device}


def bag(options):
    """Write a bag of an excitation flight, repeated up to a length."""
    from airpuck import excite, write_bag
    from airpuck.model.model_file import published_model
    from airpuck.recording.stream import Recording

    flown = excite(published_model("M3"), 60.0, settings=None)
    streams = {name: flown[name] for name in ("pose", "command")}
    repeats = max(1, round(options.seconds / 60))
    lasting = 60_004_166_667  # one frame of 240 Hz more: no stamp twice
    longer = {name: _repeated(stream, repeats, lasting) for name, stream in streams.items()}
    write_bag(Recording(streams=longer, source="benchmark"), Path(options.output))
    return {"seconds": 60 * repeats}


def _repeated(stream, repeats: int, lasting: int):
    """Repeat the same messages, each time later."""
    from dataclasses import fields, replace

    later = lasting * np.repeat(np.arange(repeats), len(stream))
    changed = {}
    for field in fields(stream):
        value = getattr(stream, field.name)
        if isinstance(value, np.ndarray):
            tiled = np.tile(value, (repeats,) + (1,) * (value.ndim - 1))
            changed[field.name] = tiled + later if field.name.endswith("_ns") else tiled
    return replace(stream, **changed)


WORKLOADS = {f.__name__: f for f in (identify_again, step, peer, adam, bootstrap, bag)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("name", choices=WORKLOADS)
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--stride", type=int, default=1)
    parser.add_argument("--horizon", type=int, default=50)
    parser.add_argument("--copies", type=int, default=1, help="recordings")
    parser.add_argument("--share", type=float, default=1.0, help="of the windows")
    parser.add_argument("--model", default="M3")
    parser.add_argument("--degree", type=int)
    parser.add_argument("--epochs", type=int, default=200)
    parser.add_argument("--replicates", type=int, default=100)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--output")
    options = parser.parse_args()
    print(json.dumps(WORKLOADS[options.name](options)))


if __name__ == "__main__":
    main()
