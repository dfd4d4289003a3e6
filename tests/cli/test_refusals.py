"""Input that the command line rejects, in one line and without writing anything."""

import json
from dataclasses import replace

import numpy as np
import pytest

from airpuck.recording.bag import write_bag

from ..apparatus.commands import airpuck, airpuck_process, ran, refused
from ..apparatus.export_crafts import EXAMPLES
from ..apparatus.synthetic_flights import record

PILOT = f"{EXAMPLES / 'own_pilot' / 'spring.py'}:Spring"
FOUR = str(EXAMPLES / "four_propellers" / "vehicle.toml")


@pytest.fixture(scope="module")
def archive(bag):
    path = bag.parent / "flight.npz"
    assert airpuck("preprocess", bag, "-o", path, "-q").returncode == 0
    return path


def damaged(archive, path, name, change):
    """Copy an archive with one array changed."""
    with np.load(archive) as content:
        arrays = dict(content)
    arrays[name] = change(arrays[name])
    np.savez(path, **{key: value for key, value in arrays.items() if value is not None})
    return path


def with_nan(values):
    values = values.copy()
    values[10] = np.nan
    return values


@pytest.mark.parametrize(
    ("name", "change", "word"),
    [
        ("state", with_nan, "must be finite"),
        ("t", lambda t: t[::-1], "must increase"),
        ("command", lambda u: 100 * u, "[0, 1]"),
        ("command_time", lambda t: t[::-1], "must not decrease"),
        ("state", lambda x: x.astype(str), "number"),
        ("acceleration", lambda _: None, "is missing"),
    ],
)
def test_a_damaged_trajectory_is_rejected(archive, tmp_path, name, change, word):
    path = damaged(archive, tmp_path / "bad.npz", name, change)
    assert refused(airpuck("evaluate", "paper:M3", path), "bad.npz", name, word)


def test_unequal_lengths_are_rejected_without_the_type_checker(archive, tmp_path):
    path = damaged(archive, tmp_path / "bad.npz", "state", lambda x: x[:-5])
    process = airpuck_process("evaluate", "paper:M3", path)
    assert refused(process, "bad.npz", "state", "shape")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("nonsense",), ("nonsense",)),
        (("evaluate",), ("MODEL",)),
        (("evaluate", "paper:M9", "{bag}"), ("paper:M0",)),
        (("evaluate", "none.toml", "{bag}"), ("none.toml", "no such file")),
        (("evaluate", "paper:M3", "nowhere"), ("nowhere",)),
        (("evaluate", "paper:M3", "{bag}", "--span", "0.9", "0.1"), ("span",)),
        (("evaluate", "paper:M3", "{bag}", "--span", "0", "0.0005"), ("fewer than two samples",)),
        (("evaluate", "paper:M3", "{bag}", "--span", "0", "0.03"), ("70 samples",)),
        (("evaluate", "paper:M3", "{bag}", "--protocol", "nonsense"), ("--protocol",)),
        (("evaluate", "paper:M3", "{bag}", "--wrong"), ("--wrong",)),
        (("compare", "paper:M3"), ("RECORDING",)),
        (("preprocess", "{bag}", "-o", "x.txt"), (".npz",)),
        (("preprocess", "{bag}", "-o", "t.npz", "--delay", "-1"), ("delay",)),
        (("preprocess", "{bag}", "-o", "t.npz", "--delay", "nan"), ("delay",)),
        (("preprocess", "{archive}", "-o", "t.npz", "--delay", "0.02"), ("delay", "already")),
        (("identify",), ("RECORDING",)),
        (("identify", "{bag}", "--model", "M77"), ("M77",)),
        (("identify", "{bag}", "--faults", "magic"), ("--faults", "keep")),
        (("identify", "{bag}", "--vehicle", "none.toml"), ("none.toml",)),
        (("identify", "{bag}", "--bootstrap", "3"), ("--bootstrap",)),
        (("identify", "{bag}", "--model", "M4", "--com-frame", "world"), ("no effect on M4",)),
        (("identify", "{bag}", "--seed", "1"), ("--seed: has no effect without --bootstrap",)),
        (("identify", "{bag}", "{bag}", "-o", "m.toml"), ("twice",)),
        (("identify", "{bag}", "-o", "m.toml", "--json", "m.toml"), ("--json", "m.toml")),
        (("identify", "{bag}", "-o", "m.toml", "--json", "/proc/x.json"), ("--json",)),
        (
            ("identify", "{bag}", "-o", "m.toml", "--model", "quadratic", "--degree", "1"),
            ("--deg",),
        ),
        (("replay", "paper:M4", "{bag}", "-o", "r"), ("reference",)),
        (("replay", "nonsense.toml", "{bag}", "-o", "r"), ("nonsense.toml",)),
        (("excite", "-o", "{bag}"), ("-o", "exists")),
        (("excite", "-o", "b", "--duration", "-3"), ("duration",)),
        (("excite", "-o", "b", "--duration", "0.001"), ("duration", "from 0.01 to 3600 s")),
        (("excite", "-o", "b", "--duration", "inf"), ("duration",)),
        (("excite", "-o", "b", "--amplitude", "2"), ("amplitude",)),
        (("track", "paper:M7"), ("M7",)),
        (("track", "--dwell", "0"), ("--dwell",)),
        (("track", "--controller", "none"), ("--controller",)),
        (("track", "--law", PILOT, "--controller", "full"), ("controller", "no effect on a pilot")),
        (("track", "--law", PILOT, "--estimator", "kalman"), ("estimator", "no effect on a pilot")),
        (
            ("commission", "--vehicle", FOUR, "--truth", "paper:M3", "-o", "box"),
            ("--truth: the controller's craft has 4 motors, the twin 6",),
        ),
        (("animate", "{bag}", "-o", "flight.mp4"), (".gif",)),
    ],
)
def test_bad_usage_writes_nothing(bag, archive, tmp_path, arguments, words):
    filled = [argument.format(bag=bag, archive=archive) for argument in arguments]
    assert refused(airpuck(*filled, cwd=tmp_path), *words)
    assert not list(tmp_path.iterdir())


def test_the_demo_deletes_no_files_of_the_user(tmp_path):
    mine = tmp_path / "bags" / "training" / "flight.mcap"
    mine.parent.mkdir(parents=True)
    mine.write_text("mine")
    assert refused(airpuck("demo", "-o", tmp_path), "bags", "-o")
    assert mine.read_text() == "mine"


def test_a_file_that_the_controller_rejects_is_named(tmp_path):
    from airpuck.model.model_file import published_model

    published = published_model("M3")
    thrust = published.parameters.thrust.copy()
    thrust[2] = [0.1, -1.0, 0.2]
    falling = replace(published, parameters=replace(published.parameters, thrust=thrust))
    falling.save(tmp_path / "falling.toml")
    track = ("track", "--dwell", "1")
    words = ("falling.toml", "thrust_N", "propeller 3 falls")
    assert refused(airpuck(*track, "falling.toml", cwd=tmp_path), *words)
    for line in ("position = 0", "position = 1e300"):
        (tmp_path / "mine.toml").write_text(f"[law.lqr.weights]\n{line}\n")
        process = airpuck(*track, "paper:M4", "--tuning", "mine.toml", cwd=tmp_path)
        assert refused(process, "mine.toml", "weights.position")
    # More commands than can be decided in time; the number depends on file and craft.
    (tmp_path / "mine.toml").write_text("[law.mpc]\nblock = 1\nhorizon_s = 0.8\n")
    process = airpuck(*track, "paper:M4", "--tuning", "mine.toml", "--law", "mpc", cwd=tmp_path)
    assert refused(process, "mine.toml: law.mpc.block", "240 commands; at most 200")


@pytest.mark.slow
def test_motors_that_never_move_are_named(tmp_path):
    recording = record(duration=4.0, noise=1e-4)
    command = recording.streams["command"]
    command.values[:, 2] = 0.3
    write_bag(recording, tmp_path / "bag")
    process = ran("identify", tmp_path / "bag", "-o", tmp_path / "m.toml", "--json", "-")
    assert any("motor_b_1" in w for w in json.loads(process.stdout)["warnings"])


@pytest.mark.slow
def test_too_little_data_causes_no_traceback(tmp_path):
    recording = record(duration=0.6, noise=1e-4)
    write_bag(recording, tmp_path / "bag")
    process = airpuck("identify", tmp_path / "bag", "-o", "m.toml", cwd=tmp_path)
    assert process.returncode in (0, 2), process.stderr
    assert "Traceback" not in process.stderr
