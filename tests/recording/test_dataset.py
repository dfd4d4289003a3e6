import hashlib
import http.server
import os
import shutil
import socket
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

import airpuck.recording.dataset as module
from airpuck.boundary.errors import InputError
from airpuck.craft.vehicle import read_vehicle
from airpuck.recording.dataset import Dataset, dataset, dataset_folder, dataset_names, fetch, verify
from airpuck.recording.mapping import read_mapping

from ..apparatus.refusals import rejected

PACKAGED = Path(module.__file__).parents[1] / "packaged/datasets"
CONTENT = {
    "models/paper/M0/params.json": b"{}",
    "control_experiment/data_M0/drone_control.csv": b"a,b\n1,2\n",
    "experiments/other/data.pt": b"not of the study",
}


@pytest.fixture(autouse=True)
def no_copy(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.delenv("AIRPUCK_DATA", raising=False)


@pytest.fixture
def published(monkeypatch: pytest.MonkeyPatch) -> dict[str, bytes]:
    """A small dataset in place of the real one."""
    hashes = {name: hashlib.sha256(content).hexdigest() for name, content in CONTENT.items()}
    made = dataset().model_copy(update={"files": hashes})
    monkeypatch.setattr(module, "dataset", lambda name=module.PAPER: made)
    return CONTENT


class Server:
    def __init__(self, root: Path) -> None:
        self.asked: list[str] = []
        self.cut = self.moved = False
        outer = self

        class Handler(http.server.BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                outer.asked.append(self.path)
                if outer.moved and not self.path.startswith("/moved"):
                    self.send_response(302)
                    self.send_header("Location", f"/moved{self.path}")
                    self.end_headers()
                    return
                self.path = self.path.removeprefix("/moved")
                file = root / self.path.lstrip("/")
                if not file.is_file():
                    self.send_error(404)
                    return
                content = file.read_bytes()
                self.send_response(200)
                self.send_header("Content-Length", str(len(content)))
                self.end_headers()
                self.wfile.write(content[: len(content) // 2] if outer.cut else content)

            def log_message(self, format: str, *args: object) -> None:
                pass

        self.server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.url = f"http://127.0.0.1:{self.server.server_address[1]}/"
        threading.Thread(target=self.server.serve_forever, daemon=True).start()


@pytest.fixture
def server(tmp_path: Path, published: dict[str, bytes]) -> Iterator[Server]:
    root = tmp_path / "served"
    for name, content in published.items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_bytes(content)
    server = Server(root)
    yield server
    server.server.shutdown()
    server.server.server_close()


def files_in(folder: Path) -> dict[str, bytes]:
    return {
        file.relative_to(folder).as_posix(): file.read_bytes()
        for file in folder.rglob("*")
        if file.is_file()
    }


def test_the_study_is_downloaded_once(tmp_path: Path, server: Server):
    target = tmp_path / "copy"
    assert fetch(folder=target, base_url=server.url) == target
    study = {name: CONTENT[name] for name in CONTENT if "other" not in name}
    assert files_in(target) == study
    assert len(server.asked) == 2
    fetch(folder=target, base_url=server.url)
    assert len(server.asked) == 2


def test_the_whole_data_set_can_be_downloaded(tmp_path: Path, server: Server):
    seen = []
    fetch(
        all=True,
        folder=tmp_path / "copy",
        base_url=server.url,
        progress=lambda done, total, name: seen.append((done, total, name)),
    )
    assert files_in(tmp_path / "copy") == CONTENT
    assert seen == [*((i, 3, name) for i, name in enumerate(CONTENT)), (3, 3, "")]


def test_a_damaged_copy_is_downloaded_again(tmp_path: Path, server: Server):
    target = tmp_path / "copy"
    fetch(folder=target, base_url=server.url)
    (target / "models/paper/M0/params.json").write_bytes(b"{ }")
    assert dict(verify(target)) == {
        "models/paper/M0/params.json": "differs from the published file"
    }
    fetch(folder=target, base_url=server.url)
    assert verify(target) == {}


def test_a_redirect_is_followed(tmp_path: Path, server: Server):
    server.moved = True
    fetch(folder=tmp_path / "copy", base_url=server.url)
    assert verify(tmp_path / "copy") == {}
    assert sum(path.startswith("/moved") for path in server.asked) == 2


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"{'evil': 1}", "unexpected content"),
        (bytes(2000), "is too large"),
        (None, "the server answers 404"),
        (CONTENT["models/paper/M0/params.json"], "the connection broke"),
    ],
)
def test_a_failed_download_is_reported_and_leaves_no_files(
    tmp_path: Path, server: Server, monkeypatch: pytest.MonkeyPatch, content, says: str
):
    monkeypatch.setattr("airpuck.boundary.limits.DOWNLOAD_BYTES", 1500)
    file = tmp_path / "served" / "models/paper/M0/params.json"
    file.unlink()
    if content is not None:
        file.write_bytes(content)
    server.cut = says == "the connection broke"
    with rejected("params.json", match=says):
        fetch(folder=tmp_path / "copy", base_url=server.url)
    assert files_in(tmp_path / "copy") == {}
    (tmp_path / "file").write_text("a file")
    with pytest.raises(InputError, match="cannot be written"):
        fetch(folder=tmp_path / "file", base_url=server.url)


@pytest.mark.parametrize("host", ["127.0.0.1", "no-such-host.invalid"])
def test_being_offline_is_reported_in_one_clear_line(tmp_path: Path, published, host: str):
    with socket.socket() as unused:
        unused.bind(("127.0.0.1", 0))
        port = unused.getsockname()[1]
    url = f"http://{host}:{port}/"
    with rejected(url, "AIRPUCK_DATA", match="cannot be downloaded"):
        fetch(folder=tmp_path / "copy", base_url=url)
    assert files_in(tmp_path / "copy") == {}


def test_a_copy_named_by_the_variable_is_checked(
    tmp_path: Path, server: Server, monkeypatch: pytest.MonkeyPatch
):
    target = fetch(folder=tmp_path / "copy", base_url=server.url)
    asked = len(server.asked)
    monkeypatch.setenv("AIRPUCK_DATA", str(target))
    assert fetch(base_url=server.url) == target
    assert dataset_folder() == target
    with pytest.raises(InputError, match=r"experiments/other/data\.pt: is missing"):
        fetch(all=True, base_url=server.url)
    (target / "models/paper/M0/params.json").unlink()
    (target / "control_experiment/data_M0/drone_control.csv").write_text("")
    with pytest.raises(InputError, match=r"\(and 1 more\)"):
        fetch(base_url=server.url)
    assert len(server.asked) == asked


@pytest.mark.parametrize("call", [fetch, dataset_folder])
def test_a_variable_that_names_no_folder_is_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, call
):
    monkeypatch.setenv("AIRPUCK_DATA", str(tmp_path / "nowhere"))
    with pytest.raises(InputError, match="AIRPUCK_DATA: is not a folder"):
        call()


def test_without_the_variable_the_cache_is_filled(
    tmp_path: Path, server: Server, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(module, "fetch", lambda: fetch(base_url=server.url))
    assert dataset_folder().is_relative_to(tmp_path)
    assert verify(dataset_folder()) == {}


def test_the_registry_is_pinned():
    assert dataset().url.endswith("/holohover-sysid/3a257e77d1fdefe445f5d180900015d55013cd9a/")
    study, everything = dataset().chosen(), dataset().chosen(all=True)
    assert len(everything) == 28
    assert len(study) == 18
    assert study.items() <= everything.items()
    assert sum(name.endswith("params.json") for name in study) == 5


def test_the_registry_matches_the_published_one(data: Path):
    lines = (data / "SHA256SUMS").read_text().split("\n")
    expected = {name: digest for digest, name in (line.split() for line in lines if line)}
    assert dataset().files == expected


@pytest.mark.parametrize("name", dataset_names())
def test_every_dataset_is_pinned_and_its_own_files_can_be_read(name: str):
    described = dataset(name)
    assert len(described.commit) == 40
    assert described.licence
    assert described.commit in described.url
    for file in described.files:
        assert not file.startswith("/")
        assert ".." not in file
    own = PACKAGED / name
    if (own / "vehicle.toml").exists():
        names = read_vehicle(own / "vehicle.toml").columns
        assert set(read_mapping(own / "mapping.toml").command.propellers) == set(names)


def test_an_unknown_dataset_is_rejected():
    with pytest.raises(InputError, match="choose from air-bearing-satellite, cybership-enterprise"):
        fetch("satellite")


def test_our_files_lie_next_to_the_data_and_nothing_is_downloaded_twice(
    tmp_path: Path, server: Server, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setenv("AIRPUCK_DATA", str(tmp_path))  # the paper's data, and no other's
    name = "air-bearing-satellite"
    made = Dataset(
        title="a", authors="b", repository="c/d", commit="e", licence="MIT", size_MB=1,
        files={file: hashlib.sha256(content).hexdigest() for file, content in CONTENT.items()},
    )  # fmt: skip
    monkeypatch.setattr(module, "dataset", lambda asked: {name: made}[asked])
    target = tmp_path / "copy"
    fetch(name, folder=target, base_url=server.url)
    ours = {
        file: (PACKAGED / name / file).read_bytes() for file in ("vehicle.toml", "mapping.toml")
    }
    assert files_in(target) == CONTENT | ours
    asked = len(server.asked)
    (target / "experiments/other/data.pt").unlink()
    fetch(name, folder=target, base_url=server.url)
    assert server.asked[asked:] == ["/experiments/other/data.pt"]
    server.cut = True
    (target / "experiments/other/data.pt").unlink()
    with pytest.raises(InputError, match="-o FOLDER"):
        fetch(name, folder=target, base_url=server.url)


def test_the_real_copy_is_complete(data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    assert verify(data) == {}
    missing = verify(data, all=True)
    assert set(missing.values()) <= {"is missing"}
    damaged = tmp_path / "copy"
    shutil.copytree(data / "models", damaged / "models")
    file = damaged / "models" / "paper" / "M3" / "params.json"
    os.chmod(file, 0o644)  # noqa: PTH101
    file.write_bytes(file.read_bytes()[:-1])
    problems = verify(damaged)
    assert problems["models/paper/M3/params.json"] == "differs from the published file"
    assert "models/paper/M2/params.json" not in problems
    monkeypatch.setenv("AIRPUCK_DATA", str(data))
    assert fetch() == data
