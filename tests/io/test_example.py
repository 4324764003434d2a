"""`gaitcal example`: fetched from a server on this machine, with what can go wrong on the way."""

import json
import re
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from hashlib import sha256
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from urllib.parse import quote, urlsplit

import pytest

from gaitcal.cli.console import Console
from gaitcal.cli.explain_command import fetch_or_list as run
from gaitcal.errors import Code
from gaitcal.io import examples as example_folder
from gaitcal.io.atomic import InterruptedWork
from gaitcal.io.examples import (
    SOURCE,
    STUDY,
    Connection,
    DownloadProgress,
    Example,
    RemoteFile,
    download,
    fetch_example,
    find_example,
    is_complete,
    load_examples,
)
from gaitcal.io.toml import validate_table
from gaitcal.study.study import Study
from gaitcal.study.study_file import StudyFile
from tests.commands import gaitcal
from tests.messages import refuses

ROOT = Path(__file__).parents[2]
HOST = "https://example.org"
TRIES = 2
CONTENT = {
    "walk.trc": b"markers" * 3000,
    "people/static.c3d": bytes(range(256)) * 40,
    "forces.mot": b"forces\n" * 500,
}
HERE = {
    "subject01": "subject01",
    "hospital-walks": "labs_c3d/multi",
    "knee-device": "labs_c3d/kad",
    "children": "children",
    "joint-trials": "functional_c3d",
}
"""Example -> the folder of the recordings that the other tests use."""


@dataclass
class Served:
    """What the server has, what it does wrong, and what it was asked for."""

    files: dict[str, bytes]
    status: dict[str, int] = field(default_factory=dict)
    """Path -> HTTP status instead of the file."""
    cut: dict[str, list[int]] = field(default_factory=dict)
    """Path -> bytes after which the answers break off, one after the other; then the whole file."""
    moved: dict[str, str] = field(default_factory=dict)
    asked: list[str] = field(default_factory=list)
    headers: list[dict[str, str]] = field(default_factory=list)
    address: str = ""


@contextmanager
def serving(served: Served) -> Iterator[Served]:
    """Serve on a free port of this machine, while inside."""

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            served.asked.append(self.path)
            served.headers.append(dict(self.headers))
            if target := served.moved.get(self.path):
                self.send_response(302)
                self.send_header("Location", target)
                self.end_headers()
                return
            content = served.files.get(self.path)
            status = served.status.get(self.path, 404 if content is None else 200)
            self.send_response(status)
            if status != 200 or content is None:
                self.end_headers()
                return
            self.send_header("Content-Length", str(len(content)))
            self.end_headers()
            cuts = served.cut.get(self.path, [])
            self.wfile.write(content[: cuts.pop(0)] if cuts else content)

        def log_message(self, format: str, *args: object) -> None:
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02})
    thread.start()
    served.address = f"http://127.0.0.1:{server.server_address[1]}"
    try:
        yield served
    finally:
        server.shutdown()
        server.server_close()
        thread.join()


def path_of(name: str) -> str:
    return "/owner/project/0123abcd/" + quote(f"some data/{name}")


def example(name: str = "small") -> Example:
    """One of the registered examples with files of our own, on another host."""
    files = tuple(
        RemoteFile(
            name=file,
            url=f"{HOST}{path_of(file)}",
            bytes=len(data),
            sha256=sha256(data).hexdigest(),
        )
        for file, data in CONTENT.items()
    )
    known = {"name": name, "commit": "0123abcd", "study": "[subject]\n", "files": files}
    return find_example("subject01").model_copy(update=known)


@pytest.fixture
def server() -> Iterator[Served]:
    with serving(Served({path_of(name): data for name, data in CONTENT.items()})) as served:
        yield served


def fetch(target: Path, server: Served, one: Example | None = None) -> list[DownloadProgress]:
    steps: list[DownloadProgress] = []
    fetch_example(
        one or example(), target, Connection(mirror=server.address, tries=TRIES), steps.append
    )
    return steps


def asked(server: Served) -> list[str]:
    """What was asked for since the last time."""
    paths, server.asked[:] = list(server.asked), []
    return paths


def content(folder: Path) -> dict[str, bytes]:
    there = {
        p.relative_to(folder).as_posix(): p.read_bytes() for p in folder.rglob("*") if p.is_file()
    }
    return {name: data for name, data in there.items() if name in CONTENT}


def test_recordings_are_fetched_and_told_whose_they_are(server: Served, tmp_path: Path) -> None:
    steps = fetch(tmp_path / "small", server)
    assert content(tmp_path / "small") == CONTENT
    assert (tmp_path / "small" / STUDY).read_text() == "[subject]\n"
    words, one = " ".join((tmp_path / "small" / SOURCE).read_text().split()), example()
    told = (one.publisher, one.commit, one.licence, one.licence_text, one.cite, one.remark)
    assert [word for word in told if word not in words] == []
    assert all(file.url in words and file.sha256 in words for file in one.files)
    manifest = json.loads((tmp_path / "small/manifest.json").read_text())
    assert (manifest["kind"], manifest["example"]) == ("example recordings", "small")
    assert [step.done for step in steps] == sorted(step.done for step in steps)
    assert steps[-1] == DownloadProgress("forces.mot", example().size, example().size)


def test_requests_hold_nothing_of_the_user_and_ask_once(server: Served, tmp_path: Path) -> None:
    for _ in range(2):
        fetch(tmp_path / "small", server)
    assert is_complete(example(), tmp_path / "small")
    assert server.asked == [path_of(name) for name in CONTENT]
    for headers in server.headers:
        assert set(headers) == {"Accept-Encoding", "Accept", "Host", "User-Agent", "Connection"}
        assert headers["User-Agent"] == "gaitcal example"


def test_a_damaged_file_is_fetched_anew_and_an_edited_study_stays(
    server: Served, tmp_path: Path
) -> None:
    fetch(tmp_path / "small", server)
    (tmp_path / "small/walk.trc").write_bytes(b"damaged")
    (tmp_path / "small" / STUDY).write_text("mine")
    asked(server)
    fetch(tmp_path / "small", server)
    assert asked(server) == [path_of("walk.trc")]
    assert content(tmp_path / "small") == CONTENT
    assert (tmp_path / "small" / STUDY).read_text() == "mine"


def test_a_missing_file_keeps_what_was_fetched_before(server: Served, tmp_path: Path) -> None:
    server.status[path_of("forces.mot")] = 404
    with refuses(Code.DOWNLOAD, 404, 2, 3, "small", source="forces.mot"):
        fetch(tmp_path / "small", server)
    assert set(content(tmp_path / "small")) == {"walk.trc", "people/static.c3d"}
    server.status.clear()
    asked(server)
    fetch(tmp_path / "small", server)
    assert asked(server) == [path_of("forces.mot")]
    assert content(tmp_path / "small") == CONTENT


@pytest.mark.parametrize(
    "fault",
    [
        lambda s: s.files.clear(),
        lambda s: s.cut.update({path_of("walk.trc"): [1000, 2000]}),
        lambda s: s.status.update({path_of("walk.trc"): 503}),
        lambda s: s.files.update({path_of("walk.trc"): b"x" * 21000}),
        lambda s: s.moved.update({path_of("walk.trc"): "file:///etc/hostname"}),
    ],
)
def test_where_nothing_came_nothing_is_left(
    server: Served, tmp_path: Path, fault: Callable[[Served], None]
) -> None:
    """No file, a connection or a server that fails each time, another file, and a mirror that leads
    to this machine.
    """
    fault(server)
    with refuses(Code.DOWNLOAD, source="walk.trc") as caught:
        fetch(tmp_path / "small", server)
    assert caught.value.code is Code.DOWNLOAD
    assert server.asked == [path_of("walk.trc")] * TRIES
    assert list(tmp_path.iterdir()) == []


def test_a_file_that_is_too_long_is_not_read_to_its_end(server: Served, tmp_path: Path) -> None:
    server.files[path_of("walk.trc")] = b"x" * 10**6
    with refuses(Code.DOWNLOAD, 21000, source="walk.trc"):
        fetch(tmp_path / "small", server)
    assert server.asked == [path_of("walk.trc")]
    assert list(tmp_path.iterdir()) == []


def test_a_fault_that_passes_is_tried_again(server: Served, tmp_path: Path) -> None:
    server.cut[path_of("walk.trc")] = [1000]
    fetch(tmp_path / "small", server)
    assert content(tmp_path / "small") == CONTENT


def test_no_network_is_one_line(tmp_path: Path) -> None:
    with serving(Served({})) as gone:
        pass
    with refuses(Code.DOWNLOAD, 2, source="walk.trc") as fault:
        fetch(tmp_path / "small", gone)
    assert len(str(fault.value).splitlines()) == 1


def test_a_folder_may_be_the_mirror(tmp_path: Path) -> None:
    for name, data in CONTENT.items():
        file = tmp_path / "copy/owner/project/0123abcd/some data" / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(data)
    connection = Connection(mirror=(tmp_path / "copy").as_uri(), tries=1)
    fetch_example(example(), tmp_path / "small", connection, lambda step: None)
    assert content(tmp_path / "small") == CONTENT
    with refuses(Code.DOWNLOAD, source="none"):
        download(
            RemoteFile(name="a", url="https://example.org/none", bytes=1, sha256="0" * 64),
            tmp_path / "a",
            connection,
            lambda size: None,
        )


@pytest.mark.parametrize("mirror", ["copy", "ftp://host/x", "https:///x", "javascript:alert(1)"])
def test_a_mirror_that_cannot_be_is_refused(mirror: str) -> None:
    with refuses(Code.OPTION, field="--mirror"):
        Connection(mirror=mirror)


def test_ctrl_c_keeps_what_is_complete(
    server: Served, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(file: RemoteFile, *rest: object) -> None:
        if file.name == "forces.mot":
            raise KeyboardInterrupt
        download(file, *rest)

    monkeypatch.setattr(example_folder, "download", interrupted)
    with refuses(InterruptedWork, 2, 3) as ending:
        fetch(tmp_path / "small", server)
    assert ending.value.exit_code == 130
    assert set(content(tmp_path / "small")) == {"walk.trc", "people/static.c3d"}
    assert [p.name for p in tmp_path.iterdir()] == ["small"]


def test_other_files_are_left_alone(server: Served, tmp_path: Path) -> None:
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine/notes.txt").write_text("mine")
    with refuses(Code.FOLDER_TAKEN, "notes.txt", source="mine"):
        fetch(tmp_path / "mine", server)
    fetch(tmp_path / "small", server)
    with refuses(Code.FOLDER_TAKEN, source="small"):
        fetch(tmp_path / "small", server, example("other"))
    assert server.asked == [path_of(name) for name in CONTENT]


# ----------------------------------------------------------------------------------------- registry


def test_the_registry_names_public_files_of_one_commit() -> None:
    assert [one.name for one in load_examples()] == list(HERE)
    for one in load_examples():
        place = f"{urlsplit(one.repository).path}/{one.commit}/"
        assert re.fullmatch("[0-9a-f]{40}", one.commit)
        assert one.hosts == ("raw.githubusercontent.com",)
        assert all(urlsplit(file.url).path.startswith(place) for file in one.files)
        assert one.commit in one.licence_text and one.licence in ("Apache-2.0", "MIT")
        assert "{dir}" in one.command
        assert len({file.name for file in one.files}) == len(one.files)
        if one.study:
            from gaitcal.io.toml import tomllib

            study = validate_table(StudyFile, tomllib.loads(one.study), "study.toml")
            named = {str(trial.file) for trial in study.trials} | {
                str(t.forces) for t in study.trials if t.forces
            }
            assert named <= {file.name for file in one.files}


def test_the_registered_files_are_those_the_other_tests_use(data_dir: Path) -> None:
    for one in load_examples():
        for file in one.files:
            here = data_dir / HERE[one.name] / file.name
            assert here.stat().st_size == file.bytes, file.name
            assert sha256(here.read_bytes()).hexdigest() == file.sha256, file.name


@pytest.mark.parametrize(
    "change", [{"name": "../x"}, {"name": "/x"}, {"url": "http://example.org/x"}, {"bytes": 0}]
)
def test_a_registry_file_that_leads_elsewhere_is_refused(change: dict[str, object]) -> None:
    good = {"name": "x", "url": "https://example.org/x", "bytes": 1, "sha256": "0" * 64}
    validate_table(RemoteFile, good, "examples.toml")
    with refuses(Code.BAD_VALUE, source="examples.toml"):
        validate_table(RemoteFile, {**good, **change}, "examples.toml")


def test_nothing_else_asks_the_network() -> None:
    """Only the module that fetches examples imports a library that asks another machine."""
    asks = re.compile(
        r"^\s*(?:import|from) (urllib\.(?:request|error)|"
        r"http\.client|pooch|requests|httpx|ftplib|smtplib)",
        re.M,
    )
    found = {
        path.relative_to(ROOT).as_posix()
        for path in (ROOT / "gaitcal").rglob("*.py")
        if asks.search(path.read_text(encoding="utf-8"))
    }
    assert found == {"gaitcal/io/examples.py"}


# ------------------------------------------------------------------------------------------ command


def mirrored(data: Path, name: str) -> Served:
    files = find_example(name).files
    return Served(
        {urlsplit(file.url).path: (data / HERE[name] / file.name).read_bytes() for file in files}
    )


def test_the_command_lists_the_examples_and_refuses_others() -> None:
    done = gaitcal("example")
    assert done.returncode == 0, done.stderr
    assert all(one.name in done.stdout and one.licence in done.stdout for one in load_examples())
    done = gaitcal("example", "subject02")
    assert done.returncode == 2 and "did you mean 'subject01'?" in done.stderr
    with refuses(Code.OPTION, field="--out"):
        run(Console(quiet=True, verbose=False), out=Path("somewhere"))


def test_the_command_says_whose_it_fetches_and_what_comes_next(
    data_dir: Path, tmp_path: Path
) -> None:
    with serving(mirrored(data_dir, "subject01")) as server:
        done = gaitcal(
            "example", "subject01", "--out", str(tmp_path / "s"), "--mirror", server.address
        )
        again = gaitcal(
            "example", "subject01", "--out", str(tmp_path / "s"), "--mirror", "http://127.0.0.1:9"
        )
    assert done.returncode == 0, done.stderr
    for told in ("the OpenSim project", "Apache-2.0", "4 files, 0.9 MB", server.address, SOURCE):
        assert told in done.stdout
    assert (
        f"next:  gaitcal calibrate {tmp_path}/s/study.toml --out {tmp_path}/s-result" in done.stdout
    )
    assert again.returncode == 0 and "nothing is fetched" in again.stdout
    assert Study.load(tmp_path / "s/study.toml").trials
