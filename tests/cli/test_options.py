"""Options: every number has documented limits; flags, completion."""

import os
import re
import subprocess
import sys
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from airpuck.boundary.errors import InputError, escaped
from airpuck.boundary.numbers import Range
from airpuck.cli.app import known_commands
from airpuck.cli.output import (
    origin,
    output_for,
    report,
    show_progress,
    show_time_left,
    table,
    warn,
)
from airpuck.model.model_file import published_model, read_model
from airpuck.recording.bag import write_bag

from ..apparatus.commands import airpuck, airpuck_process, ran, refused
from ..apparatus.synthetic_flights import record

KINDS = {"FILE": "file", "DIR": "folder", "BAG": "new folder"}


def outputs():
    """Return every option of every command that names an output."""
    for name, command in known_commands().items():
        for option in command.params:
            read = option.name in command.declared or option.name == "settings_file"
            if option.callback is not None and option.metavar in KINDS and not read:
                yield name, option.opts[0], KINDS[option.metavar]


@pytest.fixture
def places(tmp_path):
    """A folder with a file and a folder that is not empty."""
    (tmp_path / "file").write_text("mine")
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder" / "file").write_text("mine")
    return tmp_path


@pytest.mark.parametrize(("name", "option", "kind"), list(outputs()))
def test_a_bad_output_is_rejected_before_anything_is_read(places, name, option, kind):
    bad = {"": "is empty", "x" * 300: "255 bytes", "file/x": "cannot be written"}
    bad["/proc/none/x"] = "cannot be written"
    if kind == "file":
        bad |= {"folder": "is a folder", "/": "is the root", "/dev/null": "not an ordinary file"}
    elif kind == "folder":
        bad["file"] = "is a file"
    else:
        bad |= {"file": "exists already", "folder": "exists already", "/": "is the root"}
    for place, words in bad.items():
        process = airpuck(name, option, place, cwd=places)
        assert refused(process, option, words), place
    assert sorted(p.name for p in places.rglob("*")) == ["file", "file", "folder"]


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_write_protected_outputs_are_rejected(places):
    (places / "file").chmod(0o444)
    assert refused(airpuck("present", "m", "--json", "file", cwd=places), "write-protected")
    (places / "folder").chmod(0o555)
    assert refused(airpuck("present", "m", "--json", "folder/x", cwd=places), "Permission denied")


def test_a_folder_without_write_permission_is_rejected(places, monkeypatch):
    def denied(*_, **__):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("tempfile.TemporaryFile", denied)
    process = airpuck("present", "m", "--json", "folder/x", cwd=places)
    assert refused(process, "folder/x", "--json", "Permission denied")


def test_inputs_are_never_overwritten(tmp_path):
    (tmp_path / "params.json").write_text("{}")
    (tmp_path / "link.json").symlink_to("params.json")
    for name in ("params.json", "link.json", f"../{tmp_path.name}/params.json"):
        process = airpuck("present", "params.json", "--json", name, cwd=tmp_path)
        assert refused(process, "params.json", "--json", "is also an input")
    # A folder's own recording, too.
    (tmp_path / "bag").mkdir()
    assert refused(airpuck("resid", "m", "bag", "-o", "./bag", cwd=tmp_path), "is also an input")
    assert (tmp_path / "params.json").read_text() == "{}"


def test_figures_and_results_replace_only_their_kind(tmp_path):
    (tmp_path / "m.toml").write_text("a model")
    plan = ("plan", "--from", 0, 0, 0, "--to", 1, 0, 0)
    for option, said in (("--json", "does not end in .json"), ("--figure", "must end in .png or")):
        assert refused(airpuck(*plan, option, tmp_path / "m.toml"), f"m.toml: {option}", said)
    assert (tmp_path / "m.toml").read_text() == "a model"


def test_overlong_and_empty_names_are_rejected(tmp_path):
    long = "x" * 5000
    vehicle = ("excite", "-o", "b", "--vehicle", long)
    for words in (("evaluate", "m", long), ("evaluate", long, "r"), vehicle):
        process = airpuck(*words, cwd=tmp_path)
        assert refused(process, "longer name than the system allows")
    for words in (("evaluate", "m", ""), ("present", ""), ("check", "r", "--vehicle=")):
        assert refused(airpuck(*words, cwd=tmp_path), "is empty")


@pytest.mark.slow
def test_an_empty_folder_counts_as_new(tmp_path):
    (tmp_path / "bag").mkdir()
    ran("excite", "--duration", "0.05", "-o", "bag", cwd=tmp_path)
    assert (tmp_path / "bag" / "metadata.yaml").is_file()


# Printed names ------------------------------------------------------------------------------------

EVIL = "\x1b[31mred\x1b]0;title\x07\r\u202e\x9b31m[bold]:smile:\nnext"
SHOWN = r"\x1b[31mred\x1b]0;title\x07\r\u202e\x9b31m[bold]:smile:\nnext"


def test_terminal_control_sequences_are_escaped():
    assert escaped(EVIL) == SHOWN
    assert escaped("motor_a_1 ± 3 µm … „Größe“ 猫") == "motor_a_1 ± 3 µm … „Größe“ 猫"
    # A file name that is not UTF-8.
    assert escaped(os.fsdecode(b"caf\xe9")) == r"caf\udce9"


def test_tables_lines_and_errors_escape_names(capsys):
    report({}, EVIL, table([EVIL, "x"], [[EVIL, "[red]1[/red]"]], title=EVIL))
    printed = capsys.readouterr().out
    assert "\x1b" not in printed and "\x9b" not in printed and "\u202e" not in printed
    assert printed.replace("\n", "").count(SHOWN) == 4
    assert "[red]1[/red]" in printed


@pytest.mark.slow
def test_names_of_propellers_topics_and_files_are_escaped(tmp_path):
    evil = "\x1b[31m[red]"
    path = tmp_path / "model.toml"
    published_model("M3").save(path)
    path.write_text(path.read_text().replace("motor_a_1", "\\u001b[31m[red]"))
    assert read_model(path).vehicle.propeller_names[0] == evil
    process = ran("present", "model.toml", cwd=tmp_path)
    assert "F(1) \\x1b[31m[red]" in process.stdout and "\x1b" not in process.stdout
    (tmp_path / "topics.toml").write_text('[topics]\npose = "/\\u001b[31m[red]"\n')
    write_bag(record(duration=4.0), tmp_path / "bag")
    process = airpuck("check", "bag", "--topics", "topics.toml", cwd=tmp_path)
    assert refused(process, "\\x1b[31m[red]")
    process = airpuck_process("check", "no\x1b[2Jthing", cwd=tmp_path)
    assert refused(process, "no\\x1b[2Jthing")


@pytest.mark.parametrize(
    ("home", "shown"),
    [
        ("/home/al", "airpuck present '~/m.toml' '--json=~/x' /home/alice/y /mnt/home/al"),
        ("/home/al/", "airpuck present '~/m.toml' '--json=~/x' /home/alice/y /mnt/home/al"),
        ("/", "airpuck present /home/al/m.toml --json=/home/al/x /home/alice/y /mnt/home/al"),
        ("", "airpuck present /home/al/m.toml --json=/home/al/x /home/alice/y /mnt/home/al"),
    ],
)
def test_the_page_footer_does_not_reveal_the_home_folder(monkeypatch, home, shown):
    words = ["present", "/home/al/m.toml", "--json=/home/al/x", "/home/alice/y", "/mnt/home/al"]
    monkeypatch.setattr("sys.argv", ["/home/al/bin/airpuck", *words])
    monkeypatch.setenv("HOME", home)
    assert origin().command == shown


def test_the_page_date_follows_the_environment_variable(monkeypatch):
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1700000000")
    assert origin().date == "2023-11-14 22:13 UTC"  # date -u -d @1700000000
    for nonsense in ("9" * 30, "9" * 400, "253402300800", "yesterday", "-1", ""):
        monkeypatch.setenv("SOURCE_DATE_EPOCH", nonsense)
        now = datetime.now(UTC)
        assert origin().date in {
            (now + timedelta(minutes=k)).strftime("%Y-%m-%d %H:%M UTC") for k in (0, 1)
        }


COMMANDS = known_commands()


def numbers():
    """Return every parameter of every command that takes one or more numbers."""
    for name, command in COMMANDS.items():
        for parameter in command.params:
            kind = str(parameter.type_descriptor.annotation)
            if "float" in kind or "int" in kind:
                size = parameter.nargs
                yield pytest.param(
                    name, parameter.opts[0], size, "int" in kind, id=f"{name} {parameter.opts[0]}"
                )


@pytest.mark.parametrize(("name", "option", "size", "whole"), list(numbers()))
def test_every_number_has_limits(tmp_path, name, option, size, whole):
    # The last of several is checked, too.
    wrong = [str(10**24), str(-(10**24))] if whole else ["1e308", "-1e308", "inf", "nan"]
    for text in wrong:
        values = ["0.5"] * (size - 1) + [text]
        process = airpuck(name, option, *values, cwd=tmp_path)
        assert refused(process, f"{option}: must be ", ": "), text
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", COMMANDS)
def test_the_help_shows_limits_and_no_bool_types(name):
    shown = airpuck(name, "--help", env={**os.environ, "COLUMNS": "200"}).stdout
    assert "bool" not in shown
    assert "<float" not in shown and "<int" not in shown
    options = [line for line in shown.splitlines() if re.match(r"│ [* ]*-", line)]
    assert 1 <= len(options) - 1 <= 12  # besides --help


def test_numbers_beyond_their_limits_are_rejected():
    above = Range(0, 1, "why", above=True)
    assert str(above) == "above 0, at most 1"
    assert str(Range(1, 2**63 - 1, "why", "s")) == "1 to 9.22e18 s"
    for limits, good, bad in (
        (above, (1e-300, 1), (0, 1.001, float("nan"))),
        (Range(0.5, 2, "why"), (0.5, 2), (0.4, float("inf"), float("nan"))),
    ):
        for value in good:
            limits.check(value, "x")
        for value in bad:
            with pytest.raises(InputError, match=r"^x: must be .*: why$"):
                limits.check(value, "x")


def test_limits_also_apply_in_python():
    from airpuck import Loss

    for make in (
        lambda: Loss(spacing=1e308),
        lambda: Loss(weights=(1.0, 1.0, float("inf"))),
        lambda: Loss(encoder_time=float("nan")),
    ):
        with pytest.raises(InputError, match="must be from"):
            make()


def completions(*words: str) -> list[str]:
    """Return the completions that the shell is offered for the last word."""
    environment = {
        **os.environ,
        "_AIRPUCK_COMPLETE": "complete_bash",
        "COMP_WORDS": " ".join(words),
        "COMP_CWORD": str(len(words) - 1),
    }
    command = [sys.executable, "-m", "airpuck"]
    process = subprocess.run(command, capture_output=True, text=True, env=environment, check=True)
    assert process.stderr == ""
    return process.stdout.split()


@pytest.mark.slow
def test_the_shell_completes_options():
    assert completions("airpuck", "iden") == ["identify", "identify-puck"]
    assert completions("airpuck", "identify", "--st") == ["--stride"]
    # Completion does not reject the preceding words.
    typed = ("identify", "x", "-o", "/nowhere/x", "--stride", "0", "--delay", "")
    assert completions("airpuck", *typed) == ["fit", "fixed"]
    assert "auto" in completions("airpuck", "identify", "x", "--model", "")
    assert completions("airpuck", "identify", "x", "--model", "M5") == ["M5"]


def test_the_remaining_time_is_shown_until_the_end(capsys):
    with show_time_left("flights") as progress:
        for done in (0.5, 1.0):
            progress(done, 1.0)
    first, last = capsys.readouterr().err.splitlines()
    assert first.startswith("flights: 50 %, about ")
    assert last == "flights: 100 %"


def test_quiet_hides_progress_and_warnings_but_not_results(capsys):
    def shown(**given):
        with output_for(**given):
            with show_time_left("flights") as progress, show_progress() as tell:
                progress(1.0, 1.0)
                tell("iteration 1")
            warn(["the radio is slow"])
            report({"a": 1}, "a is 1")
        captured = capsys.readouterr()
        return captured.out, captured.err

    said = "flights: 100 %\niteration 1\nwarning: the radio is slow\n"
    assert shown() == ("a is 1\n", said)
    assert shown(quiet=True) == ("a is 1\n", "")
    assert shown(json_file=Path("-")) == ('{\n  "a": 1\n}\n', said)
    # A command's options end with it.
    assert shown() == ("a is 1\n", said)


def test_the_shell_finds_the_completion():
    command = [sys.executable, "-m", "airpuck", "--show-completion", "bash"]
    environment = {**os.environ, "_TYPER_COMPLETE_TEST_DISABLE_SHELL_DETECTION": "1"}
    shown = subprocess.run(command, capture_output=True, text=True, env=environment, check=True)
    assert "_AIRPUCK_COMPLETE=complete_bash" in shown.stdout
