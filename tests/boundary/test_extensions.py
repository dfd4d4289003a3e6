"""Other distributions add commands, exports, laws, items and opponents, as a user's would."""

import json
import pydoc
import subprocess
import sys
import textwrap

import pytest

import airpuck
from tests.apparatus import commands
from tests.apparatus.commands import refused

#: A user's distribution: one module, and its metadata as pip would write it.
MODULE = '''
from dataclasses import dataclass
from pathlib import Path

import airpuck
from airpuck.extend import ExportKind, Item


def hover(model: str = "paper:M3") -> None:
    """Print the name of a model."""
    print(airpuck.read_model(model).name)


def learn(name: str) -> None:
    """Write the first guess of a model, and read it again."""
    rung, craft = airpuck.named_rung(name), airpuck.default_vehicle()
    parameters = rung.initial(craft)
    airpuck.Model(rung.name, craft, parameters, rung.mask(parameters)).save("learnt.toml")
    read = airpuck.read_model("learnt.toml")
    print(read.parameters.slip, read.rung == rung)


NOTE = ExportKind("a note on the model", "guest")


def write(subject, folder):
    Path(folder, "note.txt").write_text(subject.model.name)
    return {"words": 1}


class Idle(airpuck.Law):
    def __init__(self, model, tuning, options=None):
        self.off = 0.1 * tuning.period_s + 0 * model.vehicle.command_min

    def step(self, state, moment):
        return airpuck.Step([self.off] * 6), state


@dataclass(frozen=True, eq=False)
class Slip(airpuck.Effect):
    """Drag across the craft."""

    across: float = 0.3

    def acceleration(self, xp, motion):
        return 0.0, -self.across * motion.left, 0.0


class Square(Item):
    number: float = 1.0

    def run(self):
        return [{"square": self.number**2}]
'''
ENTRIES = """
[airpuck.commands]
hover = guest:hover
learn = guest:learn
broken = guest:missing
absent = no_such_module:thing
[airpuck.effects]
slip = guest:Slip
[airpuck.exports]
note = guest:NOTE
[airpuck.laws]
idle = guest:Idle
[airpuck.items]
square = guest:Square
"""


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """Install the distribution in a folder of its own; return how to run airpuck with it."""
    folder = tmp_path_factory.mktemp("guests")
    (folder / "guest.py").write_text(MODULE)
    info = folder / "airpuck_guest-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: airpuck-guest\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(ENTRIES)

    def run(*words, without=()):
        code = f"""
            import sys
            sys.path.insert(0, {str(folder)!r})
            for name in {without!r}:
                sys.modules[name] = None
            if {bool(without)!r}:
                from importlib import metadata
                found = metadata.entry_points
                metadata.entry_points = lambda **given: [
                    one for one in found(**given) if not one.value.startswith({without!r})
                ]
            from airpuck.cli import main
            sys.argv[1:] = {list(map(str, words))!r}
            main()
            """
        return subprocess.run(
            [sys.executable, "-c", textwrap.dedent(code)],
            capture_output=True,
            text=True,
            cwd=folder,
            check=False,
        )

    return run


def test_a_command_of_another_distribution_runs(installed):
    assert installed("hover", "--model", "paper:M2").stdout == "M2\n"


def test_an_effect_of_another_distribution_is_a_term(installed):
    ended = installed("learn", "M3+slip")
    assert ended.stdout == "[0.3] True\n", ended.stderr


def test_the_help_lists_added_commands_and_a_broken_one_costs_one_line(installed):
    ended = installed("--help")
    assert ended.returncode == 0
    assert "Print the name of a model." in ended.stdout
    absent, broken = sorted(ended.stderr.splitlines())
    assert "airpuck-guest adds absent, but it cannot be used (ModuleNotFoundError" in absent
    assert "airpuck-guest adds broken, but it cannot be used (AttributeError" in broken


def test_a_broken_command_ends_in_one_line_naming_its_distribution(installed):
    assert refused(installed("broken"), "upgrade or uninstall airpuck-guest")


def test_an_export_of_another_distribution_writes_its_files(installed, tmp_path):
    ended = installed("export", "paper:M2", "--to", "note", "-o", tmp_path / "out")
    assert ended.returncode == 0, ended.stderr
    assert (tmp_path / "out" / "note.txt").read_text() == "M2"


@pytest.mark.slow
def test_a_law_of_another_distribution_is_selected_by_name(installed):
    ended = installed("track", "--dwell", "0.1", "--law", "idle", "--json", "-")
    assert ended.returncode == 0, ended.stderr
    assert refused(installed("track", "--law", "idel"), "did you mean 'idle'?")


@pytest.mark.slow
def test_a_campaign_computes_items_of_another_distribution(installed, tmp_path):
    spec = tmp_path / "spec.toml"
    spec.write_text('kind = "square"\ngrid.number = [2, 3]\n')
    ended = installed("campaign", spec, "-o", tmp_path / "out", "--workers", "1", "--json", "-")
    assert ended.returncode == 0, ended.stderr
    assert "9" in json.dumps(json.loads(ended.stdout))


@pytest.mark.parametrize(
    "words",
    [
        ("play",),
        ("match", "--left", "keeper"),
        ("export", "paper:M2", "--to", "gym-hockey", "-o", "out"),
    ],
)
def test_without_air_hockey_its_names_state_what_to_install(installed, words):
    ended = installed(*words, without=("airpuck_hockey",))
    assert refused(ended, "is part of airpuck-hockey", "pip install airpuck-hockey")


def test_without_air_hockey_former_names_state_what_to_install():
    code = "import sys; sys.modules['airpuck_hockey'] = None; import airpuck; "
    code += "from airpuck import control; assert not hasattr(airpuck, 'Game'); "
    for error, use in (
        ("AttributeError", "airpuck.Game"),
        ("ImportError", "from airpuck import Game"),
    ):
        ended = subprocess.run([sys.executable, "-c", code + use], capture_output=True, text=True)
        last = ended.stderr.splitlines()[-1]
        assert last.startswith(f"{error}: airpuck.Game is part of airpuck-hockey")
        assert last.endswith("pip install airpuck-hockey")


def test_a_campaign_of_games_without_air_hockey_states_what_to_install(installed, tmp_path):
    spec = tmp_path / "spec.toml"
    spec.write_text('kind = "match"\n')
    ended = installed("campaign", spec, "-o", tmp_path / "out", without=("airpuck_hockey",))
    assert refused(ended, "pip install airpuck-hockey")


@pytest.mark.parametrize(
    ("former", "now"),
    [
        ("fly_fleet", r"airpuck\.TwinBatch"),
        ("Adam", r"studies/adam\.py"),
        ("select_model", r"airpuck\.study"),
        ("Selection", r"airpuck\.Study"),
    ],
)
def test_a_former_name_names_its_replacement(former, now):
    with pytest.raises(AttributeError, match=f"use {now}"):
        getattr(airpuck, former)
    with pytest.raises(ImportError, match=f"use {now}"):
        exec(f"from airpuck import {former}")


def test_a_former_option_names_its_replacement(tmp_path):
    refused(commands.airpuck("identify", "bag", "--adam", "7"), "--adam", "studies/adam.py")
    refused(commands.airpuck("track", "--regulator", "mpc"), "--regulator", "use --law")
    refused(commands.airpuck("excite", "--model", "paper:M3"), "--model", "use --truth")
    refused(commands.airpuck("design", "--check", "3"), "--check", "studies/next_flight.py")
    refused(commands.airpuck("record", "--mapping", "lab.toml"), "--mapping", "every topic")
    refused(commands.airpuck("record", "--topics", "x"), "--topics", "every topic")
    refused(commands.airpuck("league", "--bags", "anna"), "--bags", "studies/ratings.py")
    refused(commands.airpuck("play-live", "--model", "m.toml"), "--model", "play-live m.toml")
    file = tmp_path / "f.toml"
    for command, key, now in (("track", "regulator", "law"), ("excite", "model", "truth")):
        file.write_text(f'{key} = "mpc"\n')
        refused(commands.airpuck(command, "--settings", file), key, f"written {now}")


def test_a_former_argument_or_attribute_names_its_replacement():
    model, tuning = airpuck.read_model("paper:M4"), airpuck.default_tuning()
    for call in (airpuck.track, airpuck.TrackingController):
        with pytest.raises(TypeError, match="no argument 'regulator'; did you mean 'law'"):
            call(model, airpuck.SetPoint(0.0, 0.0, 0.0), regulator="mpc")  # pyright: ignore
    for former, now in (
        ("with_regulator", "with_law"),
        ("regulator", "law"),
        ("weights", "law.lqr.weights"),
    ):
        with pytest.raises(AttributeError, match=rf"^Tuning\.{former} is now {now}$"):
            getattr(tuning, former)
    assert not hasattr(tuning, "nonsense")


def test_help_shows_no_functions_as_defaults():
    for name in ("study", "race", "design", "tune", "commission", "animate", "campaign"):
        shown = pydoc.plain(pydoc.render_doc(getattr(airpuck, name)))
        assert "<function" not in shown and len(shown.splitlines()[2]) < 1200, name
    assert "table: 'tuple[float, float] | AirHockey' = AirHockey()" in pydoc.plain(
        pydoc.render_doc(airpuck.animate)
    )
