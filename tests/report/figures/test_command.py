"""`gaitcal figures`: what is drawn is what the folder's files hold, and the same folder gives the
same files.
"""

import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner, Result

from gaitcal.analysis.result import Calibration
from gaitcal.cli.application import app
from gaitcal.cli.console import Console
from gaitcal.cli.figures_command import draw_figures as run
from gaitcal.cli.figures_command import select_charts
from gaitcal.cli.view_command import print_report
from gaitcal.errors import Code, UsageError
from gaitcal.export.opensim.transfer_account import MusclePath, compare_muscles, format_muscles_csv
from gaitcal.gait.conventions import Acting, Convention, MomentUnit, Signs
from gaitcal.gait.ensemble import ensemble
from gaitcal.io.result_folder import ResultKind, check_replaceable, write_result_folder
from gaitcal.model.model_file import save_model
from gaitcal.report.figures.chart import SIDE_COLOURS, Chart
from gaitcal.report.figures.curve_panel import LINE
from gaitcal.report.figures.journal_figures import (
    Strides,
    build_moment_arm_charts,
    build_paper_charts,
)
from gaitcal.results.cycle_tables import read_cycles
from gaitcal.results.result_tables import build_result_tables, write_result_tables
from gaitcal.results.saved_result import MODEL
from gaitcal.results.stride_uses import STRIDES
from tests.fake_result import ANGLE_ERROR
from tests.messages import refuses
from tests.report.figures.test_figures import panel_figure

AS_WRITTEN = 1e-6
"""`cycles.csv` has six decimals."""


@pytest.fixture(scope="module")
def folder(whole: Calibration, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return written(whole, tmp_path_factory.mktemp("result"))


def written(calibration: Calibration, out: Path) -> Path:
    """Those files of a result that figures are made of."""
    write_result_tables(build_result_tables(calibration, manifest={"gaitcal": "0"}), out)
    save_model(calibration.model, out / MODEL)
    return out


def figures(*arguments: object) -> Result:
    return CliRunner().invoke(app, ["figures", *map(str, arguments)])


def mean_lines(chart: Chart) -> dict[str, np.ndarray]:
    """Side -> its line over the cycle."""
    sides = {colour: side for side, colour in SIDE_COLOURS.items()}
    lines = [
        line for line in panel_figure(chart.panels[0]).axes[0].lines if line.get_linewidth() == LINE
    ]
    return {sides[str(line.get_color())]: np.asarray(line.get_ydata()) for line in lines}


def charts(folder: Path, calibration: Calibration, convention: Convention) -> dict[str, Chart]:
    strides = Strides(
        table=ensemble(read_cycles(folder)), subject=calibration.model.subject, offs={}
    )
    return {chart.name: chart for chart in build_paper_charts(strides, convention)}


def test_a_line_is_the_mean_of_cycles_csv(folder: Path, whole: Calibration) -> None:
    drawn = charts(folder, whole, Convention())
    table = pd.read_csv(folder / "cycles.csv", comment="#")
    table = table[table["valid"] == 1]
    for name, variable in (
        ("hip_flexion_angle", "hip_flexion"),
        ("knee_adduction_moment", "knee_adduction_moment"),
        ("ground_reaction_vertical", "ground_reaction_vertical"),
    ):
        for side, line in mean_lines(drawn[name]).items():
            of_side = table[(table["variable"] == variable) & (table["side"] == side)]
            expected = of_side.groupby("percent")["value"].mean().reindex(range(101))
            np.testing.assert_allclose(line, expected, atol=AS_WRITTEN, err_msg=name)


@pytest.mark.parametrize(
    "convention, sign",
    [
        (Convention(unit=MomentUnit.NM_PER_KG), 1.0),
        (Convention(unit=MomentUnit.NM_PER_KG, signs=Signs.CLINICAL), -1.0),
        (Convention(unit=MomentUnit.NM_PER_KG, acting=Acting.EXTERNAL), -1.0),
        (Convention(unit=MomentUnit.NM_PER_KG, acting=Acting.EXTERNAL, signs=Signs.CLINICAL), -1.0),
    ],
)
def test_moments_are_told_in_the_convention(
    folder: Path, whole: Calibration, convention: Convention, sign: float
) -> None:
    plain = mean_lines(charts(folder, whole, Convention())["knee_angle_moment"])
    for side, line in mean_lines(charts(folder, whole, convention)["knee_angle_moment"]).items():
        np.testing.assert_allclose(line, sign * plain[side] / whole.model.subject.mass)


def first_strides(folder: Path) -> pd.DataFrame:
    table = read_cycles(folder)
    return table[table["stride"] == 1]


def test_the_band_of_a_single_stride_is_its_standard_error(
    folder: Path, whole: Calibration
) -> None:
    strides = Strides(table=ensemble(first_strides(folder)), subject=whole.model.subject, offs={})
    drawn = {
        chart.name: chart for chart in build_paper_charts(strides, Convention(signs=Signs.CLINICAL))
    }
    chart = drawn["hip_flexion_angle"]
    (axes,) = panel_figure(chart.panels[0]).axes
    assert [key.label for key in chart.keys] == [
        f"{side}, 1 stride ± standard error" for side in ("right", "left")
    ]
    for band in axes.collections:
        corners = band.get_paths()[0].vertices
        assert np.ptp(corners[corners[:, 0] == 50.0, 1]) == pytest.approx(
            2 * np.degrees(ANGLE_ERROR), rel=1e-4
        )
    assert drawn["ground_reaction_vertical"].keys[0].label == "right, 1 stride"


def test_the_band_of_several_strides_is_their_sd(folder: Path, whole: Calibration) -> None:
    table = first_strides(folder)
    more = table.assign(stride=table["stride"] + 1, value=table["value"] + 3.0)
    strides = Strides(
        table=ensemble(pd.concat([table, more])), subject=whole.model.subject, offs={"r": 60.0}
    )
    chart = next(
        c for c in build_paper_charts(strides, Convention()) if c.name == "hip_flexion_angle"
    )
    (axes,) = panel_figure(chart.panels[0]).axes
    corners = axes.collections[0].get_paths()[0].vertices
    assert np.ptp(corners[corners[:, 0] == 50.0, 1]) == pytest.approx(2 * 3.0 / np.sqrt(2.0))
    assert next(key.label for key in chart.keys) == "right, mean ± SD of 2 strides"
    assert any(line.get_xdata()[0] == 60.0 for line in axes.lines if len(line.get_xdata()) == 2)


def test_the_same_folder_gives_the_same_files(folder: Path, tmp_path: Path) -> None:
    for out in ("a", "b"):
        result = figures(
            folder,
            "--out",
            tmp_path / out,
            "--only",
            "knee_adduction",
            "--format",
            "svg,pdf,png",
            "-q",
        )
        assert result.exit_code == 0, result.output
    names = sorted(path.name for path in (tmp_path / "a").iterdir())
    assert names == [f"knee_adduction_moment.{ending}" for ending in ("pdf", "png", "svg")]
    for name in names:
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes(), name
    assert b"/Subtype /Type3" not in (tmp_path / "a" / "knee_adduction_moment.pdf").read_bytes()


def test_a_figure_is_as_wide_as_asked_for(folder: Path, tmp_path: Path) -> None:
    assert (
        figures(
            folder, "--out", tmp_path, "--only", "hip_flexion_moment", "--width", "17cm"
        ).exit_code
        == 0
    )
    head = (tmp_path / "hip_flexion_moment.svg").read_text(encoding="utf-8")
    points = float(head.split('width="')[1].split("pt")[0])
    assert points == pytest.approx(170 / 25.4 * 72, abs=0.1)


def test_only_takes_the_words_that_names_begin_or_end_with(
    folder: Path, whole: Calibration
) -> None:
    every = list(charts(folder, whole, Convention()).values())
    names = [chart.name for chart in select_charts(every, ["hip_flexion"])]
    assert names == ["hip_flexion_angle", "hip_flexion_moment"]
    assert {chart.name.rpartition("_")[2] for chart in select_charts(every, ["moment,angle"])} == {
        "moment",
        "angle",
    }
    with refuses(UsageError, "knee_adduction_moment", field="--only") as caught:
        select_charts(every, ["knee_aduction"])
    assert all(chart.name in str(caught.value) for chart in every)


@pytest.mark.parametrize(
    "changes, field, parts",
    [
        ({"formats": "jpg"}, "--format", ("jpg", "png", "svg", "pdf")),
        ({"formats": ","}, "--format", ("','",)),
        ({"width": "3mm"}, "--width", ("3mm", "40mm", "400mm")),
        ({"width": "wide"}, "--width", ("wide",)),
        ({"convention": "clincal"}, "--convention", ("clincal", "clinical")),
    ],
)
def test_options_that_cannot_be(
    folder: Path, tmp_path: Path, changes: dict[str, object], field: str, parts: tuple[str, ...]
) -> None:
    with refuses(UsageError, *parts, field=field):
        run(Console(quiet=True, verbose=False), folder, tmp_path / "out", **changes)
    assert not (tmp_path / "out").exists()


def test_a_folder_that_is_no_result(tmp_path: Path) -> None:
    with refuses(Code.NO_RESULT, str(tmp_path)):
        print_report(Console(quiet=True, verbose=False), tmp_path)
    for place in (tmp_path, tmp_path / "no"):
        with refuses(Code.NO_RESULT, str(place)):
            run(Console(quiet=True, verbose=False), place)


def test_a_result_of_an_earlier_version_is_refused(folder: Path, tmp_path: Path) -> None:
    """It has no `strides.csv`."""
    for file in folder.iterdir():
        if file.name != STRIDES:
            (tmp_path / file.name).write_bytes(file.read_bytes())
    for command in (print_report, run):
        with refuses(Code.NO_RESULT, str(tmp_path)):
            command(Console(quiet=True, verbose=False), tmp_path)


def test_further_trials_are_drawn_for_papers_with_the_person_of_their_result(
    folder: Path, tmp_path: Path
) -> None:
    (tmp_path / "dynamics").mkdir()
    for file in folder.iterdir():
        (tmp_path / "dynamics" / file.name).write_bytes(file.read_bytes())
    (tmp_path / "dynamics" / MODEL).rename(tmp_path / MODEL)
    result = figures(tmp_path / "dynamics", "--out", tmp_path / "out", "--only", "knee_adduction")
    assert result.exit_code == 0, result.output
    assert (tmp_path / "out" / "knee_adduction_moment.svg").exists()


@pytest.mark.parametrize("kind", [ResultKind.CALIBRATION, ResultKind.DYNAMICS])
def test_figures_in_a_result_do_not_keep_it_from_being_made_again(
    tmp_path: Path, kind: ResultKind
) -> None:
    with write_result_folder(tmp_path / "result", kind) as out:
        (out / "manifest.json").write_text('{"gaitcal": "0"}', encoding="utf-8")
    (tmp_path / "result" / "figures").mkdir()
    (tmp_path / "result" / "figures" / "hip_power.svg").write_text("<svg/>", encoding="utf-8")
    assert check_replaceable(tmp_path / "result", kind) == ("figures",)
    with write_result_folder(tmp_path / "result", kind) as out:
        (out / "manifest.json").write_text('{"gaitcal": "0"}', encoding="utf-8")
    assert (tmp_path / "result" / "figures" / "hip_power.svg").exists()


@pytest.mark.slow
def test_drawing_alone_loads_matplotlib() -> None:
    """Every command waits for what it imports."""
    unwanted = ("matplotlib", "scipy.signal", "scipy.stats")
    heavy = f"print([m for m in {unwanted} if m in sys.modules], 'PIL' in sys.modules)"
    for named, draws_pdf in (
        ("gaitcal.cli.calibrate_command, gaitcal.pipeline.write_results", False),
        ("gaitcal.cli.view_command", True),
    ):
        program = f"import sys, {named}; {heavy}"
        done = subprocess.run(
            [sys.executable, "-c", program], capture_output=True, text=True, check=True
        )
        assert done.stdout.strip() == f"[] {draws_pdf}"


def test_moment_arms_of_a_model_beside_the_result(folder: Path, tmp_path: Path) -> None:
    """The muscles that change most, before and after; bands only where there were draws."""
    result = Path(shutil.copytree(folder, tmp_path / "result"))
    chosen_arms = {"only": ("moment_arms",), "formats": "svg"}
    with refuses(Code.NOTHING_TO_SHOW, "gaitcal export", "--muscles", field="*.muscles.csv"):
        run(Console(quiet=True, verbose=False), result, None, **chosen_arms)
    deg = np.array([0.0, 45.0, 90.0])
    paths = {}
    for k in range(12):
        key = f"m{k}", "knee_angle_r"
        pair = [MusclePath(muscle=key[0], coordinate=key[1], values=np.radians(deg), length=deg,
            arm=a * (1 + deg))
                for a in (1e-3, 1e-3 * (1 + 0.1 * k))]  # fmt: skip
        paths[key] = pair
    before, after = ({key: pair[i] for key, pair in paths.items()} for i in (0, 1))
    (result / "export").mkdir()
    for draws in ((), (before, after)):
        (result / "export" / "mine.muscles.csv").write_text(
            format_muscles_csv(compare_muscles(before, after), draws)
        )
        run(Console(quiet=True, verbose=False), result, tmp_path / "out", **chosen_arms)
        assert [p.name for p in (tmp_path / "out").glob("*.svg")] == [
            "moment_arms_knee_angle_r.svg"
        ]
    (chart,) = build_moment_arm_charts(pd.read_csv(result / "export" / "mine.muscles.csv"))
    assert (
        len(chart.panels) == 9 and chart.panels[0].label == "moment arm of m11 about knee_angle_r"
    )
    axes = panel_figure(chart.panels[0]).axes[0]
    drawn = {
        str(line.get_color()): line.get_ydata()
        for line in axes.lines
        if line.get_linewidth() == LINE
    }
    np.testing.assert_allclose(drawn[SIDE_COLOURS["r"]], 2.1 * (1 + deg), rtol=1e-4)
    np.testing.assert_allclose(drawn[SIDE_COLOURS["l"]], 1 + deg, rtol=1e-4)
    band = axes.collections[-1].get_paths()[0].vertices[:, 1]
    assert band.max() == pytest.approx((2.1 + 1.96 * 1.1 / np.sqrt(2)) * 91, rel=1e-4)
    assert [key.label for key in chart.keys][1:] == [
        "after, ± 1.96 SD of the draws",
        "3 muscles more, which change less",
    ]
