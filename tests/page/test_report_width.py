"""Tables of the report are read whole: they stand one under the other where two beside each other would be cut."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from gaitcal.page import report_html
from tests.fake_result import fake_calibration
from tests.page.browser import Page

pytestmark = pytest.mark.browser

COLUMNS = "getComputedStyle(document.querySelector('.trial-tables')).gridTemplateColumns.split(' ').length"
CUT = "[...document.querySelectorAll('.trial-tables .scroll')].some(e => e.scrollWidth > e.clientWidth + 1)"


@pytest.mark.parametrize("width", [800, 1200, 1600])
def test_the_two_tables_of_a_trial_are_not_cut(width: int, visit: Callable[..., Page], tmp_path: Path) -> None:
    path = tmp_path / "report.html"
    path.write_text(report_html(fake_calibration()), encoding="utf-8")
    page = visit(path, width, 800)
    assert page.run(COLUMNS) == 1 and not page.run(CUT)


def test_nor_on_paper(visit: Callable[..., Page], tmp_path: Path) -> None:
    path = tmp_path / "report.html"
    path.write_text(report_html(fake_calibration()), encoding="utf-8")
    page = visit(path, 1600, 800)
    page.send("Emulation.setEmulatedMedia", media="print")
    try:
        assert page.run(COLUMNS) == 1
    finally:
        page.send("Emulation.setEmulatedMedia", media="")
