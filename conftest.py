"""Shared fixtures; and while the tests run, jaxtyping signatures are checked."""

from __future__ import annotations

import gc
import logging
import os
import shutil
import signal
import sys
import threading
from importlib.metadata import version
from pathlib import Path

import hypothesis
import jaxtyping
import pytest
from platformdirs import user_cache_path

pytest.register_assert_rewrite("tests.apparatus", "apparatus")

from tests.apparatus import once, typechecker  # noqa: E402

# Compiled programs are cached between tests, processes and runs. The key is their content, so an
# old program is never used for new code.
os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(user_cache_path("airpuck-tests")))
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0.1")

# Most programs run once here, so that compiling them costs more than running them. An XLA that does
# not know a flag ends the process without a summary of the tests; the message is on stderr (-s).
flags = (
    "--xla_backend_optimization_level=1"
    " --xla_llvm_disable_expensive_passes=true --xla_cpu_parallel_codegen_split_count=1"
)
if tuple(map(int, version("jaxlib").split(".")[:2])) < (0, 11):
    flags += " --xla_cpu_use_fusion_emitters=false"
os.environ.setdefault("XLA_FLAGS", flags)

# The hook below compiles all modules of ours. Without their bytecode each worker, and each process
# that a test starts, does so again, for seconds.
sys.dont_write_bytecode = False
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

# Threads of linear algebra wait for each other in busy loops. Workers and other processes that the
# tests start inherit this; in the first process a plugin has imported NumPy already.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# A shell that starts the tests in the background has them ignore Ctrl-C, and with them every
# process that they start and interrupt.
if threading.current_thread() is threading.main_thread():
    signal.signal(signal.SIGINT, signal.default_int_handler)

# The same examples in every run, so that only a change of code can cause a failure. The quick tier
# tries a few of them; `--hypothesis-profile default` looks for new ones.
for name, count in (("full", 100), ("quick", 10)):
    hypothesis.settings.register_profile(
        name, derandomize=True, deadline=None, database=None, max_examples=count
    )
hypothesis.settings.load_profile("full")

jaxtyping.jaxtyped = typechecker.jaxtyped
_hook = jaxtyping.install_import_hook(
    ["airpuck", "airpuck_hockey"], "tests.apparatus.typechecker.check"
)


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add an option that keeps the picture of a browser test."""
    parser.addoption("--screenshot", metavar="FILE", help="where to store the picture of a page")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Skip long studies, and tests that need a browser, unless requested."""
    for marker, target in (("study", "studies"), ("browser", "test-browser")):
        asked = marker in (config.option.markexpr or "")
        mark = pytest.mark.timeout(0) if asked else pytest.mark.skip(f"runs with `make {target}`")
        for item in items:
            if item.get_closest_marker(marker):
                item.add_marker(mark)


def pytest_collection_finish() -> None:
    """Leave modules and collected tests out of garbage collection."""
    gc.freeze()


def pytest_runtest_setup() -> None:
    """Check the first calls in each test."""
    typechecker.start_again()


@pytest.fixture(autouse=True)
def grounded(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let verdicts skip flights in simulation, which tests/judgement/test_rehearsal.py tests."""

    def settles(*_: object) -> object:
        from airpuck.judgement.rehearsal import Rehearsal

        return Rehearsal(2.0)

    monkeypatch.setattr("airpuck.judgement.verdict.rehearse", settles)


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Placeholder pictures: tests of figures and of `write_page` draw the real ones."""
    monkeypatch.setattr("airpuck.report.page.drawn", lambda figure, suffix: b"drawn")


@pytest.fixture(scope="session", autouse=True)
def shared_folder(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Share the session's cached objects between its workers."""
    own = tmp_path_factory.getbasetemp()
    once.folder = own.parent if "PYTEST_XDIST_WORKER" in os.environ else own


@pytest.fixture(scope="session")
def data() -> Path:
    """Folder of the public dataset; without it, skips the test, or fails where CI requires it."""
    folder = os.environ.get("AIRPUCK_DATA")
    if folder and Path(folder).is_dir():
        return Path(folder)
    reason = "needs the real recordings: set AIRPUCK_DATA to a folder made by `airpuck fetch`"
    if os.environ.get("AIRPUCK_REQUIRE_DATA"):
        pytest.fail(reason)
    pytest.skip(reason)


@pytest.fixture(scope="session")
def experiments(data: Path) -> Path:
    """Folder of the experiments in the public dataset."""
    return data / "experiments"


@pytest.fixture(scope="session")
def domain() -> int:
    """A DDS domain for this process alone, so that parallel tests do not interfere."""
    pytest.importorskip("cyclonedds")
    return 1 + os.getpid() % 200


@pytest.fixture(scope="session")
def chromium() -> str:
    """The distribution's Chromium."""
    names = ("chromium", "chromium-browser", "google-chrome")
    path = next((found for name in names if (found := shutil.which(name))), None)
    if path is None:
        pytest.skip("needs Chromium: install the distribution's package")
    return path


@pytest.fixture
def cluster():
    """A cluster in this process."""
    from distributed import LocalCluster

    with LocalCluster(
        n_workers=0,
        threads_per_worker=1,
        processes=False,
        protocol="tcp://",
        dashboard_address=None,
        silence_logs=logging.CRITICAL,
    ) as cluster:
        yield cluster
