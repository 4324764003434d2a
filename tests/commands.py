"""The command line in the process of the tests, and what is in the folders that it writes."""

import io
import json
import sys
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from click.testing import Result
from typer.testing import CliRunner

from gaitcal import cli
from gaitcal.cli.application import app
from gaitcal.errors import InputError
from gaitcal.io.result_folder import HASHES, MANIFEST, SELF_HASH, compute_sha256, hash_manifest


@dataclass(frozen=True)
class Done:
    """What a shell would see of a program that has ended."""

    returncode: int
    stdout: str
    stderr: str


def gaitcal(*words: object) -> Done:
    """The whole program: errors are its one line on stderr, and its exit code."""
    out, err = io.StringIO(), io.StringIO()
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(out), redirect_stderr(err):
        patch.setattr(sys, "argv", ["gaitcal", *map(str, words)])
        try:
            cli.main()
            code = 0
        except SystemExit as ending:
            code = int(ending.code or 0)
    return Done(code, out.getvalue(), err.getvalue())


def run(*words: object) -> Result:
    """One command; its errors are raised."""
    return CliRunner().invoke(app, list(map(str, words)), catch_exceptions=False)


def tried(*words: object) -> Result:
    """One command; the result has its error."""
    return CliRunner().invoke(app, list(map(str, words)))


def content(folder: Path) -> dict[str, bytes]:
    """Every file in a folder and below."""
    return {
        p.relative_to(folder).as_posix(): p.read_bytes()
        for p in sorted(folder.rglob("*"))
        if p.is_file()
    }


def sign(result: Path) -> None:
    """The manifest of a result as if `gaitcal` had written the files as they are."""
    manifest = json.loads((result / MANIFEST).read_text(encoding="utf-8"))
    manifest[HASHES] = {name: compute_sha256(result / name) for name in manifest.get(HASHES, {})}
    (result / MANIFEST).write_text(
        json.dumps({**manifest, SELF_HASH: hash_manifest(manifest)}), encoding="utf-8"
    )


@contextmanager
def edited(result: Path, name: str) -> Iterator[dict[str, Any]]:
    """A JSON file of a result, which becomes what is left of it at the end; the manifest is signed
    anew.
    """
    data: dict[str, Any] = json.loads((result / name).read_text(encoding="utf-8"))
    yield data
    (result / name).write_text(json.dumps(data), encoding="utf-8")
    sign(result)


@contextmanager
def refused(told: str) -> Iterator[None]:
    """The body ends in an error of input: one line, which holds these words as they stand."""
    with pytest.raises(InputError) as caught:
        yield
    assert told in str(caught.value) and "\n" not in str(caught.value)
