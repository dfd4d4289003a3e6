"""Each extra installs everything that its first command or import needs."""

import shlex
import subprocess
import tomllib
import venv
from importlib.metadata import distribution
from pathlib import Path

import pytest
from packaging.requirements import Requirement

from .apparatus.bags import ulog

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
EXTRAS = PROJECT["optional-dependencies"]

#: Extras, and the first command of their users; run one after the other in one environment. The
#: view needs a graph.
FIRST_USE: tuple[dict[str, str], ...] = (
    {"control": "python -c \"import airpuck; airpuck.read_model('paper:M3').to_statespace()\""},
    {"plan": "airpuck plan --from 0 0 0 --to 0.1 0 0 --intervals 10"},
    {
        "ros2": "airpuck twin --duration 0.2 --domain 231 --quiet",
        "ros2,pages": "airpuck view paper:M3 --port 8391 --duration 0.2 --domain 231",
    },
    {"px4": "python -c \"import airpuck; airpuck.read_recording('log.ulg')\""},
    {"gym": "python -c 'from airpuck.export.gym import CourseEnv; CourseEnv().reset()'"},
    {"play": "airpuck play --no-browser --port 8392 --duration 0.2 --quiet"},
    {"campaign": "airpuck campaign spec.toml -o results --workers 1 --quiet"},
)
#: Needs nothing that the first one of its extra does not need, but names the extra itself.
OTHER_USE = {"plan": "airpuck export paper:M3 --to casadi -o exported"}
#: Runs commands in one process, and prints the last line that each says on standard error.
EACH = """
import contextlib, io, shlex, sys
from airpuck.cli import main
for line in sys.argv[1:]:
    program, *sys.argv[1:] = shlex.split(line)
    with contextlib.redirect_stderr(io.StringIO()) as error:
        try:
            exec(sys.argv[2], {}) if program == "python" else main()
        except SystemExit as end:
            assert end.code == 2, line
        except Exception as problem:
            print(problem, file=sys.stderr)
    print(error.getvalue().splitlines()[-1])
"""
SPEC = 'kind = "tracking"\nseeds = 1\nbase.dwell_s = 0.2\n'


def needed(requirement: Requirement, known: set[tuple[str, str]]) -> None:
    """Add the distributions that a requirement installs: pairs of a distribution and an extra."""
    for extra in ("", *requirement.extras):
        if (requirement.name, extra) in known:
            continue
        known.add((requirement.name, extra))
        for line in distribution(requirement.name).requires or ():
            other = Requirement(line)
            if other.marker is None or other.marker.evaluate({"extra": extra}):
                needed(other, known)


def environment(folder: Path, *extras: str) -> Path:
    """Make an environment like the result of `pip install airpuck[extras]`, from links."""
    venv.create(folder)
    known = {("airpuck", "")}
    for line in sum((EXTRAS[extra] for extra in extras), PROJECT["dependencies"]):
        needed(Requirement(line), known)
    (packages,) = folder.glob("lib/python*/site-packages")
    for name in {name for name, _ in known}:
        found = distribution(name)
        for first in {file.parts[0] for file in found.files or ()} - {"..", "__pycache__"}:
            if not (packages / first).exists():
                (packages / first).symlink_to(Path(str(found.locate_file(first))))
    command = folder / "bin" / "airpuck"
    start = "from airpuck.cli import main\n\nif __name__ == '__main__':\n    main()\n"
    command.write_text(f"#!{folder}/bin/python\n{start}")
    command.chmod(0o755)
    return folder / "bin" / "python"


def run(python: Path, command: str, folder: Path) -> subprocess.CompletedProcess[str]:
    (folder / "spec.toml").write_text(SPEC)
    ulog(folder / "log.ulg")
    program, *words = shlex.split(command)
    program = python.with_name(program)
    return subprocess.run([program, *words], cwd=folder, capture_output=True, text=True)


def test_every_extra_is_tested():
    tested = {extra for uses in FIRST_USE for extras in uses for extra in extras.split(",")}
    assert set(EXTRAS) - {"dev"} == tested


@pytest.mark.slow
@pytest.mark.parametrize("uses", FIRST_USE, ids=" ".join)
def test_an_extra_provides_what_its_first_command_needs(uses, tmp_path):
    for extras, command in uses.items():
        done = run(environment(tmp_path / extras, *extras.split(",")), command, tmp_path)
        assert done.returncode == 0, done.stderr


@pytest.mark.slow
def test_without_its_extra_a_command_states_what_to_install(tmp_path):
    uses = [use for each in (*FIRST_USE, OTHER_USE) for use in each.items()]
    done = run(
        environment(tmp_path / "plain"),
        shlex.join(["python", "-c", EACH, *(c for _, c in uses)]),
        tmp_path,
    )
    assert done.returncode == 0, done.stderr
    for (extras, _), said in zip(uses, done.stdout.splitlines(), strict=True):
        extra = extras.split(",")[-1]
        own = [Requirement(line).name for line in EXTRAS[extra]]
        needed = own[0] if own[0] == "airpuck-hockey" else f"'airpuck[{extra}]'"
        assert f"pip install {needed}" in said, extras


@pytest.mark.slow
def test_a_plain_environment_contains_only_required_packages(tmp_path):
    python = environment(tmp_path / "plain")
    for name, status in (("jax", 0), ("pytest", 1), ("pandas", 1), ("casadi", 1)):
        code = f"import importlib.util, sys; sys.exit(importlib.util.find_spec({name!r}) is None)"
        assert subprocess.run([python, "-I", "-c", code]).returncode == status, name
