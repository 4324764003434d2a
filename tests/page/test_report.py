"""The page: every section, nothing active, nothing from outside, and what is missing is left out or said."""

from __future__ import annotations

import re
import threading
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from gaitcal.gait.words import segment_words
from gaitcal.model.linkage import SEGMENTS
from gaitcal.page import report_html, write_report
from gaitcal.page.sections.trial_rows import trial_fits
from gaitcal.person.result import Calibration
from tests.fake_result import HOSTILE, Names, fake_calibration, with_phase

VOID = {"meta", "br", "img", "link", "hr", "input"}
ACTIVE = {"script", "iframe", "object", "embed", "link", "img", "form", "input", "base", "foreignobject", "image"}
SECTIONS = ["summary", "fit", "parameters", "gait", "residuals", "change", "assumed", "run"]


class Page(HTMLParser):
    """Parses a page, checks that its tags are balanced, and collects what it holds."""

    def __init__(self, text: str) -> None:
        super().__init__(convert_charrefs=True)
        self.open: list[str] = []
        self.tags: set[str] = set()
        self.ids: list[str] = []
        self.references: set[str] = set()
        self.attributes: list[tuple[str, str]] = []
        self.sections: list[str] = []
        self.text = ""
        self.comments = 0
        self.feed(text)
        self.close()
        assert self.open == [], "tags left open"

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.add(tag)
        for key, value in attrs:
            self.attributes.append((key, value or ""))
            if key == "id":
                self.ids.append(value or "")
            if key in ("href", "xlink:href"):
                self.references.add(value or "")
            self.references.update("#" + r for r in re.findall(r"url\(#([^)]+)\)", value or ""))
        if tag == "section":
            self.sections.append(dict(attrs)["id"] or "")
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.handle_starttag(tag, attrs)
        if tag not in VOID:
            self.open.pop()

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text += data

    def handle_comment(self, data: str) -> None:
        self.comments += 1


@pytest.fixture(scope="module")
def whole() -> Calibration:
    return fake_calibration()


@pytest.fixture(scope="module")
def page(whole: Calibration) -> Page:
    return Page(report_html(whole))


def test_one_marker_has_no_ratio_and_long_notes_are_folded() -> None:
    whole = fake_calibration()
    trial = whole.trials[0]
    floor = replace(trial.floor, distance=np.full_like(trial.floor.distance, 1e-14))
    kept = trial.calibrated.errors.kept
    few = [s for s in SEGMENTS if 0 < int(kept(s).sum()) < 3]
    assert few, "a segment with one or two markers"
    fits = trial_fits(replace(whole, trials=(replace(trial, floor=floor),)))[0]
    assert {f.label for f in fits.segments if f.ratio is None} == {segment_words(s) for s in few}
    assert all(segment_words(s) in fits.few for s in few)
    text = report_html(replace(whole, notes=("short", "long " * 80)))
    assert text.count('<details class="more">') == 1
    assert "long " * 79 in text


def test_every_section_is_there_in_order(page: Page) -> None:
    assert page.sections == SECTIONS
    for words in ("S07", "walk", "rigid-segment floor", "hip centre in the pelvis", "Marker set", "plug-in-gait"):
        assert words.lower() in page.text.lower()


def test_identifiers_are_unique_and_every_reference_finds_one(page: Page) -> None:
    assert len(page.ids) == len(set(page.ids))
    assert {r.removeprefix("#") for r in page.references} <= set(page.ids)


def test_nothing_active_and_nothing_from_outside(whole: Calibration, page: Page) -> None:
    assert not page.tags & ACTIVE
    assert page.comments == 0
    assert not [k for k, _ in page.attributes if k.startswith("on")]
    assert not re.search(r"https?:|//[a-z]|@import|url\((?!#)", report_html(whole))
    assert all(r.startswith("#") for r in page.references)


def test_hostile_names_are_text_and_nothing_else() -> None:
    text = report_html(fake_calibration(Names(HOSTILE, HOSTILE, HOSTILE, HOSTILE, HOSTILE, HOSTILE)))
    page = Page(text)
    assert not page.tags & ACTIVE
    assert not [k for k, _ in page.attributes if k.startswith("on")]
    assert 'alert("x")' in page.text, "the name is shown as it is"
    assert "{{7*7}}" in page.text, "no second round of the template"
    assert "\u202e" not in text, "nothing turns the writing direction"
    assert "/home/somebody" not in text, "folders stay private"


@pytest.mark.parametrize(
    "names",
    [
        Names("x" * 5000, "y" * 5000, "z" * 5000),
        Names("$", "$a$", r"\$\alpha$"),
        Names("中文 é ß 👟", "\x00\x1b[31m\n", "%s {0} {{x}} {% raw %}"),
    ],
)
def test_odd_names_are_drawn(names: Names) -> None:
    page = Page(report_html(fake_calibration(names, plates=False)))
    assert page.sections[0] == "summary"


def test_warnings_come_first_and_name_parameters_in_words(page: Page) -> None:
    summary = page.text[page.text.index("Summary") :]
    assert summary.index("Verdict: doubtful") < summary.index("Does the model follow the markers?")
    assert "knee axis in the thigh, frontal tilt" in summary.split("Does the model")[0]


def test_parameters_that_cannot_be_seen_are_said_in_words(page: Page) -> None:
    assert "Not determined by these trials" in page.text
    assert "Right subtalar: subtalar axis in the foot, transverse turn" in page.text
    assert "not determined" in page.text and "at its bound" in page.text


def test_not_converged_is_told_before_all_else(whole: Calibration) -> None:
    text = Page(report_html(with_phase(whole, False))).text
    assert text.index("Not converged") < text.index("Verdict: doubtful")


def test_the_manifest_that_is_given_is_shown(whole: Calibration) -> None:
    text = Page(report_html(whole, manifest={"gaitcal": "9.8.7", "a": {"b": [1, 2], "c": None}})).text
    assert "9.8.7" in text and "a.b" in text and "1, 2" in text


@pytest.mark.parametrize(
    "lacks, gone, said",
    [
        ({"gait": False}, {"gait", "residuals", "change"}, "that needs a walking trial"),
        ({"plates": False}, {"residuals", "change"}, "this trial has no force plates"),
        ({"valid": False}, {"residuals", "change"}, "in no frame is a foot on the ground"),
        ({"errors": False}, set(), "curves have no bands"),
        ({"joint": False}, set(), "Joint parameters were not calibrated"),
        ({"cycles": False}, set(), "Drawn against time"),
        ({"isolated": False}, set(), "0 to 100 % of the gait cycle"),
        ({"gait": False, "isolated": False, "joint": False}, {"gait", "residuals", "change"}, "no moving trial"),
    ],
)
def test_what_is_missing_is_left_out_or_said(lacks: dict[str, bool], gone: set[str], said: str) -> None:
    page = Page(report_html(fake_calibration(**lacks)))
    assert page.sections == [s for s in SECTIONS if s not in gone]
    assert said in " ".join(page.text.split())
    assert "nan" not in page.text.lower().split() and "None" not in page.text


def test_without_standard_errors_no_interval_is_claimed() -> None:
    text = Page(report_html(fake_calibration(errors=False))).text
    assert "Change ± SE" not in text
    assert "none were computed" in text


def test_frozen_coordinates_are_named_and_not_drawn(whole: Calibration) -> None:
    frozen = ("arm_flex_r", "arm_flex_l", "arm_add_r", "arm_add_l", "elbow_flex_r", "elbow_flex_l")
    page = Page(report_html(replace(whole, model=replace(whole.model, frozen=frozen))))
    assert "arm flex r" in page.text
    assert not [v for k, v in page.attributes if k == "aria-label" and "Elbow" in v]


def test_it_is_written_as_one_file(whole: Calibration, tmp_path: Path) -> None:
    write_report(whole, tmp_path / "report.html")
    text = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert text.startswith("<!DOCTYPE html>") and len(text) < 3_000_000
    assert [p.name for p in tmp_path.iterdir()] == ["report.html"]


def test_two_reports_at_once_are_the_same_as_one(whole: Calibration) -> None:
    def strip(text: str) -> str:
        return re.sub(r"<dt>Made</dt><dd>[^<]*", "", text)

    made: list[str] = []
    threads = [threading.Thread(target=lambda: made.append(strip(report_html(whole)))) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert made[0] == made[1] == strip(report_html(whole))
