"""Long commands that are interrupted, killed, or find the disk full: old outputs stay intact."""

import contextlib
import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from airpuck.boundary.files import load_toml
from airpuck.recording.bag import write_bag
from airpuck.recording.read import read_recording

from ..apparatus.commands import airpuck, airpuck_process, refused
from ..apparatus.disturbed_commands import Server
from ..apparatus.synthetic_flights import record

pytestmark = pytest.mark.slow

#: Command lines by name.
COMMANDS = {
    "preprocess": "preprocess bag -o out/trajectory.npz --json out/figures.json",
    "identify": "identify bag --model M0 -o out/model.toml --json out/figures.json",
    "identify with a page": "identify bag -o out/model.toml --report out --json out/figures.json",
    "faults": "faults bag -o out --model paper:M3",
    "resid": "resid paper:M3 bag -o out",
    "excite": "excite --duration 1 -o out/bag",
    "track": "track paper:M3 --dwell 0.3 -o out",
    "animate": "animate bag --span 0 0.1 -o out/flight.gif",
    "design": "design --duration 6 -o out/plan.toml --figure out/errors.png",
    "demo": "demo -o out",
    "reproduce": "reproduce -o out",
}
#: One command of each kind of output: files, a model, a page, a bag. Others run with the studies.
QUICK = ("preprocess", "identify", "faults", "excite")
#: A bag of an excitation must be new.
NEW = ("excite",)


@pytest.fixture(scope="module")
def server():
    server = Server()
    yield server
    server.close()


@pytest.fixture(scope="module")
def bag(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("bags") / "bag"
    write_bag(record(duration=6.0, noise=1e-4), folder)
    return folder


@pytest.fixture
def folder(tmp_path, bag) -> Path:
    """Return the folder in which a command runs."""
    (tmp_path / "bag").symlink_to(bag)
    return tmp_path


def check_whole(path: Path) -> None:
    """Read a whole file with the package's own reader."""
    match path.suffix:
        case ".json":
            json.loads(path.read_text())
        case ".toml":
            assert load_toml(path)
        case ".npz":
            with np.load(path) as archive:
                assert all(len(archive[name].shape) >= 0 for name in archive)
        case ".html" | ".svg":
            assert path.read_text().rstrip().endswith(("</html>", "</svg>"))
        case ".png" | ".gif":
            with Image.open(path) as image:
                for frame in range(getattr(image, "n_frames", 1)):
                    image.seek(frame)
                    image.load()
        case ".pdf":
            assert path.read_bytes().rstrip().endswith(b"%%EOF")
        case ".mcap":
            assert len(read_recording(path.parent)["pose"])
        case ".yaml" | "":
            pass
        case other:
            raise AssertionError(f"no check reads {other}")


def files(folder: Path) -> dict[str, bytes]:
    """Return every file of an output, by name."""
    found = (path for path in folder.rglob("*") if path.is_file())
    return {str(path.relative_to(folder)): path.read_bytes() for path in found}


def temporary(names) -> list[str]:
    return [name for name in names if any(part.startswith(".") for part in Path(name).parts)]


def put_old(out: Path, written: dict[str, bytes]) -> dict[str, bytes]:
    """Put files of an older run where a command writes."""
    for name, content in written.items():
        path = out / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(b"old" if content else b"")
    return files(out)


@pytest.fixture(scope="module")
def usual(server, bag, tmp_path_factory):
    """Output and duration of each undisturbed command."""
    known = {}

    def run(name: str):
        if name not in known:
            folder = tmp_path_factory.mktemp(name.split()[0])
            (folder / "bag").symlink_to(bag)
            ended = server.run(*COMMANDS[name].split(), folder=folder)
            assert ended.status == 0, ended.error
            written = files(folder / "out")
            assert written
            for path in (folder / "out").rglob("*"):
                check_whole(path) if path.is_file() else None
            known[name] = written, ended.wall_s
        return known[name]

    return run


def prepare(name: str, folder: Path, written) -> dict[str, bytes]:
    """Put old outputs where a command may replace them."""
    if name in NEW:
        return {}
    # A demo replaces only what a demo wrote.
    return put_old(folder / "out", written)


def check_after(name: str, folder: Path, old, ended, number: int, *, words: str = "") -> None:
    """Check the outputs that a disturbed command left."""
    left = files(folder / "out")
    assert "Traceback" not in ended.error and "Exception" not in ended.error, ended.error
    if number != signal.SIGKILL:
        assert not temporary(left)
        told = [line for line in ended.error.splitlines() if line.startswith("airpuck: ")]
        assert len(told) == 1 and words in told[0], ended.error
        assert ended.error.rstrip().endswith(told[0])
    for file, content in left.items():
        if content != old.get(file) and not temporary([file]):
            check_whole(folder / "out" / file)
    assert set(old) <= set(left)


#: Ctrl-C is tested with each kind of output; for other signals, one command suffices.
SIGNALS = [(signal.SIGINT, -1), (signal.SIGTERM, 1), (signal.SIGKILL, -1)]


@pytest.mark.parametrize(
    ("name", "number", "write"),
    [
        pytest.param(
            *(name, number, write),
            marks=[pytest.mark.study]
            * (name not in (QUICK if number == signal.SIGINT else QUICK[:1])),
            id=f"{name}-{number.name}",
        )
        for name in COMMANDS
        for number, write in SIGNALS
    ],
)
def test_a_signal_during_writing_leaves_old_files_intact(
    server, usual, folder, name, write, number
):
    written, _ = usual(name)
    old = prepare(name, folder, written)
    ended = server.run(*COMMANDS[name].split(), folder=folder, sent=number, write=write)
    expected = -number if number == signal.SIGKILL else 128 + number
    assert ended.status == expected, ended.error
    check_after(name, folder, old, ended, number, words="interrupted")


@pytest.mark.study
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
@pytest.mark.parametrize("share", [0.2, 0.5, 0.8])
@pytest.mark.parametrize("name", COMMANDS)
def test_a_signal_at_any_time_leaves_old_files_intact(server, usual, folder, name, share, number):
    written, wall_s = usual(name)
    rng = np.random.default_rng([list(COMMANDS).index(name), round(10 * share), number])
    after = wall_s * (share + rng.uniform(-0.1, 0.1))
    old = prepare(name, folder, written)
    ended = server.run(*COMMANDS[name].split(), folder=folder, sent=number, after=after)
    if ended.status == 0:  # it was quicker this time
        return
    expected = -number if number == signal.SIGKILL else 128 + number
    assert ended.status == expected, ended.error
    check_after(name, folder, old, ended, number, words="interrupted")


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=[pytest.mark.study] * (n not in QUICK)) for n in COMMANDS]
)
def test_a_full_disk_is_reported(server, usual, folder, name):
    written, _ = usual(name)
    old = prepare(name, folder, written)
    ended = server.run(*COMMANDS[name].split(), folder=folder, full=True)
    assert ended.status == 2, ended.error
    check_after(name, folder, old, ended, 0, words="cannot be written (File too large)")
    assert {file: left for file, left in files(folder / "out").items() if file in old} == old


def test_standard_output_to_a_full_disk_is_reported():
    command = [sys.executable, "-m", "airpuck", "--version"]
    with Path("/dev/full").open("w") as full:
        process = subprocess.run(
            command, stdout=full, stderr=subprocess.PIPE, text=True, check=False
        )
    assert process.returncode == 2
    assert process.stderr == "airpuck: output: cannot be used (No space left on device)\n"


def test_a_reader_that_closes_early_is_not_a_failure():
    command = f"{sys.executable} -m airpuck --help | true"
    process = subprocess.run(command, shell=True, capture_output=True, text=True, check=False)
    assert process.stderr == ""


def test_output_in_a_limited_encoding_causes_no_failure():
    environment = {**os.environ, "PYTHONIOENCODING": "ascii"}
    done = airpuck_process("present", "paper:M3", env=environment)
    assert done.returncode == 0, done.stderr
    assert "\\xb7" in done.stdout or done.stdout.isascii()


def test_unusual_drawing_settings_cause_no_failure(folder):
    odd = {**os.environ, "MPLBACKEND": "nonsense", "SOURCE_DATE_EPOCH": "yesterday"}
    done = airpuck_process(*COMMANDS["animate"].split(), cwd=folder, env=odd)
    assert done.returncode == 0, done.stderr
    assert "Traceback" not in done.stderr


def test_a_deleted_working_folder_and_a_self_link_are_rejected(tmp_path):
    gone, loop = tmp_path / "gone", tmp_path / "loop.toml"
    gone.mkdir()
    loop.symlink_to(loop)
    with contextlib.chdir(gone):
        gone.rmdir()
        words = ["present", "paper:M3"]
        code = f"import sys; sys.argv[1:] = {words}; from airpuck.cli import main; main()"
        done = subprocess.run(
            [sys.executable, "-c", code], capture_output=True, text=True, check=False
        )
    assert done.returncode == 2, done.stderr
    assert done.stderr == "airpuck: the working folder was deleted; change to another one\n"
    done = airpuck("plan", "--from", 0, 0, 0, "--to", 0.1, 0, 0, "-o", loop)
    assert refused(done, "loop.toml", "Too many levels of symbolic links")
