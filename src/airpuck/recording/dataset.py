"""Public datasets, each pinned to one commit and checked by hash."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Annotated

import pydantic

from airpuck.boundary import limits
from airpuck.boundary.errors import InputError, check_known, explained, listing
from airpuck.boundary.files import Positive, Section, read_toml
from airpuck.boundary.limits import sha256
from airpuck.boundary.outputs import replacing

#: Environment variable that names a copy of the paper's dataset.
VARIABLE = "AIRPUCK_DATA"
#: The paper's dataset.
PAPER = "holohover"
_DATASETS = "packaged/datasets"
_TIMEOUT_S = 20

_Digest = Annotated[str, pydantic.Field(pattern="^[0-9a-f]{64}$")]


class Dataset(Section):
    """The description of a dataset in ``packaged/datasets/NAME/dataset.toml``."""

    title: str
    authors: str
    #: Owner and name on GitHub.
    repository: str
    commit: str
    licence: str
    #: Size of what is downloaded by default.
    size_MB: Positive
    #: Prefixes of the files that are downloaded by default.
    study: tuple[str, ...] = ("",)
    #: Commands to run next; FOLDER stands for the folder.
    next: tuple[str, ...] = ()
    #: SHA-256 of each file.
    files: dict[str, _Digest]

    @property
    def url(self) -> str:
        """Address before the files' names."""
        return f"https://raw.githubusercontent.com/{self.repository}/{self.commit}/"

    def chosen(self, *, all: bool = False) -> dict[str, str]:
        """Return the SHA-256 of the study's files, or of all, by name."""
        return {n: digest for n, digest in self.files.items() if all or n.startswith(self.study)}


def dataset_names() -> list[str]:
    """Return the names of all datasets."""
    return sorted(entry.name for entry in resources.files("airpuck").joinpath(_DATASETS).iterdir())


@cache
def dataset(name: str = PAPER) -> Dataset:
    """Return a dataset's description, or raise InputError for an unknown name."""
    names = dataset_names()
    check_known(name, names, f"there is no such dataset; choose from {listing(names)}", field=name)
    with resources.as_file(resources.files("airpuck") / _DATASETS / name) as folder:
        return read_toml(folder / "dataset.toml", Dataset)


def dataset_folder() -> Path:
    """Return a folder with the paper's study, downloading it if necessary."""
    return _folder_from_environment() or fetch()


def _folder_from_environment() -> Path | None:
    """Return the folder named by the environment variable, if set."""
    named = os.environ.get(VARIABLE)
    if not named:
        return None
    folder = Path(named)
    if not folder.is_dir():
        raise InputError(
            "is not a folder; set it to a copy of the dataset, or unset it to download one",
            file=named,
            field=VARIABLE,
        )
    return folder


def fetch(
    name: str = PAPER,
    *,
    all: bool = False,
    folder: str | os.PathLike[str] | None = None,
    base_url: str | None = None,
    progress: Callable[[int, int, str], None] | None = None,
) -> Path:
    """Download a public dataset, and check every file's hash.

    Intact files that already exist are left alone, so a second call resumes the first one. Our
    vehicle and mapping file of the dataset, if it has any, are copied beside the data. For the
    paper's dataset, if ``$AIRPUCK_DATA`` is set and no folder is given, nothing is downloaded: that
    copy is checked.

    Parameters
    ----------
    name : str, default "holohover"
        The dataset; ``airpuck fetch --list`` lists them. The default is the paper's.
    all : bool, default False
        Whether to get every file instead of only the paper's study (about 15 MB).
    folder : path-like, optional
        Destination; by default the user's cache folder.
    base_url : str, optional
        Base URL, to which file names are appended; by default the dataset's own.
    progress : callable, optional
        Called with the number of files done, their total and the next file's name.

    Returns
    -------
    Path
        The folder.

    Raises
    ------
    InputError
        If there is no such dataset, or if a file cannot be downloaded or has unexpected content; it
        is then deleted.

    Examples
    --------
    >>> airpuck.fetch("air-bearing-satellite", folder="satellite/")  # doctest: +SKIP
    >>> airpuck.fetch("another")
    Traceback (most recent call last):
        ...
    airpuck.boundary.errors.InputError: ...
    """
    found = dataset(name)
    given = _folder_from_environment() if folder is None and name == PAPER else None
    if given is None:
        remedy = f"set {VARIABLE} to a copy of the dataset"
        if name != PAPER:
            remedy = "name a folder with a copy of the dataset, as in -o FOLDER"
        target = _download(found, all, folder, base_url or found.url, remedy, progress)
        _copy_our_files(name, target)
        return target
    problems = verify(given, all=all)
    if problems:
        file, problem = next(iter(problems.items()))
        more = f" (and {len(problems) - 1} more)" if len(problems) > 1 else ""
        raise InputError(
            f"{problem}{more}; unset {VARIABLE} to download the dataset", file=given / file
        )
    return given


def _copy_our_files(name: str, folder: Path) -> None:
    """Copy the vehicle and mapping file of a dataset beside its data."""
    for file in (resources.files("airpuck") / _DATASETS / name).iterdir():
        if file.name == "dataset.toml":
            continue
        with replacing(folder / file.name) as temporary:
            temporary.write_bytes(file.read_bytes())


def _download(
    found: Dataset,
    all: bool,
    folder: str | os.PathLike[str] | None,
    base_url: str,
    remedy: str,
    progress: Callable[[int, int, str], None] | None,
) -> Path:
    """Let pooch download missing files; it keeps a file only if its hash is right."""
    import pooch
    import requests

    pooch.get_logger().setLevel("WARNING")
    files, tell = found.chosen(all=all), progress or (lambda *_: None)
    target = pooch.os_cache("airpuck") / found.commit[:7] if folder is None else Path(folder)
    store = pooch.create(
        path=target,
        base_url=base_url,
        registry={name: f"sha256:{digest}" for name, digest in files.items()},
    )
    for done, name in enumerate(files):
        tell(done, len(files), name)
        counted = _Counted(base_url + name)
        # pooch accepts any object with a progress bar's methods.
        downloader = pooch.HTTPDownloader(progressbar=counted, timeout=_TIMEOUT_S)  # pyright: ignore[reportArgumentType]
        damaged = "was downloaded with unexpected content and deleted; try again"
        with explained(ValueError, damaged, file=base_url + name):
            try:
                # pooch's annotation of a downloader does not fit pooch's own downloaders.
                store.fetch(name, downloader=downloader)  # pyright: ignore[reportArgumentType]
            except requests.RequestException as error:
                problem = f"cannot be downloaded ({_reason(error)}); if this machine is offline, "
                raise InputError(problem + remedy, file=base_url + name) from error
            except OSError as error:
                problem = f"cannot be written ({error.strerror})"
                raise InputError(problem, file=target / name) from error
    tell(len(files), len(files), "")
    return target


@dataclass
class _Counted:
    """Stops a download that is too large; pooch tells a progress bar how much has arrived."""

    url: str
    #: Number of bytes received.
    arrived: int = 0
    #: Set by pooch: size according to the server.
    total: int = 0

    def update(self, size: int) -> None:
        """Count; raise InputError above the limit."""
        self.arrived += size
        if max(self.arrived, self.total) > limits.DOWNLOAD_BYTES:
            raise limits.refused(
                "is too large", limits.DOWNLOAD_BYTES, "it is not the published file", file=self.url
            )

    def reset(self) -> None:
        """Begin again, as pooch does at the end."""
        self.arrived = 0

    def close(self) -> None:
        """Do nothing: there is no bar."""


def _reason(error: Exception) -> str:
    """Explain in a few words why a download failed."""
    import requests

    if isinstance(error, requests.HTTPError) and error.response is not None:
        return f"the server answers {error.response.status_code}"
    if isinstance(error, requests.Timeout):
        return "the server does not answer"
    broken = isinstance(error, requests.exceptions.ChunkedEncodingError)
    return "the connection broke" if broken else "the server cannot be reached"


def verify(folder: str | os.PathLike[str], *, all: bool = False) -> dict[str, str]:
    """Check a copy of the paper's dataset, and return each wrong file's problem."""
    problems = {}
    expected = dataset().chosen(all=all)
    for name, digest in dataset().files.items():
        file = Path(folder) / name
        if file.is_file():
            if sha256(file) != digest:
                problems[name] = "differs from the published file"
        elif name in expected:
            problems[name] = "is missing"
    return problems
