"""Workers die; their items survive."""

import contextlib
import signal
import socket
import warnings

import pytest

from airpuck import InputError
from airpuck.boundary.signals import Stopped, stop
from airpuck.campaigns import workers as module
from airpuck.campaigns.workers import DEADLY, Entry, checked_workers, dispatch

from ..apparatus.mortal_items import Mortal

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """Run 12 items on two workers."""
    folder = tmp_path_factory.mktemp("marks")
    fates = {3: "once", 7: "always"}
    items = [
        Mortal(seed=s, folder=str(folder), kills=fates.get(s, "never"), raises=s == 10)
        for s in range(12)
    ]
    results = {}
    with socket.socket() as another, warnings.catch_warnings():
        # Dask's usual port for its dashboard, which another cluster may hold.
        warnings.filterwarnings("error", message="Port")
        with contextlib.suppress(OSError):
            another.bind(("0.0.0.0", 8787))
        for entry, result in dispatch([Entry(f"item {i.seed}", {}, i) for i in items], workers=2):
            assert entry.item.seed not in results
            results[entry.item.seed] = result
    runs = {s: len(list(folder.glob(f"{s}-*"))) for s in range(12)}
    return results, runs


def test_every_item_finishes(run):
    results, _ = run
    assert set(results) == set(range(12))
    assert {s for s, result in results.items() if result.failure} == {7, 10}
    assert all(result.rows for s, result in results.items() if s not in (7, 10))


def test_a_killed_worker_loses_only_its_own_item(run):
    _, runs = run
    assert runs[3] == 2
    assert {n for s, n in runs.items() if s not in (3, 7)} == {1}


def test_an_item_that_kills_its_workers_is_abandoned(run):
    results, runs = run
    assert runs[7] == DEADLY
    assert "its worker died 3 times" in results[7].failure


def test_an_error_raised_by_an_item_is_its_failure(run):
    results, runs = run
    assert results[10].failure == "figure: is not to be had"
    assert runs[10] == 1


def test_a_scheduler_without_workers_is_rejected(cluster, monkeypatch):
    monkeypatch.setattr(module, "PATIENCE", 0.5)
    with pytest.raises(InputError, match="has no workers"):
        list(dispatch([], workers=cluster.scheduler_address))


class Interrupted:
    """A signal arrives in a destructor, where Python drops exceptions."""

    def __init__(self, number: int) -> None:
        self.number = number

    def __del__(self):
        signal.raise_signal(self.number)


@pytest.mark.parametrize(
    ("number", "handler"),
    [(signal.SIGINT, signal.default_int_handler), (signal.SIGTERM, stop)],
    ids=["Ctrl-C", "SIGTERM"],
)
def test_a_signal_in_a_destructor_is_not_lost(cluster, tmp_path, number, handler):
    cluster.scale(1)
    before = signal.signal(number, handler)
    items = [Mortal(seed=s, folder=str(tmp_path)) for s in range(20)]
    entries, count = [Entry(f"interrupted {i.seed}", {}, i) for i in items], 0
    with pytest.raises(Stopped, match="run it again") as stopped:
        for count, _ in enumerate(dispatch(entries, workers=cluster.scheduler_address), start=1):
            if count == 2:
                Interrupted(number)
    assert 2 <= count <= 3
    assert stopped.value.number == number
    assert signal.signal(number, before) is handler


def test_a_missing_scheduler_is_rejected(monkeypatch):
    monkeypatch.setattr(module, "PATIENCE", 0.3)
    with pytest.raises(InputError, match="no Dask scheduler answers there"):
        list(dispatch([], workers="tcp://127.0.0.1:9"))
    with pytest.raises(InputError, match="no Dask scheduler answers there"):
        list(dispatch([], workers="nonsense://"))


@pytest.mark.parametrize("workers", ["two", "localhost:8786", "0", 0, 1e9, ""])
def test_workers_are_given_as_a_number_or_an_address(workers):
    with pytest.raises(InputError, match="workers: must be"):
        checked_workers(workers)
    assert checked_workers("4") == 4
