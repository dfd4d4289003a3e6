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


def ring(count: int, push_N: float = 0.4):
    """Return a model of a craft with propellers on a circle, which push along it alternately."""
    from airpuck import Vehicle
    from airpuck.model.model_file import nominal_model

    angles = np.arange(count) * 360 / count
    turned = np.where(np.arange(count) % 2, 65.0, 295.0)
    propellers = [
        {
            "name": f"m{k + 1}",
            "position_m": (0.06 * np.cos(np.radians(angle)), 0.06 * np.sin(np.radians(angle))),
            "direction_deg": float((angle + turned[k]) % 360),
            # Three that push one way only cannot hold a craft.
            **({"reverse": 0.8} if count < 4 else {}),
        }
        for k, angle in enumerate(angles)
    ]
    nominal = {"thrust_N": (0.0, push_N), "inertia_kg_m2": 6.6e-4}
    nominal |= {"motor_time_constant_s": 0.04, "transport_delay_s": 0.02}
    file = {"name": f"{count} propellers", "mass_kg": 0.2, "radius_m": 0.08, "pairs": []}
    file |= {"command_min": 0.05, "propellers": propellers, "nominal": nominal}
    return nominal_model(Vehicle.model_validate(file))


def propellers(options):
    """Time one Gauss-Newton step on a minute of flight of a craft with some propellers."""
    from airpuck import excite, preprocess
    from airpuck.data.windows import make_windows
    from airpuck.estimate.encoder import PaperEncoder
    from airpuck.identification.objective import PredictionLoss
    from airpuck.model.rungs import named_rung

    vehicle = ring(options.propellers).vehicle
    flown = preprocess(excite(ring(options.propellers), 60.0, settings=None), vehicle)
    loss = PredictionLoss(make_windows([flown], 40, 50, 1), vehicle, PaperEncoder())
    start = named_rung("M3").initial(vehicle)
    wall = statistics.median(repeated(lambda: loss.quadratic(start), options.runs))
    return {"wall_s": wall}


def crowd(options):
    """Time a second of flight of many craft, steered towards the middle by what cameras see."""
    from airpuck import TwinBatch, read_model

    model, size, periods = read_model("paper:M3"), options.craft, 100
    vehicle = model.vehicle
    batch = TwinBatch(model, size, periods * 0.01)
    # A wrench becomes commands by the pseudoinverse, around the middle of their range.
    inverse = np.linalg.pinv(np.asarray(model.dynamics.configuration))
    begins = np.random.default_rng(0).uniform(-0.3, 0.3, (size, 3))

    def fly():
        batch.reset(np.arange(size), begins, range(size))
        before = begins
        for _ in range(periods):
            _, _, seen = batch.measured()
            wanted = -4.0 * seen - 3.0 * (seen - before) / 0.01
            before = seen
            batch.step(np.clip(0.3 + wanted @ inverse.T, vehicle.command_min, 1.0))

    return {"wall_s": statistics.median(repeated(fly, options.runs))}


def new_model(options):
    """Fly a second with models that no program was compiled for, one after another."""
    from airpuck import SetPoint, track
    from airpuck.compute.process import keep_compiled_programs
    from airpuck.model.model_file import read_model
    from airpuck.twin.plant import varied

    keep_compiled_programs()
    seeds, used = np.random.SeedSequence().generate_state(options.runs), []
    for seed in seeds.tolist():
        model, begun = varied(read_model("paper:M3"), 0.1, seed), time.process_time()
        track(model, SetPoint(0.1, 0.0, 0.0), 1.0)
        used.append(time.process_time() - begun)
    return {"first_cpu_s": used[0], "cpu_s": statistics.median(used[1:])}


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


_ALL = (identify_again, step, propellers, crowd, new_model, peer, adam, bootstrap, bag)
WORKLOADS = {f.__name__: f for f in _ALL}


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
    parser.add_argument("--propellers", type=int, default=6)
    parser.add_argument("--craft", type=int, default=100)
    parser.add_argument("--epochs", type=int, default=200)
    parser.add_argument("--replicates", type=int, default=100)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--output")
    options = parser.parse_args()
    print(json.dumps(WORKLOADS[options.name](options)))


if __name__ == "__main__":
    main()
