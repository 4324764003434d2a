"""Public recordings that `gaitcal example NAME` fetches: the registry `models/examples.toml`, and a
folder of one.

This is the only module of gaitcal that asks the internet for anything, on `gaitcal example NAME`
alone. A request holds the address of a public file and the program's name; nothing of the user's
data. Pooch fetches: a passing fault is tried again, a file is put in its place once its SHA-256 is
right.

The folder holds the recordings, study.toml, and SOURCE.txt, which says whose they are. Files that
are right are kept, whatever ends a run: the next one asks for the rest only. A folder with anything
else in it is refused.
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

from gaitcal.errors import Code, InputError, UsageError, nearest
from gaitcal.io.atomic import InterruptedWork, Stopped
from gaitcal.io.result_folder import MANIFEST, ResultKind, atomic_directory, read_object, sha256_of
from gaitcal.io.toml import Table, models_path, package_version, read_validated

REGISTRY = "examples.toml"


class RemoteFile(Table):
    """`[[example.file]]`: a recording at its public address."""

    name: str = Field(
        max_length=200
    )  # Where it is put, below the folder of the example: `HC002D/static.c3d`
    url: str
    bytes: int = Field(gt=0)
    sha256: str = Field(pattern="^[0-9a-f]{64}$")

    @field_validator("name")
    @classmethod
    def _inside(cls, name: str) -> str:
        path = PurePosixPath(name)
        if path.is_absolute() or ".." in path.parts or "\\" in name or not path.parts:
            raise ValueError(f"found '{name}'; allowed: a name inside the folder")
        return name

    @field_validator("url")
    @classmethod
    def _encrypted(cls, url: str) -> str:
        if urlsplit(url).scheme != "https":
            raise ValueError(f"found '{url}'; allowed: an address that begins with https://")
        return url


class Example(Table):
    """`[[example]]`: recordings of one source, whose they are, and what to do with them."""

    name: str = Field(pattern="^[a-z0-9-]+$")
    title: str
    people: int = Field(gt=0)
    of: str = Field(alias="from")  # Who published them
    repository: str
    commit: str
    licence: str  # SPDX identifier
    licence_text: str  # Address of its text
    cite: str
    remark: str  # What the recordings do not tell and the example therefore assumes
    command: str  # Of gaitcal, to run next; `{dir}` is the folder
    study: str | None = None  # Content of a study file to put beside the recordings
    files: tuple[RemoteFile, ...] = Field(alias="file", min_length=1, strict=False)

    @property
    def size(self) -> int:
        """Bytes of all files."""
        return sum(file.bytes for file in self.files)

    @property
    def hosts(self) -> tuple[str, ...]:
        """Servers that are asked for the files."""
        return tuple(sorted({urlsplit(file.url).netloc for file in self.files}))


class Registry(Table):
    """The whole file."""

    examples: tuple[Example, ...] = Field(alias="example", min_length=1, strict=False)


@cache
def examples() -> tuple[Example, ...]:
    """All examples, in the order of the file."""
    return read_validated(Registry, models_path() / REGISTRY).examples


def example_named(name: str) -> Example:
    """The example of this name; UsageError, with the nearest name or all names, where there is
    none.
    """
    names = [example.name for example in examples()]
    if name not in names:
        hint = nearest(name, names) or f"; allowed: {', '.join(names)}"
        raise UsageError(f"found '{name[:40]}', which is no example{hint}", field="NAME")
    return next(example for example in examples() if example.name == name)


TIMEOUT_S = 30.0  # For a connection, and for each block of a file
BLOCK = 1 << 16
HEADERS = {
    "User-Agent": "gaitcal example",
    "Accept-Encoding": "identity",
}  # Sizes are those of the files
TRIES = 3
_SCHEMES = ("https", "http", "file")


@dataclass(frozen=True, kw_only=True)
class Connection:
    """How files are asked for."""

    mirror: str | None = (
        None  # Address that stands for `https://HOST` of every file: `MIRROR/path/of/the/file`
    )
    tries: int = TRIES

    def __post_init__(self) -> None:
        if self.mirror is None:
            return
        parts = urlsplit(self.mirror)
        if parts.scheme not in _SCHEMES or not (parts.netloc or parts.scheme == "file"):
            allowed = "an address that begins with https://, http:// or file:///"
            raise UsageError(f"found '{self.mirror[:100]}'; allowed: {allowed}", field="--mirror")

    def address(self, file: RemoteFile) -> str:
        """Return where this file is asked for."""
        if self.mirror is None:
            return file.url
        return self.mirror.rstrip("/") + urlsplit(file.url).path


class _Progress:
    """A progress bar as pooch asks for one: hands on the bytes so far, and lets no more be read
    than announced.
    """

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
        """Begin again: pooch calls this with the whole size when it is done."""
        self.done = 0

    def close(self) -> None:
        """Nothing is open."""


def download(
    file: RemoteFile, target: Path, connection: Connection, progress: Callable[[int], None]
) -> None:
    """Fetch `file` to `target`; `progress` gets the bytes so far.

    Raises
    ------
    InputError
        There is no network, no such file, or another size or SHA-256 than in the registry; `target`
        is not there then.
    """
    address = connection.address(file)

    def fetch(url: str, output: str, files: pooch.Pooch) -> None:
        if urlsplit(url).scheme == "file":
            shutil.copyfile(url2pathname(urlsplit(url).path), output)
            return
        answers: list[requests.Response] = []

        def remember(answer: requests.Response, **_: object) -> None:
            answers.append(answer)

        bar, hooks = _Progress(address, file.bytes, progress), {"response": remember}
        try:
            pooch.HTTPDownloader(bar, BLOCK, timeout=TIMEOUT_S, headers=HEADERS, hooks=hooks)(
                url, output, files
            )
        finally:
            for answer in answers:  # pooch leaves one that broke off open
                answer.close()

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
    except requests.HTTPError as error:
        answer = error.response
        message = (
            "the server refuses"
            if answer is None
            else f"the server answers {answer.status_code} {answer.reason}"
        )
        if answer is not None and answer.status_code in (404, 410):
            message += "; the file is no longer there"
    except requests.exceptions.SSLError:
        message = "the server's certificate is not accepted"
    except (requests.ConnectionError, requests.Timeout):
        message = f"{urlsplit(address).netloc} cannot be reached; tried {connection.tries} times"
    except requests.RequestException as error:
        message = (
            f"the connection broke off ({type(error).__name__}); tried {connection.tries} times"
        )
    except ValueError:  # pooch: another SHA-256
        message = (
            f"is not the registered file (SHA-256 {file.sha256[:12]}...): it was changed there or "
            "on the way"
        )
    else:
        return
    raise InputError(message, source=address, code=Code.DOWNLOAD)


# ------------------------------------------------------------------------------------------------------ the folder

SOURCE, STUDY = "SOURCE.txt", "study.toml"


@dataclass(frozen=True)
class DownloadProgress:
    """How far it is."""

    name: str  # Of the file that is being fetched
    done: int  # Bytes of all files so far
    total: int


def right_files(example: Example, folder: Path) -> tuple[RemoteFile, ...]:
    """Those that lie in `folder` as the registry has them."""
    return tuple(file for file in example.files if sha256_of(folder / file.name) == file.sha256)


def is_complete(example: Example, folder: Path) -> bool:
    """Whether nothing is left to fetch."""
    is_same = read_object(folder / MANIFEST).get("example") == example.name
    return is_same and len(right_files(example, folder)) == len(example.files)


def fetch_example(
    example: Example,
    folder: Path,
    connection: Connection,
    progress: Callable[[DownloadProgress], None],
) -> None:
    """Fetch what is not there, and put all of it into `folder`. A study file that is there stays as
    its user left it.

    InputError where the folder holds something else; where a file cannot be had, or is not the
    registered one, and InterruptedWork after Ctrl-C or a signal: what was fetched before is kept.
    """
    if is_complete(example, folder):
        return
    other = read_object(folder / MANIFEST).get("example", example.name)
    if other != example.name:
        message = f"holds the example '{other}'; name a new or an empty folder"
        raise InputError(message, source=folder, code=Code.FOLDER_TAKEN)
    fault: InputError | KeyboardInterrupt | Stopped | None = None
    with atomic_directory(folder, ResultKind.EXAMPLE) as content:
        for file in right_files(example, folder):
            (content / file.name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(folder / file.name, content / file.name)
        try:
            _fetch_rest(example, content, connection, progress)
        except (InputError, KeyboardInterrupt, Stopped) as ending:
            fault = ending
        there = right_files(example, content)
        if fault is not None and not there:
            raise fault
        if (folder / STUDY).is_file():
            shutil.copy2(folder / STUDY, content / STUDY)
        elif example.study:
            (content / STUDY).write_text(example.study.lstrip("\n"), encoding="utf-8")
        (content / SOURCE).write_text(source_text(example), encoding="utf-8")
        manifest = {"gaitcal": package_version("gaitcal"), "example": example.name}
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


def source_text(example: Example) -> str:
    """Whose the recordings are, and under which licence."""
    paragraphs = (
        f"{example.title}. Fetched by 'gaitcal example {example.name}'; the recordings are no part "
        "of gaitcal.",
        f"From: {example.of}",
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
