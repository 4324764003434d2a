"""Which public recordings can be fetched: `models/examples.toml`, read once, checked once."""

from __future__ import annotations

from functools import cache
from pathlib import PurePosixPath
from urllib.parse import urlsplit

from pydantic import Field, field_validator

from gaitcal.errors import UsageError, nearest
from gaitcal.io.package_data import models_path
from gaitcal.io.validation import Table, read_validated

REGISTRY = "examples.toml"


class RemoteFile(Table):
    """`[[example.file]]`: a recording at its public address."""

    name: str = Field(max_length=200)
    """Where it is put, below the folder of the example: `HC002D/static.c3d`."""
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
    of: str = Field(alias="from")
    """Who published them."""
    repository: str
    commit: str
    licence: str
    """SPDX identifier."""
    licence_text: str
    """Address of its text."""
    cite: str
    remark: str
    """What the recordings do not tell and the example therefore assumes."""
    command: str
    """Of gaitcal, to run next; `{dir}` is the folder."""
    study: str | None = None
    """Content of a study file to put beside the recordings."""
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
    """The example of this name; UsageError, with the nearest name or all names, where there is none."""
    names = [example.name for example in examples()]
    if name not in names:
        hint = nearest(name, names) or f"; allowed: {', '.join(names)}"
        raise UsageError(f"found '{name[:40]}', which is no example{hint}", field="NAME")
    return next(example for example in examples() if example.name == name)
