"""Fetch public example recordings: the registry `models/examples.toml` and a folder of one example.

This is the only module of gaitcal that uses the internet, and only for `gaitcal example NAME`. A
request holds the address of a public file and the name of the program, and no user data. Pooch
downloads the files, repeats failed requests, and stores a file only if its SHA-256 is right.

The folder holds the recordings, study.toml, and SOURCE.txt with their origin and licence. Verified
files are kept after an interruption, and the next run fetches only the rest. A folder with other
content is refused.
"""

import json
import logging
import shutil
import textwrap
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path, PurePosixPath
from urllib.parse import urlsplit
from urllib.request import url2pathname

import pooch
import requests
from pydantic import Field, field_validator

from gaitcal.errors import Code, InputError, UsageError, suggest_name
from gaitcal.io.atomic import InterruptedWork, Stopped
from gaitcal.io.result_folder import (
    MANIFEST,
    ResultKind,
    compute_sha256,
    read_json_object,
    write_result_folder,
)
from gaitcal.io.toml import Table, find_models_folder, get_package_version, read_validated

REGISTRY = "examples.toml"


class RemoteFile(Table):
    """Table `[[example.file]]`: a recording at its public address."""

    # Path below the folder of the example: `HC002D/static.c3d`
    name: str = Field(max_length=200)
    url: str
    bytes: int = Field(gt=0)
    sha256: str = Field(pattern="^[0-9a-f]{64}$")

    @field_validator("name")
    @classmethod
    def _require_inside(cls, name: str) -> str:
        path = PurePosixPath(name)
        if path.is_absolute() or ".." in path.parts or "\\" in name or not path.parts:
            raise ValueError(f"found '{name}'; allowed: a name inside the folder")
        return name

    @field_validator("url")
    @classmethod
    def _require_encrypted(cls, url: str) -> str:
        if urlsplit(url).scheme != "https":
            raise ValueError(f"found '{url}'; allowed: an address that begins with https://")
        return url


class Example(Table):
    """Table `[[example]]`: recordings of one source, their origin, and a command to run next."""

    name: str = Field(pattern="^[a-z0-9-]+$")
    title: str
    people: int = Field(gt=0)
    publisher: str = Field(alias="from")
    repository: str
    commit: str
    licence: str  # SPDX identifier
    licence_text: str  # Address of its text
    cite: str
    remark: str  # Assumptions of the example that the recordings do not support
    command: str  # Of gaitcal, to run next; `{dir}` is the folder
    study: str | None = None  # Content of a study file to put beside the recordings
    files: tuple[RemoteFile, ...] = Field(alias="file", min_length=1, strict=False)

    @property
    def size(self) -> int:
        """Bytes of all files."""
        return sum(file.bytes for file in self.files)

    @property
    def hosts(self) -> tuple[str, ...]:
        """Servers of the files."""
        return tuple(sorted({urlsplit(file.url).netloc for file in self.files}))


class Registry(Table):
    """Content of the registry file."""

    examples: tuple[Example, ...] = Field(alias="example", min_length=1, strict=False)


@cache
def load_examples() -> tuple[Example, ...]:
    """Load all examples, in the order of the registry.

    Returns
    -------
    tuple of Example
        Read once and then kept.
    """
    return read_validated(Registry, find_models_folder() / REGISTRY).examples


def find_example(name: str) -> Example:
    """Find an example by its name.

    Parameters
    ----------
    name
        Name as the user typed it.

    Returns
    -------
    Example
        The example of this name.

    Raises
    ------
    UsageError
        There is none; the message has the nearest name or all names.
    """
    names = [example.name for example in load_examples()]
    if name not in names:
        hint = suggest_name(name, names) or f"; allowed: {', '.join(names)}"
        raise UsageError(f"found '{name[:40]}', which is no example{hint}", field="NAME")
    return next(example for example in load_examples() if example.name == name)


# Longest wait (s) for a connection, and for each block of a file
TIMEOUT_S = 30.0
BLOCK = 1 << 16  # Bytes read at once
# Files are not compressed on the way, so that sizes are those of the registry
HEADERS = {"User-Agent": "gaitcal example", "Accept-Encoding": "identity"}
TRIES = 3
_SCHEMES = ("https", "http", "file")


@dataclass(frozen=True, kw_only=True)
class Connection:
    """How files are requested."""

    # Address that replaces `https://HOST` of every file: `MIRROR/path/of/the/file`
    mirror: str | None = None
    tries: int = TRIES

    def __post_init__(self) -> None:
        if self.mirror is None:
            return
        parts = urlsplit(self.mirror)
        if parts.scheme not in _SCHEMES or not (parts.netloc or parts.scheme == "file"):
            allowed = "an address that begins with https://, http:// or file:///"
            raise UsageError(f"found '{self.mirror[:100]}'; allowed: {allowed}", field="--mirror")

    def resolve_address(self, file: RemoteFile) -> str:
        """Return the address from which a file is requested."""
        if self.mirror is None:
            return file.url
        return self.mirror.rstrip("/") + urlsplit(file.url).path


class _Progress:
    """Progress bar for pooch: report the bytes so far, and stop above the announced size."""

    def __init__(self, address: str, announced: int, progress: Callable[[int], None]) -> None:
        self.address, self.announced, self.progress = address, announced, progress
        self.total = self.done = 0

    def update(self, size: int) -> None:
        """Count a block; the last one may be shorter than announced."""
        self.done += size
        if self.done > self.announced + BLOCK:
            message = f"is longer than the {self.announced} bytes announced"
            raise InputError(message, source=self.address, code=Code.DOWNLOAD)
        self.progress(min(self.done, self.announced))

    def reset(self) -> None:
        """Begin again; pooch calls this with the whole size at the end."""
        self.done = 0

    def close(self) -> None:
        """Do nothing: nothing is open."""


def download(
    file: RemoteFile, target: Path, connection: Connection, progress: Callable[[int], None]
) -> None:
    """Fetch one file of an example.

    Parameters
    ----------
    file
        Entry of the registry.
    target
        File to write; it does not exist after an error.
    connection
        Mirror and number of attempts.
    progress
        Called with the number of bytes so far.

    Raises
    ------
    InputError
        There is no network, no such file, or its size or SHA-256 differs from the registry.
    """
    address = connection.resolve_address(file)

    def fetch(url: str, output: str, files: pooch.Pooch) -> None:
        if urlsplit(url).scheme == "file":
            shutil.copyfile(url2pathname(urlsplit(url).path), output)
            return
        responses: list[requests.Response] = []

        def remember(response: requests.Response, **_: object) -> None:
            responses.append(response)

        bar, hooks = _Progress(address, file.bytes, progress), {"response": remember}
        try:
            pooch.HTTPDownloader(bar, BLOCK, timeout=TIMEOUT_S, headers=HEADERS, hooks=hooks)(
                url, output, files
            )
        finally:
            # Pooch does not close a response that broke off
            for response in responses:
                response.close()

    pooch.get_logger().setLevel(logging.WARNING)
    files = pooch.create(
        path=target.parent,
        base_url="",
        registry={target.name: f"sha256:{file.sha256}"},
        urls={target.name: address},
        retry_if_failed=connection.tries - 1,
    )
    try:
        files.fetch(target.name, downloader=fetch)
    except FileNotFoundError:
        message = "no such file in the mirror"
    except requests.RequestException as error:
        message = _describe_failed_request(error, urlsplit(address).netloc, connection.tries)
    except ValueError:
        # Pooch found another SHA-256
        message = (
            f"is not the registered file (SHA-256 {file.sha256[:12]}...): it was changed there or "
            "on the way"
        )
    else:
        return
    raise InputError(message, source=address, code=Code.DOWNLOAD)


def _describe_failed_request(error: requests.RequestException, host: str, tries: int) -> str:
    """Describe why a request to `host` failed."""
    if isinstance(error, requests.HTTPError):
        response = error.response
        if response is None:
            return "the server refuses"
        gone = "; the file is no longer there" if response.status_code in (404, 410) else ""
        return f"the server answers {response.status_code} {response.reason}{gone}"
    if isinstance(error, requests.exceptions.SSLError):
        return "the server's certificate is not accepted"
    if isinstance(error, requests.ConnectionError | requests.Timeout):
        return f"{host} cannot be reached; tried {tries} times"
    return f"the connection broke off ({type(error).__name__}); tried {tries} times"


# --------------------------------------------------------------------------------------- the folder

SOURCE, STUDY = "SOURCE.txt", "study.toml"


@dataclass(frozen=True)
class DownloadProgress:
    """Progress of all files of an example."""

    name: str  # Of the file that is being fetched
    done: int  # Bytes of all files so far
    total: int


def find_verified_files(example: Example, folder: Path) -> tuple[RemoteFile, ...]:
    """Find the files of an example that are in `folder` with the right SHA-256.

    Parameters
    ----------
    example
        Example of the registry.
    folder
        Folder of the user.

    Returns
    -------
    tuple of RemoteFile
        In the order of the registry.
    """
    return tuple(
        file for file in example.files if compute_sha256(folder / file.name) == file.sha256
    )


def is_complete(example: Example, folder: Path) -> bool:
    """Return whether `folder` holds this example with all its files."""
    is_same = read_json_object(folder / MANIFEST).get("example") == example.name
    return is_same and len(find_verified_files(example, folder)) == len(example.files)


def fetch_example(
    example: Example,
    folder: Path,
    connection: Connection,
    progress: Callable[[DownloadProgress], None],
) -> None:
    """Fetch the missing files of an example, and write its folder.

    A study file that exists is not changed.

    Parameters
    ----------
    example
        Example of the registry.
    folder
        Folder to fill.
    connection
        Mirror and number of attempts.
    progress
        Called after each block.

    Raises
    ------
    InputError
        The folder holds something else, or a file is not available or not the registered one.
    InterruptedWork
        Ctrl-C or a signal; files fetched before are kept.
    """
    if is_complete(example, folder):
        return
    other = read_json_object(folder / MANIFEST).get("example", example.name)
    if other != example.name:
        message = f"contains the example '{other}'; give a new or an empty folder"
        raise InputError(message, source=folder, code=Code.FOLDER_TAKEN)
    fault: InputError | KeyboardInterrupt | Stopped | None = None
    with write_result_folder(folder, ResultKind.EXAMPLE) as content:
        for file in find_verified_files(example, folder):
            (content / file.name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(folder / file.name, content / file.name)
        try:
            _fetch_rest(example, content, connection, progress)
        except (InputError, KeyboardInterrupt, Stopped) as ending:
            fault = ending
        there = find_verified_files(example, content)
        if fault is not None and not there:
            raise fault
        if (folder / STUDY).is_file():
            shutil.copy2(folder / STUDY, content / STUDY)
        elif example.study:
            (content / STUDY).write_text(example.study.lstrip("\n"), encoding="utf-8")
        (content / SOURCE).write_text(_format_source(example), encoding="utf-8")
        manifest = {"gaitcal": get_package_version("gaitcal"), "example": example.name}
        (content / MANIFEST).write_text(json.dumps(manifest), encoding="utf-8")
    if fault is None:
        return
    kept = f"{len(there)} of {len(example.files)} files are in {folder}; run again for the rest"
    if isinstance(fault, InputError):
        raise InputError(f"{fault}; {kept}", code=fault.code) from fault
    raise InterruptedWork(fault, kept) from fault


def _fetch_rest(
    example: Example,
    content: Path,
    connection: Connection,
    progress: Callable[[DownloadProgress], None],
) -> None:
    missing = [file for file in example.files if not (content / file.name).exists()]
    done = example.size - sum(file.bytes for file in missing)
    for file in missing:
        (content / file.name).parent.mkdir(parents=True, exist_ok=True)

        def step(size: int, name: str = file.name, before: int = done) -> None:
            progress(DownloadProgress(name, before + size, example.size))

        download(file, content / file.name, connection, step)
        done += file.bytes


def _format_source(example: Example) -> str:
    """Format the origin and licence of the recordings as the text of SOURCE.txt.

    Returns: lines of at most 100 characters.
    """
    paragraphs = (
        f"{example.title}. Fetched by 'gaitcal example {example.name}'; the recordings are no part "
        "of gaitcal.",
        f"From: {example.publisher}",
        f"Repository: {example.repository}, commit {example.commit}",
        f"Licence: {example.licence}, {example.licence_text}",
        f"Cite: {example.cite}",
        f"Note: {example.remark}",
    )
    files = "\n".join(
        f"{file.name}\n  {file.url}\n  SHA-256 {file.sha256}" for file in example.files
    )
    wrapped = (
        textwrap.fill(line, 100, break_long_words=False, break_on_hyphens=False)
        for line in paragraphs
    )
    return "\n".join(wrapped) + f"\n\n{files}\n"
