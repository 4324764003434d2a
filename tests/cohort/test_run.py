"""A cohort whose calibrations are stubs: what is run again, what the tables hold, what a failure leaves."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest

from gaitcal.codes import Code
from gaitcal.cohort import task as tasks
from gaitcal.cohort.columns import COLUMNS, NAMES
from gaitcal.cohort.one_person import CommonSettings, PersonError
from gaitcal.cohort.outcome import Outcome, state_file
from gaitcal.cohort.page import PAGE
from gaitcal.cohort.people import CohortPerson, people_in
from gaitcal.cohort.run import Ended, run_cohort
from gaitcal.cohort.tables import CYCLES, FAILURES, PEOPLE_CSV, PEOPLE_PARQUET
from gaitcal.cohort.task import Task
from gaitcal.errors import InputError
from gaitcal.gait.ensemble import ensemble
from gaitcal.gait.stride_table import CYCLE_COLUMNS
from gaitcal.results.table_file import write_csv

MASS = 50.0
SAME = (PEOPLE_CSV, PEOPLE_PARQUET, CYCLES, FAILURES, PAGE, "manifest.json")


class Here:
    """Runs everyone in this process."""

    def __init__(self, *, backwards: bool = False) -> None:
        self.backwards = backwards

    def run(
        self, function: Callable[[Task], Outcome], tasks: Iterator[Task], lost: Callable[[Task, str], Outcome]
    ) -> Iterator[Outcome]:
        yield from map(function, list(tasks)[:: -1 if self.backwards else 1])


def strides(person: str) -> pd.DataFrame:
    """Two strides of the right foot: a moment with one peak, of which one frame is not valid, and an angle."""
    percent = np.arange(101)
    parts = []
    for stride in (1, 2):
        for variable, value in (
            ("knee_angle", 30.0 + 20.0 * np.sin(2 * np.pi * percent / 100) + stride),
            ("knee_angle_moment", 40.0 * np.sin(2 * np.pi * percent / 100)),
            ("hip_flexion_moment", np.where(percent < 50, 1.0, np.nan)),
        ):
            valid = np.isfinite(value)
            parts.append(
                pd.DataFrame(
                    {
                        "person": person,
                        "session": "",
                        "trial": "walk",
                        "side": "r",
                        "stride": stride,
                        "percent": percent,
                        "variable": variable,
                        "value": np.where(valid, value, 0.0),
                        "se": 2.0,
                        "valid": valid.astype(int),
                        "se_stride": 1.0,
                        "turn": 0.0,
                    }
                )[list(CYCLE_COLUMNS)]
            )
    return pd.concat(parts, ignore_index=True)


def write_result(person: CohortPerson, out: Path, common: CommonSettings) -> None:
    """A result folder as a calibration leaves it, of what tables read alone."""
    out.mkdir(parents=True, exist_ok=True)
    table = strides(person.name)
    write_csv(table, out / "cycles.csv")
    write_csv(ensemble(table), out / "ensemble.csv")
    walk = {
        "role": "gait",
        "frames": 100,
        "verdict_r": "trustworthy",
        "verdict_l": "refused",
        "valid_frames": 10,
        "rms_mm": {"nominal": 5.0, "calibrated": 3.0},
        "pelvis_residual": {"nominal": {"force_N": 30.0, "torque_Nm": 6.0}, "jp": {"force_N": 20.0, "torque_Nm": 4.0}},
    }
    other = {**walk, "frames": 300, "rms_mm": {"nominal": 5.0, "calibrated": 1.0}}
    summary = {
        "status": "converged",
        "verdict": "doubtful",
        "trials": {"walk": walk, "again": other},
        "reasons": [{"cause": 'a "heel", moved', "action": "look"}],
        "spatiotemporal": {"speed": {"unit": "m/s", "r": {"mean": 1.25, "strides": 2, "trials": 1}}},
    }
    (out / "summary.json").write_text(json.dumps(summary))
    subject = {"name": person.name, "mass_kg": MASS, "height_m": 1.7, "sex": "female"}
    manifest = {"gaitcal": "0.2.0", "subject": subject, "settings": {}, "own_sha256": "1"}
    (out / "manifest.json").write_text(json.dumps(manifest))


@pytest.fixture
def ran(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Names of those who were calibrated. Zed's recordings are at fault, Yan's calibration is."""
    called: list[str] = []

    def stub(person: CohortPerson, out: Path, common: CommonSettings) -> None:
        called.append(person.name)
        if person.name == "Zed":
            raise PersonError("the static trial is restless", "record it again", code=Code.STILLNESS)
        if person.name == "Yan":
            raise ZeroDivisionError("by zero")
        write_result(person, out, common)

    monkeypatch.setattr(tasks, "calibrate_person", stub)
    return called


@pytest.fixture
def lab(tmp_path: Path) -> Path:
    for name in ("Ann", "Bob", "Yan", "Zed"):
        (tmp_path / "lab" / name).mkdir(parents=True)
        (tmp_path / "lab" / name / "walk.c3d").write_text(name)
    return tmp_path / "lab"


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


def run(lab: Path, out: Path, *, retry: bool = False, backwards: bool = False) -> list[Ended]:
    ended: list[Ended] = []
    run_cohort(people_in(lab, out), out, engine=Here(backwards=backwards), retry=retry, told=ended.append)
    return ended


def test_tables(lab: Path, tmp_path: Path, ran: list[str]) -> None:
    out = tmp_path / "out"
    ended = run(lab, out)
    assert [e.outcome.verdict for e in ended] == ["doubtful", "doubtful", "failed", "failed"]
    ann = rows(out / PEOPLE_CSV)[0]
    assert list(ann) == list(NAMES)
    assert (ann["person"], ann["folder"], ann["first_cause"]) == ("Ann", "people/Ann", 'a "heel", moved')
    assert (ann["verdict_r"], ann["verdict_l"], ann["walks_refused_l"]) == ("trustworthy", "refused", "2")
    assert float(ann["marker_rms_calibrated_mm"]) == pytest.approx(np.sqrt((100 * 9 + 300) / 400), abs=1e-6)
    assert float(ann["residual_force_calibrated_N"]) == 20.0
    assert float(ann["speed_r"]) == 1.25
    assert ann["speed_l"] == ""
    parquet = pq.read_table(out / PEOPLE_PARQUET)
    assert parquet.column_names == list(NAMES)
    assert parquet["speed_r"].to_pylist() == [1.25, 1.25]
    cycles = pq.ParquetFile(out / CYCLES)
    assert (cycles.num_row_groups, cycles.metadata.num_rows) == (2, 2 * len(strides("Ann")))
    assert rows(out / FAILURES) == [
        {"person": "Yan", "session": "", "group": "", "folder": "Yan"}
        | {"code": "GC-240", "cause": "internal error: ZeroDivisionError: by zero", "what_to_do": "please report it"},
        {"person": "Zed", "session": "", "group": "", "folder": "Zed"}
        | {"code": "GC-040", "cause": "the static trial is restless", "what_to_do": "record it again"},
    ]
    assert [row["column"] for row in rows(out / "columns.csv")] == [column.name for column in COLUMNS]


def test_peaks_are_those_of_the_mean_over_valid_strides(lab: Path, tmp_path: Path, ran: list[str]) -> None:
    run(lab, tmp_path / "out")
    ann = rows(tmp_path / "out" / PEOPLE_CSV)[0]
    mean = ensemble(strides("Ann")).set_index(["variable", "percent"])
    high = mean.loc["knee_angle_moment", 25]
    assert float(ann["knee_angle_moment_max_r"]) == pytest.approx(high["mean"] / MASS, abs=1e-6)
    assert float(ann["knee_angle_moment_max_se_r"]) == pytest.approx(high["se"] / MASS, abs=1e-6)
    assert float(ann["knee_angle_range_r"]) == pytest.approx(40.0, abs=1e-6)
    assert float(ann["knee_angle_max_r"]) == pytest.approx(51.5, abs=1e-6)
    assert ann["hip_flexion_moment_max_r"] == ""  # half a stride is not seen: its peak is not known


def test_only_what_changed_is_run_again(lab: Path, tmp_path: Path, ran: list[str]) -> None:
    out = tmp_path / "out"
    run(lab, out)
    before = {name: (out / name).read_bytes() for name in SAME}
    ran.clear()
    assert not any(e.outcome.computed for e in run(lab, out))
    assert ran == []
    assert {name: (out / name).read_bytes() for name in SAME} == before
    (lab / "Ann" / "notes.txt").write_text("no recording")
    (lab / "Bob" / "walk.c3d").write_text("another walk")
    run(lab, out)
    assert ran == ["Bob"]
    run(lab, out, retry=True)
    assert ran == ["Bob", "Yan", "Zed"]
    (out / "people" / "Ann" / "manifest.json").unlink()
    run(lab, out)
    assert ran[3:] == ["Ann"]


def test_a_group_is_no_reason_to_calibrate(lab: Path, tmp_path: Path, ran: list[str]) -> None:
    from gaitcal.cohort.cohort_file import read_cohort

    out = tmp_path / "out"
    run(lab, out)
    ran.clear()
    (lab / "people.csv").write_text("person,group\nBob,controls\n")
    run_cohort(read_cohort(lab, out)[0], out, engine=Here())
    assert ran == []
    assert [row["group"] for row in rows(out / PEOPLE_CSV)] == ["", "controls"]
    assert set(pq.read_table(out / CYCLES)["group"].to_pylist()) == {"", "controls"}
    (lab / "people.csv").write_text("person,mass_kg\nBob,61\n")
    run_cohort(read_cohort(lab, out)[0], out, engine=Here())
    assert ran == ["Bob"]


def test_order_and_interruption_do_not_show(lab: Path, tmp_path: Path, ran: list[str]) -> None:
    one, other = tmp_path / "one", tmp_path / "other"
    run(lab, one)
    run(lab, other, backwards=True)
    state_file(other, "people/Ann", ".json").unlink()  # killed after the strides, before it was done
    state_file(other, "people/Bob", ".json").write_text('{"cut off')
    run(lab, other)
    assert ran[8:] == ["Ann", "Bob"]
    for name in SAME:
        assert (one / name).read_bytes() == (other / name).read_bytes(), name


def test_a_lost_worker_is_tried_again_by_the_next_run(lab: Path, tmp_path: Path, ran: list[str]) -> None:
    class Lost(Here):
        def run(
            self, function: Callable[[Task], Outcome], tasks: Iterator[Task], lost: Callable[[Task, str], Outcome]
        ) -> Iterator[Outcome]:
            first, *others = tasks
            yield lost(first, "ended by SIGKILL, 3 times")
            yield from map(function, others)

    out = tmp_path / "out"
    run_cohort(people_in(lab, out), out, engine=Lost())
    assert "its worker process died: ended by SIGKILL, 3 times" in (out / FAILURES).read_text()
    run(lab, out)
    assert ran[-1] == "Ann"
    assert [row["person"] for row in rows(out / PEOPLE_CSV)] == ["Ann", "Bob"]


def test_another_folder_is_left_alone(lab: Path, tmp_path: Path, ran: list[str]) -> None:
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.txt").write_text("")
    with pytest.raises(InputError, match="holds 'thesis.txt', and is no cohort"):
        run(lab, tmp_path / "mine")
    assert ran == []
