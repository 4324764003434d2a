"""Curves in a browser: one clock, the conventions and means of Python, names as data, paper, and
speed.
"""

import itertools
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gaitcal import ensemble
from gaitcal.gait.conventions import Acting, Convention, MomentUnit, Signs
from gaitcal.model.coordinates import COORDINATE_TABLE
from gaitcal.report.page.page_data import build_peak_rows, list_coordinate_rows
from gaitcal.report.page.plain_data import pack_lengths
from gaitcal.report.page.scene import Scene
from tests.report.page.browser import STEADY, Page, Visit
from tests.report.page.made_page import SIZE, SUBJECT, VARIABLE, long_walks, stridden, written_page

pytestmark = pytest.mark.browser

PACKED = 1e-3
"""Of the size of a curve: 16 bits of its range, and times of 32 bits where it is steep."""
SAME_FRAMES = 0.98
"""Share of points with as many valid strides: one may lie a rounding beside a frame whose validity
ends.
"""
ON_FRAME = 1e-4
"""s: a frame's time in 32 bits."""
ON_LINE = 0.11
"""px: cursors are placed to a tenth."""
STRIDES = {
    0: {"r": [0.103, 0.551, 0.987], "l": [0.252, 0.741]},
    1: {"r": [0.031, 0.498], "l": [0.2, 0.702]},
    2: {"l": [0.1, 0.6]},
}
"""Trial 0 has a right stride that turns, trial 2 no right stride."""
CONVENTIONS = "gaitcal.curves.convention"
LEAD = "gaitcal.curves.lead"


@pytest.fixture(scope="module")
def walked() -> Any:
    scene = long_walks()
    return scene, *stridden(scene, STRIDES)


@pytest.fixture(scope="module")
def walked_html(walked: Any, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return written_page(tmp_path_factory.mktemp("curves"), walked[0], walked[1])


@pytest.fixture
def page(visit: Visit, walked_html: Path) -> Page:
    """The one page that all tests share."""
    return at_rest(visit(walked_html, 1280, 900))


def shown(
    visit: Visit, folder: Path, scene: Scene, sheet: dict[str, Any], width: int = 1280
) -> Page:
    return at_rest(visit(written_page(folder, scene, sheet), width, 900, phone=width < 760))


def at_rest(page: Page) -> Page:
    page.run(
        f"gaitcal.clock.play(false); gaitcal.state.set({{ seconds: 0.3, spread: 'strides' }}); "
        f"{STEADY}"
    )
    return page


def panel(base: str, kind: str) -> str:
    return (
        f"gaitcal.curves.panels.find(({{ subject }}) => subject.base === '{base}' && subject.kind "
        f"=== '{kind}')"
    )


def place(page: Page, at: str, x: float, y: float = 0.5) -> tuple[float, float]:
    """Where in the window a share of a panel's plot is, after it has been brought into view."""
    page.run(f"{at}.root.scrollIntoView({{ block: 'center' }}); {STEADY}")
    left, top, width, height = page.box(f"{at}.plot.over")
    return left + x * width, top + y * height


def test_means_are_those_of_the_package(page: Page, walked: Any) -> None:
    """Mean, SD, standard error and count over strides and trials, for each leg on its own; a turn
    is left out.
    """
    _, sheet, table = walked
    found = ensemble(table).set_index(["variable", "side", "percent"]).sort_index()
    page.run("gaitcal.state.set({ spread: 'mean', unit: 'Nm', signs: 'opensim' })")
    agree = []
    for base, kind in {(c["base"], c["kind"]) for c in sheet["trials"][0]["curves"]}:
        told = page.run(f"""(() => {{ const c = gaitcal.curves;
            const traces = new Gaitcal.Traces({{ base: '{base}', kind: '{kind}' }}, c.strides, c.convention);
            return ['r', 'l'].map((side) => (({{ counts, value, sd, se }}) =>
              [counts, value, sd, se].map((part) => Array.from(part)))(traces.main(side))); }})()""")
        for side, (n, mean, sd, se) in zip("rl", np.array(told, dtype=float), strict=True):
            wanted = found.loc[(f"{base}{VARIABLE[kind]}", side)]
            same = np.nan_to_num(n) == wanted["n"].to_numpy()
            agree.append(same.mean())
            for values, column in ((mean, "mean"), (sd, "sd"), (se, "se")):
                expected = wanted[column].to_numpy()[same]
                assert values[same] == pytest.approx(
                    expected, abs=PACKED * SIZE[kind], nan_ok=True
                ), (base, side, column)
    assert min(agree) > SAME_FRAMES
    assert (
        found["n"].max() == 3 and found.loc["hip_flexion", "r"]["n"].max() == 2
    )  # one of three right strides turns
    assert page.console == []


def test_conventions_are_those_of_the_package(page: Page) -> None:
    units = {"Nm": MomentUnit.NM, "Nm/kg": MomentUnit.NM_PER_KG, "%BWH": MomentUnit.PERCENT_BWH}
    bases = [
        base
        for joint in list_coordinate_rows()
        for base in joint["rows"]
        if base in COORDINATE_TABLE
    ]
    for signs, acting, (unit, moment_unit) in itertools.product(Signs, Acting, units.items()):
        convention = Convention(signs=signs, acting=acting, unit=moment_unit)
        chosen = json.dumps({"signs": signs.value, "acting": acting.key, "unit": unit})
        for base, side in itertools.product(bases, "rl"):
            told = page.run(f"""((c) => [c.factor('{base}', 'moment', '{side}'), c.factor('{base}', 'angle', '{side}'),
                c.factor('{base}', 'power', '{side}'), c.positive('{base}', 'moment', '{side}'),
                c.positive('{base}', 'angle', '{side}')]
                )(new Gaitcal.Convention(gaitcal.curves.strides.sheet, {chosen}))""")
            one = np.ones(1)
            of_python = (
                convention.moment(base, one, SUBJECT, side),
                convention.angle(base, one, side),
            )
            factors = [float(values[0]) for values in (*of_python, convention.power(one, SUBJECT))]
            senses = [convention.senses(f"{base}_moment", "r")[0], convention.senses(base, side)[0]]
            assert told == [*(pytest.approx(factor, rel=1e-12) for factor in factors), *senses]


@pytest.mark.slow
def test_a_cursor_moves_the_body_to_a_frame(page: Page, walked: Any) -> None:
    """Pointing at a percent of a curve shows the body at that frame, and the cursor
    stands there.
    """
    scene, _, _ = walked
    time = scene.trials[0].time - scene.trials[0].time[0]
    at = panel("knee_angle", "angle")
    for share in (0.1, 0.43, 0.77):
        page.move(*place(page, at, share))
        page.run(STEADY)
        seconds = page.run("gaitcal.state.seconds")
        assert np.abs(time - seconds).min() < ON_FRAME
        lead = page.run(LEAD)
        stride = next(
            s
            for s in page.run("gaitcal.sheet.strides")
            if s["side"] == lead and s["start"] <= seconds <= s["stop"]
        )
        wanted = stride["start"] + share * (stride["stop"] - stride["start"])
        assert (
            abs(seconds - wanted) < 0.6 * np.diff(time).mean() + 0.004
        )  # half a frame, and a pixel of the pointer
        frame = int(np.abs(time - seconds).argmin())
        assert page.run("gaitcal.stage.figure.body.groups[0].position.toArray()") == pytest.approx(
            scene.trials[0].origins[frame, 0].tolist(), abs=1e-3
        )
        assert standing(page, at, lead) == pytest.approx(
            100 * (seconds - stride["start"]) / (stride["stop"] - stride["start"]), abs=0.1
        )


def standing(page: Page, at: str, side: str) -> float:
    """Where a cursor stands on its axis."""
    return float(
        page.run(f"""(p => p.span.min + p.cursor('{side}', gaitcal.curves.now) / p.span.wide *
        (p.span.max - p.span.min))({at})""")
    )


@pytest.mark.slow
@pytest.mark.parametrize("axis", ["percent", "time"])
def test_the_clock_moves_every_cursor(axis: str, page: Page) -> None:
    page.run(f"gaitcal.state.set({{ axis: '{axis}' }}); {STEADY}")
    wide = page.run(f"{panel('hip_flexion', 'angle')}.span.wide")
    for seconds in (0.3, 0.45, 0.62):
        page.run(f"gaitcal.clock.seek({seconds})")
        for base, kind in (("hip_flexion", "angle"), ("hip_flexion", "moment")):
            at = panel(base, kind)
            if axis == "time":
                duration = page.run("gaitcal.trial.duration")
                assert standing(page, at, "") == pytest.approx(
                    seconds, abs=ON_LINE / wide * duration
                )
                continue
            for side in "rl":
                start, stop = next(
                    (a, b) for a, b in itertools.pairwise(STRIDES[0][side]) if a <= seconds <= b
                )
                percent = 100 * (seconds - start) / (stop - start)
                assert standing(page, at, side) == pytest.approx(percent, abs=100 * ON_LINE / wide)
    page.run(
        "gaitcal.clock.seek(0.05)"
    )  # before any stride: no cursor over the cycle, one over time
    assert page.run(f"{panel('hip_flexion', 'angle')}.cursor('r', gaitcal.curves.now)") is None


def test_cursors_are_drawn_where_the_clock_stands(page: Page) -> None:
    """Over each panel in view there is ink at its cursor, and none beside it."""
    at = panel("hip_flexion", "angle")
    place(page, at, 0.5)
    inks = page.run(f"""(p => {{ const {{ overlay, now }} = gaitcal.curves, pen = overlay.getContext('2d');
        const plot = p.plot.over.getBoundingClientRect(), over = overlay.getBoundingClientRect();
        const ink = (side, away) => pen.getImageData(Math.round(plot.left - over.left + p.cursor(side, now)) + away - 1,
          Math.round(plot.top - over.top + 0.5 * plot.height), 3, 9).data.some((part) => part > 0);
        return ['r', 'l'].flatMap((side) => [ink(side, 0), ink(side, 9)]); }})({at})""")
    assert inks == [True, False, True, False]


def test_the_pointed_panel_tells_its_values(page: Page, walked: Any) -> None:
    _, _, table = walked
    page.run("gaitcal.state.set({ unit: 'Nm', signs: 'clinical' })")
    at = panel("knee_adduction", "moment")
    page.move(*place(page, at, 0.2))
    page.run(STEADY)
    sentence = page.run("document.querySelector('.curve-sentence').textContent")
    exact = page.run("gaitcal.curves.now.r")
    percent = round(exact)
    rows = table[
        (table.trial == "walk0") & (table.variable == "knee_adduction_moment") & (table.stride == 1)
    ]
    right = rows[(rows.side == "r")].set_index("percent")
    assert (
        sentence.startswith("Knee abduction moment: right ")
        and f" ({percent} %), left " in sentence
    )
    if right.loc[percent, "valid"]:
        value = -np.interp(exact, right.index, right["value"])
        assert float(
            sentence.split("right ")[1].split(" ")[0].replace("\u2212", "-")
        ) == pytest.approx(value, abs=1.0)


@pytest.mark.slow
def test_dragging_loops_whole_frames_and_a_press_ends_it(page: Page) -> None:
    at = panel("hip_flexion", "angle")
    begin, end = place(page, at, 0.2), place(page, at, 0.6)
    page.drag(begin, end)
    window = page.run("gaitcal.state.window")
    times = np.array(page.run("Array.from(gaitcal.trial.time)"))
    assert window[0] < window[1] and all(np.abs(times - t).min() < ON_FRAME for t in window)
    lead = page.run(LEAD)
    start, stop = next(
        (a, b) for a, b in itertools.pairwise(STRIDES[0][lead]) if a <= window[0] <= b
    )
    assert (np.array(window) - start) / (stop - start) == pytest.approx([0.2, 0.6], abs=0.03)
    shaded = (
        "gaitcal.curves.panels.filter((p) => p.visible && p.plot).map((p) => p.plot.select.width / "
        "p.span.wide)"
    )
    page.run(
        f"{panel('knee_angle', 'angle')}.nearest({{ clientX: 0, clientY: 1e4 }})"
    )  # another leg may lead now
    widths = page.run(f"(gaitcal.curves.redraw(), {STEADY}).then(() => {shaded})")
    assert len(widths) > 3 and np.ptp(widths) < 0.01 and min(widths) > 0.3, (
        "all panels shade the same part"
    )
    page.drag(begin)
    assert page.run("gaitcal.state.window") is None and page.run(f"{at}.plot.select.width") == 0


@pytest.mark.slow
def test_a_title_brings_its_joint_near_and_escape_leaves(page: Page) -> None:
    page.run(f"{panel('knee_angle', 'angle')}.title.click(); {STEADY}")
    assert page.run("gaitcal.state.joint") in ("knee_r", "knee_l")
    assert page.run(
        "[...document.querySelectorAll('.curve-group.large')].map((g) => g.dataset.joint)"
    ) == ["knee"]
    assert page.run("document.querySelectorAll('.curve-group.dim').length") > 2
    page.run(f"{panel('hip_flexion', 'moment')}.root.focus(); 1")
    page.press("Enter")
    assert page.run("gaitcal.state.joint") in ("hip_r", "hip_l")
    before = page.run("gaitcal.state.seconds")
    page.press("ArrowRight")
    assert 0 < page.run("gaitcal.state.seconds") - before < 0.02  # one frame, once
    page.press("Escape")
    assert page.run("gaitcal.state.joint") is None
    assert page.run("document.querySelectorAll('.curve-group:is(.large, .dim)').length") == 0


def test_a_leg_without_a_stride_does_not_take_the_others(page: Page) -> None:
    page.run(f"gaitcal.state.set({{ trial: 2 }}); {STEADY}")
    assert page.run("gaitcal.curves.strides.percent") is True
    assert "The right leg makes no complete stride in walk2." in page.run(
        "document.querySelector('.curve-notes').textContent"
    )
    assert page.run(f"{panel('hip_flexion', 'angle')}.traces.main('l').n") == 3


@pytest.mark.slow
def test_a_trial_without_strides_is_shown_over_time(visit: Visit, tmp_path: Path) -> None:
    scene = long_walks(1)
    page = shown(visit, tmp_path, scene, stridden(scene, {})[0])
    page.run(f"gaitcal.state.set({{ axis: 'percent' }}); {STEADY}")
    assert page.run("gaitcal.curves.strides.percent") is False
    assert "holds no complete stride" in page.run(
        "document.querySelector('.curve-notes').textContent"
    )
    assert page.console == []


def test_a_number_has_the_error_that_its_band_shows(page: Page) -> None:
    shown = panel("hip_flexion", "angle")
    line = f"{shown}.traces.main('l')"
    for errors, part, words in ((True, "se", "standard error"), (False, "sd", "SD")):
        page.run(
            f"gaitcal.state.set({{ spread: 'mean', errors: {str(errors).lower()}, off: new Set() "
            f"}}); {STEADY}"
        )
        read = page.run(
            f"[{shown}.traces.at('l', 50, 0).error, {line}.{part}[50], {shown}.sentence({{ l: 50 "
            f"}})]"
        )
        assert read[0] == pytest.approx(read[1]) and f"(mean ± {words}, strides: " in read[2]


def test_the_tables_of_peaks_show_what_python_computed(page: Page, walked: Any) -> None:
    """Every row in the chosen unit and sense, with its error, place, spread and strides; external
    moments by theirs.
    """
    rows = build_peak_rows(walked[1])
    moments = [row for row in rows if row["kind"] == "moment" and "r" in row]
    assert len(moments) >= 3 and any(
        row["r"]["n"] < row["r"]["strides"] for row in rows if "r" in row
    )
    rows_shown = "[...document.querySelectorAll('.curve-peaks tbody tr')]"
    shown = (
        f"{rows_shown}.map(row => [row.children[0].firstChild.textContent, "
        "row.children[1].textContent])"
    )
    for acting, title in (("internal", "title"), ("external", "external")):
        page.run(f"gaitcal.state.set({{ unit: 'Nm/kg', signs: 'opensim', acting: '{acting}' }})")
        cells = page.run(f"new Promise(done => setTimeout(() => done({shown}), 200))")
        told = {name: cell.replace("\u2212", "-") for name, cell in cells}
        for row in moments:
            of = row["r"]
            value = of["mean"] * (1.0 if acting == "internal" else -1.0) / SUBJECT.mass
            error = "" if of["se"] is None else f" \u00b1 {of['se'] / SUBJECT.mass:.2f}"
            cell = told[row[title]]
            assert cell.startswith(f"{value:.2f}{error}") or abs(value) < 0.005, (
                row["title"],
                cell,
            )
            assert abs(float(cell.split("at ")[1].split(" %")[0]) - of["percent"]) <= 0.5
            assert (f"{of['n']} of {of['strides']} strides" in cell) == (of["n"] < of["strides"])


def test_validity_is_that_of_the_table(page: Page, walked: Any) -> None:
    """Percent by percent, also beside gaps, as `cycles.csv` has it."""
    _, _, table = walked
    for key, rows in table[table.variable.str.endswith("_moment")].groupby(
        ["trial", "side", "stride", "variable"]
    ):
        trial, side, number, variable = key
        own = side if variable != "lumbar_bending_moment" else ""
        told = page.run(f"""(trial => [...trial.curve('{variable.removesuffix("_moment")}', '{own}', 'moment')
            .over(trial.strides.find(stride => stride.side === '{side}' && stride.number === {number})).valid])
            (gaitcal.curves.strides.sheet.trials.find(({{ name }}) => name === '{trial}'))""")
        assert told == rows.sort_values("percent").valid.tolist(), key


@pytest.mark.slow
def test_pelvis_angles_of_a_turning_stride_do_not_count(
    visit: Visit, walked: Any, tmp_path: Path
) -> None:
    scene, sheet, _ = walked
    lined = json.loads(json.dumps(sheet))
    for stride in lined["trials"][0]["strides"]:
        stride["pelvis"] = {"pelvis_tilt": {"value": pack_lengths(np.linspace(0.0, 5.0, 101))}}
    page = shown(visit, tmp_path, scene, lined)
    for base, own, turning in (("pelvis_tilt", "", 0), ("hip_flexion", "r", 101)):
        told = page.run(f"""(trial => trial.strides.filter(({{ side }}) => side === 'r').map((stride) =>
            trial.curve('{base}', '{own}', 'angle').over(stride).valid.reduce((a, b) => a + b)))
            (gaitcal.curves.strides.sheet.trials[0])""")
        assert told == [101, turning]


@pytest.mark.slow
def test_long_trials_stay_usable(visit: Visit, tmp_path: Path) -> None:
    """Trials with all frames that a page holds: a tick moves cursors alone."""
    scene = long_walks(2, 16)
    ends = float(scene.trials[0].time[-1])
    strikes = np.arange(0.1, ends, 0.9).tolist()
    sheet, _ = stridden(
        scene, {t: {"r": strikes, "l": [s + 0.4 for s in strikes[:-1]]} for t in range(2)}
    )
    page = shown(visit, tmp_path, scene, sheet)
    page.run(f"gaitcal.state.set({{ axis: 'time' }}); {STEADY}")
    tick = page.run("""(() => { let best = Infinity;
        for (let k = 0; k < 10; k++) { const begin = performance.now();
          for (let i = 0; i < 50; i++) { gaitcal.state.seconds = 0.01 * i; gaitcal.curves.tick(); }
          best = Math.min(best, (performance.now() - begin) / 50); }
        return best; })()""")
    assert tick < 5.0  # ms; 0.1 on an idle machine
    assert page.console == []


@pytest.mark.slow
def test_a_phone_shows_one_kind_in_one_column(visit: Visit, walked: Any, tmp_path: Path) -> None:
    scene, sheet, _ = walked
    page = shown(visit, tmp_path, scene, sheet, width=390)
    kinds = """[...new Set([...document.querySelectorAll('.curve-panel')]
        .filter((p) => p.offsetParent).map((p) => p.dataset.kind))]"""
    assert page.run(kinds) == ["angle"]
    page.run(f"document.querySelector('.curve-kinds input[value=moment]').click(); {STEADY}")
    assert set(page.run(kinds)) == {"moment", "force"}
    assert page.run("document.documentElement.scrollWidth") <= 390
