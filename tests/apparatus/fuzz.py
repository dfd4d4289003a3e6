"""Damaged files of every kind, read in a process with little memory and time for each.

    python -m tests.apparatus.fuzz [--cases N] [--first SEED] [KIND ...]

A case passes if the file is read, or rejected by an `InputError` in one printable line, and nothing
is written. All other exceptions, crashes of the process, timeouts, and files left behind are
failures. Each is reported with kind and seed, which reproduce the file.
"""

import argparse
import contextlib
import functools
import json
import os
import random
import resource
import shutil
import signal
import sqlite3
import subprocess
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib import resources
from pathlib import Path
from typing import Any

from mcap.writer import CompressionType

import airpuck.cli
import airpuck.judgement.verdict  # noqa: F401 # slow to import on a busy machine
from airpuck import InputError, PoseMapping, Recording, RecordingMapping, Span, TwinSettings
from airpuck.campaigns.campaign import read_spec
from airpuck.control.reference import read_setpoints
from airpuck.control.settings import read_excitation_plan
from airpuck.control.tuning import read_tuning
from airpuck.craft.vehicle import read_vehicle
from airpuck.data.trajectory_file import read_trajectory
from airpuck.export.holohover import params_yaml
from airpuck.model.model_file import read_model
from airpuck.recording.cdr import decode, flatten
from airpuck.recording.csv_folder import write_csv
from airpuck.recording.mapping import read_mapping
from airpuck.recording.message import parse_definition
from airpuck.recording.read import read_recording
from airpuck.recording.torch_archive import read_authors_experiment
from airpuck.twin.settings import read_twin_settings
from tests.apparatus import bags
from tests.apparatus import mutations as m
from tests.apparatus.commands import airpuck as run_airpuck
from tests.apparatus.torch_archives import archive
from tests.recording import test_motion_capture_export as exports
from tests.recording import test_topic_stream

_EXAMPLES = Path(__file__).parents[2] / "examples"
MEMORY = 2 * 2**30
SECONDS = 10
#: One case out of this number also goes through the command line.
CLI_EVERY = 50


@dataclass(frozen=True)
class Kind:
    """One kind of file: an intact one, how it is damaged, how it is read."""

    make: Callable[[Path], Path]
    damage: m.Mutate
    read: Callable[[Path], Any]
    #: Command line before the file's name.
    command: tuple[str, ...] = ()


@dataclass
class Tally:
    """Results of the cases."""

    outcomes: Counter[str] = field(default_factory=Counter)
    failures: list[str] = field(default_factory=list)
    seconds: float = 0.0
    slowest_s: float = 0.0
    peak_mb: float = 0.0
    #: The last case, and whether it is the last of all.
    seed: int | None = None
    current: bool = False


class TooSlow(BaseException):
    """A case timed out; `except Exception` does not catch this."""


def _mcap(folder: Path, topics: Mapping[str, bags.Topic], **options: Any) -> Path:
    return bags.write_mcap(
        folder / "a.mcap",
        dict(topics),
        compression=CompressionType.NONE,
        chunk_size=3000,
        **options,
    )


def _bag(folder: Path, **options: Any) -> Path:
    topics = bags.foreign_topics().items()
    short = {name: (kind, text, messages[:30]) for name, (kind, text, messages) in topics}
    return _mcap(folder, short, **options)


def _bodies(folder: Path) -> Path:
    name = "/drone/control"
    topics = {
        "/bodies": test_topic_stream.make("motion_capture_tracking_interfaces/msg/NamedPoseArray")
    }
    return _mcap(folder, topics | {name: bags.foreign_topics()[name]})


def _sqlite(folder: Path, name: str = "bag.db3") -> Path:
    bags.rosbags_folder(folder / "bag")
    return folder / "bag" / name


def _wal(folder: Path) -> Path:
    """Return the write-ahead log beside a bag, as a killed recorder leaves both."""
    whole, live = _sqlite(folder), folder / "live.db3"
    with contextlib.closing(sqlite3.connect(whole)) as source:
        statements = [text for text in source.iterdump() if text.startswith(("CREATE", "INSERT"))]
    shutil.rmtree(whole.parent)
    whole.parent.mkdir()
    with contextlib.closing(sqlite3.connect(live, isolation_level=None)) as database:
        database.execute("PRAGMA journal_mode = WAL")
        for number, statement in enumerate(statements):
            database.execute(statement)
            if number == len(statements) - 8:
                database.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        for suffix in ("", "-wal"):
            shutil.copyfile(f"{live}{suffix}", f"{whole}{suffix}")
    live.unlink()
    return Path(f"{whole}-wal")


def _vicon(folder: Path) -> Path:
    _written(folder, "motors.csv", exports.COMMANDS)
    return _written(folder, "take.csv", exports.vicon(bodies=("puck", "wand")))


def _read_vicon(path: Path) -> None:
    pose = PoseMapping(body="puck", file="take.csv")
    read_recording(path.parent, mapping=RecordingMapping(pose=pose, command=exports.COMMAND))


#: What a craft of another lab is mapped to, for one command of each kind.
_LABS_TOPICS = {
    "ff_msgs duties and wheel": 'pose = "/pose"\ncommand = "/duties"\nwheels = "/wheel"',
    "ff_msgs switches": 'pose = "/pose"\ncommand = "/switches"',
    "px4_msgs motors": 'pose = "/pose"\ncommand = "/motors"',
}


def _labs_kind(scratch: Path, topics: str) -> Kind:
    """Damaged bags of ROS 1 with other labs' messages, read by a mapping."""
    mapping, vehicle = scratch / "labs.toml", _EXAMPLES / "free_flyers/freeflyer2.toml"

    def make(folder: Path) -> Path:
        mapping.write_text(f"[topics]\n{topics}\n")
        return bags.labs_bag(folder / "a.bag")

    def read(path: Path) -> None:
        read_recording(path, mapping=read_mapping(mapping))

    command = (*_PREPROCESS, "--mapping", str(mapping), "--vehicle", str(vehicle))
    return Kind(make, m.ros1_damaged, read, command)


def _pt(folder: Path) -> Path:
    return archive(folder / "data.pt")


def _npz(folder: Path) -> Path:
    whole = replace(read_authors_experiment(_pt(folder)), excluded=(Span(0.01, 0.02, "gap"),))
    return _saved(whole, folder / "a.npz")


def _csv(folder: Path, encoding: str = "utf-8") -> Path:
    columns = ("x_m", "y_m", "yaw_rad")
    streams = {
        "pose": bags.stream(20, 240, columns, 1),
        "command": bags.stream(10, 100, bags.SIX, 2),
    }
    write_csv(Recording(streams, "made up"), folder / "csv")
    path = folder / "csv" / "optitrack_drone_pose.csv"
    path.write_text(path.read_text(), encoding=encoding)
    return path


def _written(folder: Path, name: str, text: str) -> Path:
    (folder / name).write_text(text, encoding="utf-8")
    return folder / name


def _saved(content: Any, path: Path) -> Path:
    content.save(path)
    return path


def _params(folder: Path) -> Path:
    parameters = read_model("paper:M3").parameters
    values = {
        "signal2thrust": parameters.thrust.tolist(),
        "mass": 0.1377,
        "inertia": float(parameters.inertia),
        "tau": float(parameters.motor_time_constant),
        "motor_angle_offset": float(parameters.angle_offset),
        "center_of_mass": [*parameters.center_of_mass.tolist(), 0.0],
        "configuration_matrix": [[0.0] * 6] * 3,
    }
    learned = "signal2thrust inertia tau motor_angle_offset center_of_mass configuration_matrix"
    switches = {f"learn_{name}": name != "configuration_matrix" for name in learned.split()}
    content = {"model": switches, "model_params": values}
    return _written(folder, "params.json", json.dumps(content, indent=1))


def _controllers_params(folder: Path) -> Path:
    return _written(folder, "holohover_params.yaml", params_yaml(read_model("paper:M3")))


def _definition(folder: Path) -> Path:
    extra = "float64[36] covariance\nstring[] names\nint32 KIND=3\nfloat64[<=5] some\n"
    text = bags.POSE_TEXT.replace("\n", "\n" + extra, 1) + bags.COMMAND_TEXT[40:]
    return _written(folder, "a.msg", text)


_IDL = """module a { module msg {
  const long SIZE = 3;
  @verbatim (language="comment", text="What it holds.")
  struct A { double x; string names; sequence<double, 5> some; double three[3];
    @default (value=0.5) float y; };
}; };
"""


def _read_definition(path: Path, *, idl: bool = False) -> None:
    """Decode a message by the definition in a file."""
    try:
        text = path.read_bytes().decode(errors="replace")
        types = parse_definition("a/msg/A", text, idl=idl)
        fields = flatten(types, "a/msg/A")
        paths = [name for name, code in fields if code.startswith("<")]
    except ValueError as error:
        # The reader of bags adds file and topic.
        raise InputError(str(error), file=path) from error
    # Zeros fit some definitions only.
    with contextlib.suppress(ValueError):
        decode([b"\0\1\0\0" + bytes(400), b"\0\1\0\0" + bytes(300)], types, "a/msg/A", paths)


def _read_parent(path: Path) -> Any:
    return read_recording(path.parent)


_MAPPING = """[topics]
pose = "/mocap/pose"
command = "/craft/motors"
[pose]
position = ["x", "y"]
orientation = "yaw"
[command]
values = ["a", "b"]
"""
_SETPOINTS = "".join(
    f"[[setpoints]]\nat_s = {at}\nx_m = {x}\ny_m = 0.1\nyaw_rad = 1.0\n"
    for at, x in ((0.0, 0.5), (2.0, -0.5))
)
_PLAN = "amplitude = [0.6, 0.7, 0.8]\nduration_s = 20.0\nhold_s = 0.1\n"
_CAMPAIGN = """kind = "tracking"
seeds = 2
[base]
model = "paper:M3"
truth = "paper:M4"
[base.twin.radio]
loss = 0.1
[grid]
controller = ["paper", "full"]
twin.radio.jitter_s = [0.0, 0.01, 0.03]
"""
_PREPROCESS = ("preprocess", "-o", "out.npz")


def kinds(scratch: Path) -> dict[str, Kind]:
    """Return every kind of file by name."""
    sqlite = functools.partial(m.sqlite_damaged, scratch=scratch / "scratch.db3")
    text = m.text_damaged

    def toml(content: str, read: Callable[[Path], Any]) -> Kind:
        return Kind(lambda folder: _written(folder, "a.toml", content), text, read)

    def packaged(name: str, read: Callable[[Path], Any]) -> Kind:
        return toml((resources.files("airpuck") / "packaged" / name).read_text("utf-8"), read)

    return {
        "npz": Kind(_npz, m.archive_damaged, read_trajectory, _PREPROCESS),
        "data.pt": Kind(_pt, m.archive_damaged, read_authors_experiment, _PREPROCESS),
        "mcap": Kind(_bag, m.mcap_damaged, read_recording, _PREPROCESS),
        "mcap without chunks": Kind(
            functools.partial(_bag, use_chunking=False), m.bytes_damaged, read_recording
        ),
        "ROS 1 bag": Kind(
            lambda folder: bags.ros1_bag(folder / "a.bag", n_poses=60, n_commands=25),
            m.bytes_damaged,
            read_recording,
            _PREPROCESS,
        ),
        **{f"ROS 1, {name}": _labs_kind(scratch, topics) for name, topics in _LABS_TOPICS.items()},
        "PX4 log": Kind(
            lambda folder: bags.ulog(folder / "a.ulg"), m.bytes_damaged, read_recording
        ),
        "db3": Kind(_sqlite, sqlite, read_recording, _PREPROCESS),
        "db3-wal": Kind(_wal, m.bytes_damaged, _read_parent),
        "bodies": Kind(
            _bodies,
            m.mcap_damaged,
            functools.partial(read_recording, mapping=test_topic_stream.mapping("craft")),
        ),
        "Vicon export": Kind(_vicon, m.table_damaged, _read_vicon),
        "metadata.yaml": Kind(functools.partial(_sqlite, name="metadata.yaml"), text, _read_parent),
        "csv": Kind(_csv, m.table_damaged, _read_parent),
        "UTF-16": Kind(functools.partial(_csv, encoding="utf-16"), m.bytes_damaged, _read_parent),
        "definition": Kind(_definition, text, _read_definition),
        "IDL": Kind(
            functools.partial(_written, name="a.idl", text=_IDL),
            text,
            functools.partial(_read_definition, idl=True),
        ),
        "params.json": Kind(_params, text, read_model, ("present",)),
        "params.yaml": Kind(_controllers_params, text, read_model, ("present",)),
        "model": Kind(
            lambda folder: _saved(read_model("paper:M3"), folder / "model.toml"),
            text,
            read_model,
            ("present",),
        ),
        "vehicle": packaged("holohover.toml", read_vehicle),
        "tuning": packaged("tuning.toml", read_tuning),
        "twin": Kind(
            lambda folder: _saved(TwinSettings(), folder / "twin.toml"), text, read_twin_settings
        ),
        "mapping": toml(_MAPPING, read_mapping),
        "plan": toml(_PLAN, read_excitation_plan),
        "campaign": toml(_CAMPAIGN, read_spec),
        "set points": toml(_SETPOINTS, read_setpoints),
    }


def _too_slow(*_: object) -> None:
    raise TooSlow(f"takes longer than {SECONDS} s")


def _refusal(error: Exception, path: Path) -> str:
    """Return what is wrong with the rejection of a file; empty if it is right."""
    message = str(error)
    if not message.isprintable():
        return f"the message is not one printable line: {message!r}"
    if path.name not in message and str(path.parent) not in message:
        return f"the message does not name the file: {message}"
    return ""


def run_case(kind: Kind, path: Path, *, cli: bool) -> tuple[str, str]:
    """Read one file; return the outcome, and what is wrong with it; empty if it is right."""
    before = sorted(path.parent.iterdir())
    # Limit processor time, since other tests may run at the same time; and wall time for deadlocks.
    signal.setitimer(signal.ITIMER_PROF, SECONDS)
    signal.alarm(10 * SECONDS)
    try:
        if cli and kind.command:
            done = run_airpuck(*kind.command, path, cwd=path.parent)
            if done.returncode == 0:
                (path.parent / "out.npz").unlink(missing_ok=True)
            outcome = ("read", "?", "refused")[done.returncode]
            wrong = done.returncode == 2 and len(done.stderr.splitlines()) != 1
            problem = f"status {done.returncode}: {done.stderr[:300]!r}"
            problem = problem if wrong or outcome == "?" else ""
        else:
            kind.read(path)
            outcome, problem = "read", ""
    except InputError as error:
        outcome, problem = "refused", _refusal(error, path)
    except (Exception, TooSlow) as error:
        outcome, problem = "failed", "".join(traceback.format_exception(error))[-2000:]
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.alarm(0)
    if not problem and sorted(path.parent.iterdir()) != before:
        problem = "something was written"
    return ("failed" if problem else outcome), problem


def work(names: Sequence[str], first: int, count: int, done: int) -> None:
    """Run cases here, reporting each before and after; skip the first `done` of the first kind."""
    warnings.simplefilter("ignore")
    resource.setrlimit(resource.RLIMIT_DATA, (MEMORY, MEMORY))
    signal.signal(signal.SIGPROF, _too_slow)
    signal.signal(signal.SIGALRM, _too_slow)
    for name in names:
        with tempfile.TemporaryDirectory() as folder:
            tempfile.tempdir = folder
            here = Path(folder) / "here"
            here.mkdir()
            kind = kinds(Path(folder))[name]
            path = kind.make(here)
            intact = path.read_bytes()
            kind.read(path)
            for seed in range(first + done, first + count):
                _report(kind=name, seed=seed)
                path.write_bytes(kind.damage(intact, random.Random(f"{name} {seed}")))
                start = time.process_time()
                outcome, problem = run_case(kind, path, cli=seed % CLI_EVERY == CLI_EVERY - 1)
                seconds = time.process_time() - start
                peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
                _report(outcome=outcome, problem=problem, seconds=seconds, peak_mb=peak)
        tempfile.tempdir, done = None, 0


def _report(**content: Any) -> None:
    print(json.dumps(content), flush=True)


def fuzz(names: Sequence[str], count: int, first: int = 0) -> dict[str, Tally]:
    """Run the cases of each kind in a separate process; start another one if it dies."""
    tallies = {name: Tally() for name in names}
    left, done = list(names), 0
    while left:
        command = [sys.executable, "-m", "tests.apparatus.fuzz", *left, "--work"]
        command += ["--first", str(first), "--cases", str(count), "--done", str(done)]
        with subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        ) as process:
            assert process.stdout and process.stderr
            for line in process.stdout:
                if line.startswith("{"):
                    _take_note(json.loads(line), tallies)
            said = process.stderr.read()
        if process.returncode == 0:
            break
        # It died in the last case that it reported.
        name = next((name for name in reversed(left) if tallies[name].current), None)
        if name is None:
            raise RuntimeError(f"the process of {left[0]} died before its first case: {said}")
        tally = tallies[name]
        seed, tally.current = tally.seed or 0, False
        tally.outcomes["failed"] += 1
        tally.failures.append(f"{name} {seed}: died ({process.returncode}): {said[-1000:]}")
        left, done = left[left.index(name) :], seed + 1 - first
        if done >= count:
            left, done = left[1:], 0
    return tallies


def _take_note(line: dict[str, Any], tallies: dict[str, Tally]) -> None:
    """Add a report of the working process."""
    if "seed" in line:
        for tally in tallies.values():
            tally.current = False
        tally = tallies[line["kind"]]
        tally.seed, tally.current = line["seed"], True
        return
    tally = next(tally for tally in tallies.values() if tally.current)
    tally.outcomes[line["outcome"]] += 1
    tally.seconds += line["seconds"]
    tally.slowest_s = max(tally.slowest_s, line["seconds"])
    tally.peak_mb = max(tally.peak_mb, line["peak_mb"])
    if line["problem"]:
        tally.failures.append(f"seed {tally.seed}: {line['problem']}")


def table(tallies: dict[str, Tally]) -> str:
    """Lay the tallies out as a table in Markdown."""
    rows = ["| kind | cases | read | refused | failed | slowest s | all s | peak MB |"]
    rows.append("|---|---|---|---|---|---|---|---|")
    for name, tally in tallies.items():
        counts = [tally.outcomes[key] for key in ("read", "refused", "failed")]
        cells = [name, sum(counts), *counts, f"{tally.slowest_s:.2f}", f"{tally.seconds:.0f}"]
        rows.append("| " + " | ".join(map(str, [*cells, f"{tally.peak_mb:.0f}"])) + " |")
    return "\n".join(rows)


def main() -> None:
    """Run what the command line asks for, and print a row for each kind."""
    parser = argparse.ArgumentParser(description="Read damaged files of every kind.")
    parser.add_argument("kinds", nargs="*", metavar="KIND")
    parser.add_argument("--cases", type=int, default=1000, help="of each kind")
    parser.add_argument("--first", type=int, default=0, help="seed of the first")
    parser.add_argument("--work", action="store_true", help=argparse.SUPPRESS)
    parser.add_argument("--done", type=int, default=0, help=argparse.SUPPRESS)
    given = parser.parse_args()
    names = given.kinds or list(kinds(Path(os.devnull)))
    if given.work:
        work(names, given.first, given.cases, given.done)
        return
    tallies = fuzz(names, given.cases, given.first)
    print(table(tallies))
    failures = [f"{name} {text}" for name, tally in tallies.items() for text in tally.failures]
    print("\n".join(failures[:20]), file=sys.stderr)
    sys.exit(bool(failures))


if __name__ == "__main__":
    main()
