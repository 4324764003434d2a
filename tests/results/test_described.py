"""What the documentation says of result files and columns, against folders that were written."""

import json
import shutil
from pathlib import Path

import pytest

from gaitcal.cohort.learn_priors import COLUMNS as PRIORS_COLUMNS
from gaitcal.cohort.run_cohort import FAILURE_COLUMNS, TIME_COLUMNS
from gaitcal.gait.cycles import CYCLE_COLUMNS
from gaitcal.gait.ensemble import ENSEMBLE_COLUMNS
from gaitcal.gait.peaks import PEAK_COLUMNS
from gaitcal.io.result_folder import MANIFEST, ResultKind, list_files, read_json_object
from gaitcal.reproduction.reproduce import CLAIM_COLUMNS, TABLE_COLUMNS
from gaitcal.results.normal_curves import NORMAL_CURVES_COLUMNS
from gaitcal.results.session_comparison import CURVE_COLUMNS
from gaitcal.results.session_difference import COLUMNS as DIFFERENCE_COLUMNS
from gaitcal.results.stride_tables import SPATIOTEMPORAL_COLUMNS
from gaitcal.results.stride_uses import STRIDE_COLUMNS
from scripts.tools.documentation.tables import FILES, SUMMARY, TABLES, column_of, file_of
from tests.kept import kept_result

KINDS = {
    ResultKind.CALIBRATION.value: "calibration",
    ResultKind.DYNAMICS.value: "dynamics",
    ResultKind.SYNTHETIC.value: "synthetic",
    ResultKind.REPRODUCTION.value: "reproduction",
    ResultKind.EXPORT.value: "export",
    ResultKind.EXAMPLE.value: "example",
    ResultKind.COHORT.value: "cohort",
    ResultKind.COMPARISON.value: "comparison",
}
ADDED = ("montecarlo", "dynamics", "export", "figures")


def head_of(table: Path) -> list[str]:
    with table.open(encoding="utf-8") as lines:
        return next(line for line in lines if not line.startswith("#")).strip().split(",")


def undescribed(folder: Path, kind: str) -> list[str]:
    """Files and columns of a folder that nothing is said of; folders that later commands added
    count by themselves.
    """
    out = []
    for name in list_files(folder):
        if kind == "calibration" and name.split("/")[0] in ADDED:
            continue
        told = file_of(kind, name)
        if told is None:
            out.append(f"{kind}: {name}")
        elif told.table == "summary":
            content = json.loads((folder / name).read_text(encoding="utf-8"))
            out += [f"{kind}: {name}: {key}" for key in content if key not in SUMMARY]
        elif told.table in TABLES:
            out += [
                f"{told.table}: {column}"
                for column in head_of(folder / name)
                if not column_of(told.table, column)
            ]
    for name in ADDED if kind == "calibration" else ():
        if (folder / name).is_dir():
            out += undescribed(folder / name, name)
    return out


def undescribed_below(top: Path) -> list[str]:
    """The same of every result folder below `top`."""
    out = []
    for manifest in sorted(top.rglob(MANIFEST)):
        made = read_json_object(manifest)
        kind = KINDS.get(
            str(made.get("kind", "")),
            "synthetic" if made.get("gaitcal") == "synthetic subject" else "",
        )
        if kind and manifest.parent.name not in ADDED:
            out += undescribed(manifest.parent, kind)
    return out


@pytest.mark.slow
def test_a_written_result_has_no_file_or_column_without_a_word(kept: Path, tmp_path: Path) -> None:
    shutil.copytree(kept_result(kept), tmp_path, dirs_exist_ok=True)
    assert undescribed_below(tmp_path) == []
    (tmp_path / "result" / "nobody_told.csv").write_text("x\n", encoding="utf-8")
    assert undescribed_below(tmp_path) == ["calibration: nobody_told.csv"]


@pytest.mark.parametrize(
    ("table", "columns"),
    [
        ("cycles", CYCLE_COLUMNS),
        ("ensemble", ENSEMBLE_COLUMNS),
        ("peaks", PEAK_COLUMNS),
        ("spatiotemporal", SPATIOTEMPORAL_COLUMNS),
        ("strides", STRIDE_COLUMNS),
        ("normal_curves", NORMAL_CURVES_COLUMNS),
        ("differences", DIFFERENCE_COLUMNS),
        ("curve_differences", CURVE_COLUMNS),
        ("failures", FAILURE_COLUMNS),
        ("times", TIME_COLUMNS),
        ("priors", PRIORS_COLUMNS),
        ("reproduced_tables", TABLE_COLUMNS),
        ("claims", CLAIM_COLUMNS),
    ],
)
def test_every_column_of_a_table_has_a_word(table: str, columns: tuple[str, ...]) -> None:
    assert [name for name in columns if column_of(table, name) is None] == []


def test_tables_that_files_name_are_there() -> None:
    named = {file.table for files in FILES.values() for file in files} - {"", "summary", "people"}
    assert named == set(TABLES)
