"""The documentation against the program: nothing without a page, blocks of the right form, a site
without a warning.
"""

import subprocess
import sys
from pathlib import Path

import pytest

import gaitcal
from scripts.tools import make_pictures
from scripts.tools.documentation import __main__ as check
from tests.docs.pages import DOCS, NOT_RUN, ROOT, blocks_of, lint
from tests.kept import kept_result
from tests.report.page.browser import browser, chromium

PAGES = sorted(DOCS.rglob("*.md"))
SEARCH = """new Promise(done => setTimeout(done, 3000)).then(() => {
    const field = document.querySelector("input.md-search__input");
    document.querySelector("#__search").click();
    field.focus();
    field.value = "why masses nearly never move";
    for (const kind of ["input", "keyup"]) field.dispatchEvent(new Event(kind, { bubbles: true }));
})"""


def test_everything_is_explained(capsys: pytest.CaptureFixture[str]) -> None:
    assert check.main([]) == 0, capsys.readouterr().err


@pytest.mark.parametrize("page", PAGES, ids=[str(page.relative_to(DOCS)) for page in PAGES])
def test_blocks_have_the_form_of_their_language(page: Path) -> None:
    for block in blocks_of(page):
        assert lint(block) == "", f"{page}:{block.line}"
        if block.language in ("sh", "python") and page.parent.name not in ("tutorials", "how-to"):
            assert block.title.startswith(NOT_RUN), (
                f"{page}:{block.line}: only tutorials and how-to pages are run"
            )


def test_studies_in_pages_are_studies() -> None:
    """Every TOML block that is a whole study has the keys and values of one."""
    from gaitcal.io.toml import tomllib
    from gaitcal.study.study_file import StudyFile

    seen = 0
    for page in PAGES:
        for block in blocks_of(page):
            if block.language == "toml" and "[[trial]]" in block.text and "[subject]" in block.text:
                StudyFile.model_validate(tomllib.loads(block.text))
                seen += 1
    assert seen >= 3


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The built site; an error where the build says a warning."""
    pytest.importorskip("mkdocs", reason="extra `docs`")
    folder = tmp_path_factory.mktemp("documentation") / "site"
    command = [
        sys.executable,
        "-m",
        "mkdocs",
        "build",
        "--strict",
        "--quiet",
        "--site-dir",
        str(folder),
    ]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return folder


@pytest.mark.slow
def test_the_site_asks_nothing_of_the_network_and_explains_its_types(
    site: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert check.main(["--site", str(site)]) == 0, capsys.readouterr().err
    page = (site / "reference" / "python.html").read_text(encoding="utf-8")
    assert all(f'id="gaitcal.{name}"' in page for name in gaitcal.__all__)
    assert "<strong>Raises</strong>" in page, "sections of docstrings are lists"
    assert not [
        place for place in site.rglob("*.html") if "<p>{{ " in place.read_text(encoding="utf-8")
    ]


@pytest.mark.slow
@pytest.mark.browser
def test_search_works_without_a_server_or_a_network(site: Path, tmp_path: Path) -> None:
    binary = chromium()
    if binary is None:
        pytest.skip("no Chromium on the path")
    with browser(tmp_path, binary) as page:
        page.open((site / "how-to" / "figures.html").as_uri())
        page.run(SEARCH)
        for _ in range(60):
            page.run("new Promise(done => setTimeout(done, 500))")
            if page.run("document.querySelectorAll('.md-search-result__item').length"):
                break
        assert "masses.html" in page.run("document.querySelector('.md-search-result__item a').href")
        assert [url for url in page.requests if not url.startswith(("file:", "data:"))] == []


def test_what_a_page_loads_from_elsewhere_is_told(tmp_path: Path) -> None:
    text = (
        '<a class="x" href="https://example.org">y</a><link rel="canonical" '
        'href="https://example.org/a.html">'
    )
    text += (
        '<img src="own.png"><img alt="x" src="https://example.org/x.png"><script '
        "src=//example.org/x.js></script>"
    )
    text += (
        '<span class="n" title="gaitcal.study.study.Study">Study</span><span '
        'title="gaitcal.GAIT">GAIT</span>'
    )
    (tmp_path / "python.html").write_text(text, encoding="utf-8")
    loaded, other, unknown = check.faults_of(tmp_path)
    assert loaded == "python.html: loads https://example.org/x.png" and other.endswith(
        " //example.org/x.js"
    )
    assert unknown == "type without a page: gaitcal.study.study.Study"


@pytest.mark.slow
@pytest.mark.browser
def test_pictures_are_taken(kept: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    if chromium() is None:
        pytest.skip("no Chromium on the path")
    words = ["--result", str(kept_result(kept) / "result"), "--out", str(tmp_path / "pictures")]
    make_pictures.main([*words, "--only", "page-trust", "--only", "error-sources"])
    sizes = {path.stem: len(path.read_bytes()) for path in (tmp_path / "pictures").iterdir()}
    assert set(sizes) == {"page-trust", "error-sources"} and min(sizes.values()) > 10_000
    assert "page-trust.png: " in capsys.readouterr().out
