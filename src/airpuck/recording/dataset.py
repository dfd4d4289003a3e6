"""The authors' public dataset, pinned to one commit and checked by hash."""

from __future__ import annotations

import os
from collections.abc import Callable
from importlib import resources
from pathlib import Path

from airpuck.boundary.errors import InputError
from airpuck.recording.files import sha256

#: Environment variable that names a copy of the dataset.
VARIABLE = "AIRPUCK_DATA"
REPOSITORY = "PREDICT-EPFL/holohover-sysid"
COMMIT = "3a257e77d1fdefe445f5d180900015d55013cd9a"
BASE_URL = f"https://raw.githubusercontent.com/{REPOSITORY}/{COMMIT}/"

#: Files of the paper's study: training, validation, the raw check of preprocessing, the flights.
_STUDY = (
    "models/paper/",
    "control_experiment/",
    "experiments/2023_10_18-11_28_12_sysid_h1_old/data.pt",
    "experiments/2023_11_22-11_57_44_sysid_h1_old/data.pt",
    "experiments/2024_03_05-16_12_50_sysid_h1_blue/",
)
_TIMEOUT_S = 20


def _registry() -> dict[str, str]:
    """Return the SHA-256 of every downloadable file, by its name in the repository."""
    text = (resources.files("airpuck") / "packaged" / "dataset.sha256").read_text("utf-8")
    lines = (line.split(maxsplit=1) for line in text.splitlines() if not line.startswith("#"))
    return {name: digest for digest, name in lines}


def dataset_files(*, all: bool = False) -> dict[str, str]:
    """Return the SHA-256 of the study's files, or of all, by name."""
    return {name: digest for name, digest in _registry().items() if all or name.startswith(_STUDY)}


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
    *,
    all: bool = False,
    folder: str | os.PathLike[str] | None = None,
    base_url: str = BASE_URL,
    progress: Callable[[int, int, str], None] | None = None,
) -> Path:
    """Download the dataset, and check every file's hash.

    Intact files that already exist are left alone. If ``$AIRPUCK_DATA`` is set and no folder is
    given, nothing is downloaded: that copy is checked.

    Parameters
    ----------
    all : bool, default False
        Whether to get every file instead of only the paper's study (about 15 MB).
    folder : path-like, optional
        Destination; by default the user's cache folder.
    base_url : str
        Base URL; the file names are appended.
    progress : callable, optional
        Called with the number of files done, their total and the next file's name.

    Returns
    -------
    Path
        The folder.

    Raises
    ------
    InputError
        If a file cannot be downloaded or has unexpected content; it is then deleted.
    """
    given = _folder_from_environment() if folder is None else None
    if given is None:
        return _download(dataset_files(all=all), folder, base_url, progress or (lambda *_: None))
    problems = verify(given, all=all)
    if problems:
        name, problem = next(iter(problems.items()))
        more = f", and {len(problems) - 1} more files are wrong" if len(problems) > 1 else ""
        raise InputError(
            f"{problem}{more}; unset {VARIABLE} to download the dataset", file=given / name
        )
    return given


def _download(
    files: dict[str, str],
    folder: str | os.PathLike[str] | None,
    base_url: str,
    progress: Callable[[int, int, str], None],
) -> Path:
    """Let pooch download missing files; it keeps a file only if its hash is right."""
    import pooch
    import requests

    pooch.get_logger().setLevel("WARNING")
    target = pooch.os_cache("airpuck") / COMMIT[:7] if folder is None else Path(folder)
    store = pooch.create(
        path=target,
        base_url=base_url,
        registry={name: f"sha256:{digest}" for name, digest in files.items()},
    )
    downloader = pooch.HTTPDownloader(timeout=_TIMEOUT_S)
    for done, name in enumerate(files):
        progress(done, len(files), name)
        try:
            # pooch's annotation of a downloader does not fit pooch's own downloaders.
            store.fetch(name, downloader=downloader)  # pyright: ignore[reportArgumentType]
        except requests.RequestException as error:
            raise InputError(
                f"cannot be downloaded ({_reason(error)}); if this machine is offline, set "
                f"{VARIABLE} to a copy of the dataset",
                file=base_url + name,
            ) from error
        except OSError as error:
            raise InputError(f"cannot be written ({error.strerror})", file=target / name) from error
        except ValueError as error:
            raise InputError(
                "was downloaded with unexpected content and deleted; try again",
                file=base_url + name,
            ) from error
    progress(len(files), len(files), "")
    return target


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
    """Check a copy of the dataset against the hashes, and return each wrong file's problem."""
    problems = {}
    expected = dataset_files(all=all)
    for name, digest in _registry().items():
        file = Path(folder) / name
        if file.is_file():
            if sha256(file) != digest:
                problems[name] = "has another content than published"
        elif name in expected:
            problems[name] = "is missing"
    return problems
