"""`cohort.html` in a browser: who is shown, in which order, what is drawn of them, and whether
everybody can use it.
"""

import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gaitcal.cohort.one_person import STEPS
from gaitcal.gait.cycles import CurveKind
from tests.cohort.made_people import FORCES, KNEE, Kept, some_people, write_cohort
from tests.report.page.browser import SETTLED, Page, Visit
from tests.report.page.test_accessible import FAULTS, SIZES, SMALL, TARGET, UNNAMED

pytestmark = [pytest.mark.browser, pytest.mark.slow]

NAMES = """[...document.querySelectorAll('.people-table tbody tr')]
    .filter(row => row.dataset.person).map(row => gaitcal.people.name(Number(row.dataset.person)))"""
HOSTILE = "<img src=x onerror=window.hacked=1></script><script>window.hacked=1</script>"
ADDRESS = "new Promise(done => setTimeout(() => done(location.hash), 400))"
STEP = STEPS[CurveKind.ANGLE]


@pytest.fixture(scope="module")
def cohort(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_cohort(tmp_path_factory.mktemp("cohort") / "out", some_people())


@pytest.fixture
def page(visit: Visit, cohort: Path) -> Iterator[Page]:
    """The page as it opens; nothing is requested, nothing complained of."""
    opened = visit(cohort, 1280, 800)
    opened.run(SETTLED)
    yield opened
    assert opened.console == []
    assert opened.requests == [cohort.as_uri()]


def write(page: Page, selector: str, text: str) -> None:
    page.run(
        f"""(input => {{ input.value = {text!r}; input.dispatchEvent(new Event('input', {{bubbles: true}})) }})
        (document.querySelector({selector!r}))"""
    )


def test_it_opens_with_those_who_need_a_look_first(page: Page) -> None:
    assert page.run(NAMES) == ["Cid", "Bob", "Ann", "Dan post", "Dan pre", "Eve"]
    cards = page.run(
        "[...document.querySelectorAll('.triage .card')].map(card => card.textContent)"
    )
    assert [card.split("not ")[0].split("to be")[0].split("no")[0] for card in cards] == [
        "Refused1", "Doubtful1", "Trustworthy4", "Failed1"
    ]  # fmt: skip
    causes = page.run(
        "[...document.querySelectorAll('.causes tbody tr')].map(row => "
        "row.innerText.split(/\\s*[\\t\\n]+\\s*/))"
    )
    assert (causes[0][0], causes[0][-2].strip()) == (
        "The knee axis passes far from the epicondyles",
        "2",
    )
    assert len(causes) == 3
    sentence = page.run("document.getElementById('sentence').textContent")
    assert sentence.startswith(
        "6 people, 7 sessions in 2 groups: 6 results, 1 without, by gaitcal "
    )
    assert (
        page.run("document.querySelector('#failures tbody').textContent")
        == "Zedbthe static trial is restlessrecord it again"
    )
    assert (
        page.run("document.querySelector('tr[data-person] a').getAttribute('href')")
        == "./people/Cid/result.html"
    )


def test_triage_and_causes_filter(page: Page) -> None:
    page.click(".triage li:nth-child(1) .card")
    assert page.run(NAMES) == ["Cid"]
    assert (
        page.run("document.querySelector('.triage .card').getAttribute('aria-pressed')") == "true"
    )
    page.click(".triage li:nth-child(1) .card")
    page.click(".causes tbody tr:nth-child(1) button")
    assert page.run(NAMES) == ["Cid", "Bob"]
    assert KNEE[1] in page.run("document.querySelector('.chips').textContent")
    page.click(".chips .chip")
    assert len(page.run(NAMES)) == 6
    assert (
        FORCES[1] in page.run("document.querySelector('tr[data-person=\"2\"]').textContent").lower()
    )


def test_trustworthy_without_a_stride_is_said_and_filtered(visit: Visit, tmp_path: Path) -> None:
    known = {"walks": 1, "strides_r": 1, "strides_l": 2, "adduction_moment_r": 0.4}
    people = [
        Kept(name="Ann", row=known),
        *(Kept(name=n, row={"walks": 1, "strides_r": 0, "strides_l": 0}) for n in "BC"),
    ]
    page = visit(write_cohort(tmp_path / "out", people), 1280, 800)
    page.run(SETTLED)
    cards = page.run(
        "[...document.querySelectorAll('.triage .card')].map(card => card.textContent)"
    )
    assert ["of these 2 without a usable stride" in card for card in cards] == [
        False,
        False,
        True,
        False,
    ]
    row = page.run("document.querySelector('.causes tbody tr').innerText")
    assert row.startswith("No stride of these walks") and "info" in row
    page.click(".causes tbody tr button")
    assert page.run(NAMES) == ["B", "C"]


def test_a_column_of_peaks_says_in_which_phase_they_are(page: Page) -> None:
    heads = page.run("""[...document.querySelectorAll('.people-table thead button')]
        .filter(button => button.textContent.startsWith('Knee flexion'))
        .map(button => [button.textContent, button.title])""")
    assert len(heads) == 2
    for label, tooltip in heads:
        assert label.startswith("Knee flexion, peak in swing")
        assert "mean of each stride's peak" in tooltip


def test_numbers_words_and_groups_filter(page: Page) -> None:
    speed = "[aria-label='Filter Speed']"
    for text, names in {
        ">1.05": ["Bob", "Ann", "Dan post"],
        "0,8 .. 1.1": ["Ann", "Dan pre"],
        "<= 0.9": ["Cid", "Dan pre"],
        "?": ["Eve"],
        "=1.40": ["Bob"],
        ">1.4": [],
    }.items():
        write(page, speed, text)
        assert page.run(NAMES) == names, text
    write(page, speed, "fast")
    assert len(page.run(NAMES)) == 6
    assert page.run(f'document.querySelector("{speed}").getAttribute("aria-invalid")') == "true"
    write(page, speed, "")
    write(page, "#find", "da")
    assert page.run(NAMES) == ["Dan post", "Dan pre"]
    write(page, "#find", "")
    page.run("gaitcal.choices.set({group: 'b'})")
    assert page.run(NAMES) == ["Dan post", "Dan pre", "Eve"]
    assert page.run("document.querySelector('.count').textContent") == "3 of 6 shown"


def test_a_press_on_a_name_sorts_and_who_has_no_value_is_last(page: Page) -> None:
    def speed(press: bool = True) -> Any:
        return page.run(
            f"""(head => {{ if ({str(press).lower()}) head.querySelector('button').click(); return head.ariaSort }})
            ([...document.querySelectorAll('.people-table thead th')]
                .find(head => head.textContent.startsWith('Speed')))"""
        )

    assert (speed(), page.run(NAMES)) == (
        "ascending",
        ["Cid", "Dan pre", "Ann", "Dan post", "Bob", "Eve"],
    )
    assert (speed(), page.run(NAMES)) == (
        "descending",
        ["Bob", "Dan post", "Ann", "Dan pre", "Cid", "Eve"],
    )
    speed()
    assert (speed(press=False), page.run(NAMES)) == (
        None,
        ["Ann", "Bob", "Cid", "Dan post", "Dan pre", "Eve"],
    )


def test_what_is_chosen_stands_in_the_address(page: Page, visit: Visit, cohort: Path) -> None:
    page.run(
        """gaitcal.choices.set({group: 'a', sort: '-speed', columns: ['person', 'speed_r'],
            tests: new Map([['speed_r', '>0.9']])})"""
    )
    address = page.run(ADDRESS)
    assert len(address) > 10
    visit("about:blank")
    other = visit(cohort.as_uri() + address, 1280, 800)
    assert other.run(NAMES) == ["Bob", "Ann"]
    assert (
        other.run("document.querySelectorAll('.people-table thead tr:first-child th').length") == 2
    )
    visit("about:blank")
    garbage = (
        "#verdict=x&sort=nobody&tests=[[1,2],3]&shown=%7B%7D&columns=,,&rows=-1&page=99&measures=no"
    )
    wrong = visit(cohort.as_uri() + garbage, 1280, 800)
    assert len(wrong.run(NAMES)) == 6
    wrong.requests[:] = [cohort.as_uri()]


def test_columns_are_chosen_from_all(page: Page) -> None:
    page.click("#people .bar button")
    assert page.run("document.getElementById('chooser').open")
    write(page, "#chooser input[type=search]", "knee_flexion_swing_l")
    assert page.run("[...document.querySelectorAll('.column-list li:not([hidden])')].length") == 2
    page.run("[...document.querySelectorAll('.column-list li:not([hidden]) input')].at(-1).click()")
    assert page.run("gaitcal.choices.columns.at(-1)") == "knee_flexion_swing_l"
    assert page.run(
        "document.querySelector('.people-table thead th:last-child').textContent"
    ).startswith("knee_flexion_swing_l")


def mean_of(page: Page, group: str) -> list[float]:
    """Mean, standard deviation and number of people of a group, of the first variable at the
    beginning.
    """
    script = f"""(found => found ? [found.mean[0], Number.isNaN(found.sd[0]) ? null : found.sd[0], found.people] : null)
        (gaitcal.people.means(gaitcal.choices, 0).get({group!r}))"""
    return page.run(script)


def test_every_person_counts_the_same_and_refused_legs_do_not(page: Page) -> None:
    # Ann's legs have 100 and 200, Bob 300; Cid is refused. Dan's sessions have 10 and 30, Eve 100.
    np.testing.assert_allclose(
        mean_of(page, "a"), [225 * STEP, np.std([150, 300], ddof=1) * STEP, 2]
    )
    np.testing.assert_allclose(mean_of(page, "b"), [60 * STEP, np.std([20, 100], ddof=1) * STEP, 2])
    page.run("gaitcal.choices.set({legs: 'l'})")
    np.testing.assert_allclose(mean_of(page, "a")[0], 250 * STEP)
    assert mean_of(page, "b")[2] == 1  # of Dan's left leg nothing is known
    page.run("gaitcal.choices.set({legs: 'both', doubtful: false})")
    assert mean_of(page, "a") == [pytest.approx(150 * STEP), None, 1]
    page.run("gaitcal.choices.set({verdict: 'refused'})")
    assert page.run("gaitcal.people.means(gaitcal.choices, 0).size") == 0


def test_a_ticked_person_is_drawn_over_the_means(page: Page) -> None:
    page.run("document.getElementById('means').scrollIntoView()")
    page.run(SETTLED)
    assert page.run("document.querySelectorAll('.mean-plot canvas').length") >= 3
    before = page.run("document.querySelector('.mean-plot canvas').toDataURL()")
    page.click("tr[data-person='1'] input")
    page.run(SETTLED)
    assert page.run("document.querySelector('.mean-plot canvas').toDataURL()") != before
    assert "Bob" in page.run("document.querySelector('.mean-legend').textContent")
    page.click("tr[data-person='0'] td:last-child")
    assert page.run("gaitcal.choices.shown") == [1, 0]
    assert page.run("document.querySelector('.mean-panel').getAttribute('aria-label')").startswith(
        "Hip flexion, deg, over the stride. a: 2 people"
    )


def test_dots_are_people_and_keys_go_from_one_to_the_next(page: Page) -> None:
    page.run("document.getElementById('distributions').scrollIntoView()")
    page.run(SETTLED)
    lanes = "document.querySelector('.strip-lanes')"
    assert page.run(f"{lanes}.querySelectorAll('circle').length") == 5
    assert "a: n 3, median 1.10; b: n 2, median 1.10" in page.run(
        f"{lanes}.getAttribute('aria-label')"
    )
    for key, name in (
        ("ArrowRight", "Cid: 0.70"),
        ("ArrowRight", "Dan pre: 0.90"),
        ("ArrowLeft", "Cid: 0.70"),
    ):
        page.run(f"{lanes}.focus()")
        page.press(key)
        assert page.run("document.querySelector('.tip-line').textContent").startswith(name)


def test_names_are_text(visit: Visit, tmp_path: Path) -> None:
    people = [
        Kept(
            name=HOSTILE,
            session=HOSTILE,
            group=HOSTILE,
            verdict=HOSTILE,
            reasons=(("warning", HOSTILE, HOSTILE),),
        ),
        Kept(name="Zed", group=HOSTILE, cause=HOSTILE),
    ]
    path = write_cohort(tmp_path / "out", people)
    page = visit(path, 1280, 800)
    page.run(f"gaitcal.choices.set({{shown: [0], find: {HOSTILE!r}}})")
    for part in ("distributions", "means", "failures"):
        page.run(f"document.getElementById('{part}').scrollIntoView()")
        page.run(SETTLED)
    assert page.run("window.hacked === undefined && document.images.length === 0")
    assert HOSTILE in page.run("document.querySelector('tr[data-person] bdi').title")
    assert page.console == []


def test_nobody_in_groups_is_everyone(visit: Visit, tmp_path: Path) -> None:
    page = visit(write_cohort(tmp_path / "out", [Kept(name="Ann"), Kept(name="Bob")]), 1280, 800)
    assert page.run("gaitcal.people.groups") == ["everyone"]
    assert page.run("document.getElementById('group') === null")
    none = visit(write_cohort(tmp_path / "none", [Kept(name="Zed", cause="restless")]), 1280, 800)
    assert none.run("document.getElementById('means').hidden")
    assert none.console == []


@pytest.mark.parametrize(("scheme", "width"), [("light", 1280), ("dark", 390)])
def test_everybody_can_use_it(
    visit: Visit, media: Callable[..., None], cohort: Path, scheme: str, width: int
) -> None:
    media(prefers_color_scheme=scheme)
    page = visit(cohort, width, SIZES[width], phone=width < 760)
    page.run("gaitcal.choices.set({shown: [0], sort: '-speed', group: 'a'})")
    page.run("for (const fold of document.querySelectorAll('details')) fold.open = true")
    for part in ("distributions", "means"):
        page.run(f"document.getElementById('{part}').scrollIntoView()")
        page.run(SETTLED)
    assert page.run(SMALL % (TARGET, TARGET)) == []
    assert page.run(UNNAMED) == []
    assert page.run("document.documentElement.scrollWidth <= innerWidth")
    axe = os.environ.get("GAITCAL_AXE")
    if axe and Path(axe).is_file():
        page.run(f"{Path(axe).read_text(encoding='utf-8')}; true")
        assert page.run(FAULTS) == []
        page.click("#people .bar button")
        assert page.run(FAULTS) == []
