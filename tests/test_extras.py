"""Each extra, installed in a fresh environment, brings what its first command or import needs."""

import shlex
import subprocess
import tomllib
import venv
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
EXTRAS = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]

#: What is installed, and what its users run first; one after the other in one environment. The
#: view needs a graph to show.
FIRST_USE = (
    {"control": "python -c \"import airpuck; airpuck.read_model('paper:M3').to_statespace()\""},
    {"plan": "airpuck plan --from 0 0 0 --to 0.5 0 0"},
    {
        "ros2": "airpuck twin --duration 0.2 --domain 91 --quiet",
        "ros2,view": "airpuck view --model paper:M3 --port 8391 --duration 0.2 --domain 91",
    },
    {"play": "airpuck play --no-browser --port 8392 --duration 0.2 --quiet"},
    {"campaign": "airpuck campaign spec.toml -o results --workers 1 --quiet"},
)
SPEC = 'kind = "tracking"\nseeds = 1\nbase.dwell_s = 0.2\n'


def fresh(folder: Path, *, pip: bool = False) -> Path:
    venv.create(folder, with_pip=pip)
    return folder / "bin" / "python"


def site_packages(python: Path) -> Path:
    code = "import sysconfig; print(sysconfig.get_path('purelib'))"
    return Path(subprocess.check_output([python, "-c", code], text=True).strip())


def install(pip: Path, python: Path, what: str) -> None:
    """Install into an environment by the pip of another: it takes long to get a pip."""
    command = [pip, "-m", "pip", "--python", python, "install", "--quiet", "--no-compile"]
    subprocess.run([*command, "-e", what], cwd=ROOT, check=True, capture_output=True)


@pytest.fixture(scope="module")
def plain(tmp_path_factory) -> Path:
    """An environment with the package and no extra."""
    python = fresh(tmp_path_factory.mktemp("plain"), pip=True)
    install(python, python, ".")
    return python


def run(python: Path, command: str, folder: Path) -> subprocess.CompletedProcess[str]:
    (folder / "spec.toml").write_text(SPEC)
    program, *words = shlex.split(command)
    program = python.with_name(program)
    return subprocess.run([program, *words], cwd=folder, capture_output=True, text=True)


def test_every_extra_is_tested():
    tested = {extra for uses in FIRST_USE for extras in uses for extra in extras.split(",")}
    assert set(EXTRAS) - {"dev"} == tested


@pytest.mark.parametrize("uses", FIRST_USE, ids=" ".join)
def test_an_extra_brings_what_its_first_command_needs(uses, plain, tmp_path):
    # What the package itself needs is borrowed from the plain environment.
    python = fresh(tmp_path / "fresh")
    (site_packages(python) / "plain.pth").write_text(f"{site_packages(plain)}\n")
    for extras, command in uses.items():
        install(plain, python, f".[{extras}]")
        done = run(python, command, tmp_path)
        assert done.returncode == 0, done.stderr


def test_without_its_extra_a_command_says_what_to_install(plain, tmp_path):
    for extras, command in ((e, c) for uses in FIRST_USE for e, c in uses.items()):
        done = run(plain, command, tmp_path)
        assert done.returncode
        assert "airpuck[" in done.stderr.splitlines()[-1], extras
