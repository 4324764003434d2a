"""Rows of the tables: every published figure is there, with ours where it can be, and real people beside them."""

import json
import re
from dataclasses import replace
from pathlib import Path

import pandas as pd
import pytest

from gaitcal.cli import montecarlo as command
from gaitcal.cli.console import Console
from gaitcal.errors import InputError
from gaitcal.published import reproduce
from gaitcal.published.case import people_rows
from gaitcal.published.claims import Kind, Verdict
from gaitcal.published.inertial_recovery import SeedResult
from gaitcal.published.protocol import table_four, table_two
from gaitcal.published.reproduce import (
    CLAIM_COLUMNS,
    TABLE_COLUMNS,
    Reproduction,
    ReproductionSettings,
    SensitivityDraws,
    write_tables,
)
from gaitcal.published.reproduce import reproduce as run
from gaitcal.published.tables import (
    TableRow,
    discussion_rows,
    spread,
    table_four_rows,
    table_one_rows,
    table_three_rows,
    table_two_rows,
)
from tests.published.conftest import FEW_SEEDS

FEW = SensitivityDraws(noise=1, absorbed=2, stopped=1, centres=1)
TINY = ReproductionSettings(noise_seeds=2, random_seeds=FEW_SEEDS, sensitivities=FEW, jobs=1)


@pytest.fixture(scope="module")
def reproduction(clean: SeedResult, draws: list[SeedResult]) -> Reproduction:
    """What `run(TINY)` gives, from the runs that other tests look at too."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(reproduce, "noiseless", lambda *_: clean)
        patch.setattr(reproduce, "noisy_draws", lambda *_: draws)
        return run(TINY)


@pytest.fixture(scope="module")
def files(reproduction: Reproduction, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("reproduction")
    write_tables(reproduction, folder)
    return folder


def test_spread_places_the_published_figure() -> None:
    found = spread([3.0, 1.0, 2.0, 10.0])
    assert (found.median, found.low, found.high, found.draws) == (2.5, 1.0, 10.0, 4)
    assert [found.place(v) for v in (0.9, 1.0, 5.0, 10.0, 10.1)] == ["below", "inside", "inside", "inside", "above"]
    row = TableRow("I", "row", "hip", "mm").over_draws(0.5, [3.0, 1.0, 2.0, 10.0], "why")
    assert row.ours == 2.5
    assert row.note == "median of 4 noise draws, range 1 to 10; published value below the range; why"


def test_tables_one_and_two(clean: SeedResult, draws: list[SeedResult]) -> None:
    rows = table_one_rows(clean, draws)
    for condition in ("without", "with"):
        cells = [r for r in rows if r.row.startswith(f"synthetic {condition} noise: ") and r.row.endswith("RMS")]
        assert len(cells) == 4 + 3 + 4
        assert all(r.published is not None and r.ours is not None for r in cells)
    hip = next(r for r in rows if r.row == "synthetic with noise: position error RMS" and r.column == "hip")
    values = [d.joints["hip"].position_mm for d in draws]
    assert (hip.published, hip.ours) == (0.55, pytest.approx(sum(values) / 2))
    second = table_two_rows(draws)
    assert len(second) == 4 * len(table_two())
    row = next(r for r in second if r.row == "knee, shank, lateral position" and r.column == "single joint, synthetic")
    place = draws[0].joints["knee"].names.index("knee_l.shank.lat")
    errors = [d.joints["knee"].errors[place] for d in draws]
    assert (row.published, row.ours) == (-0.84, pytest.approx(sum(errors) / 2))


def test_minima_from_zero_and_from_the_truth_are_compared(clean: SeedResult, draws: list[SeedResult]) -> None:
    def ended(draw: SeedResult, cost: float) -> SeedResult:
        hip = replace(draw.joints["hip"], cost=cost, cost_from_truth=1.0)
        return replace(draw, joints={**draw.joints, "hip": hip})

    rows = table_one_rows(clean, [ended(draws[0], 1.00005), ended(draws[1], 1.001)])
    (row,) = (r for r in rows if "same minimum" in r.row and r.column == "hip")
    assert (row.published, row.ours, row.unit) == (None, 50.0, "%")


def test_tables_three_and_four(clean: SeedResult, draws: list[SeedResult]) -> None:
    rows = table_three_rows(clean, draws)
    first = [r for r in rows if r.row == "synthetic without noise, correct seed"]
    assert [r.published for r in first] == [8.04e-10, 2.16e-10, 5.13e-07, 1.22e-10, 7.11e-10]
    assert [r.ours for r in first][:2] == [clean.correct.force, clean.correct.torque]
    noisy = {(r.row, r.column): r for r in rows}
    mean = noisy["synthetic with noise, random seeds: mean", "mass error RMS"]
    assert mean.published == 1.33
    assert mean.ours == pytest.approx(sum(r.errors.mass for d in draws for r in d.random) / (2 * FEW_SEEDS))
    fourth = table_four_rows(draws)
    assert len(fourth) == 4 * len(table_four()) + 1
    trunk = next(r for r in fourth if r.row == "mass, head and trunk" and r.column == "correct seed")
    assert (trunk.published, trunk.ours) == (
        -3.38,
        pytest.approx(sum(d.correct.each["head_trunk.mass"] for d in draws) / 2),
    )
    third = {(r.row, r.column): r for r in discussion_rows(draws)}
    assert third["third step, after", "residual force RMS"].published == 15


def test_experimental_rows_have_no_figure_of_ours(clean: SeedResult, draws: list[SeedResult]) -> None:
    rows = [*table_one_rows(clean, draws), *table_two_rows(draws), *table_three_rows(clean, draws)]
    rows += table_four_rows(draws)
    experimental = [r for r in rows if "experimental" in r.row or "experimental" in r.column]
    assert len(experimental) > 100
    assert all(r.ours is None and "unpublished experimental trial" in r.note for r in experimental)
    others = [r for r in rows if r not in experimental]
    assert all(r.ours is not None for r in others)


def test_csv_schema(files: Path) -> None:
    names = {path.name for path in files.iterdir()}
    tables = {"tables.csv", "claims.csv", "draws.csv", "times.csv", "iterations.csv"}
    assert names == tables | {"README.txt", "manifest.json"}
    tables = pd.read_csv(files / "tables.csv")
    assert tuple(tables.columns) == TABLE_COLUMNS
    assert set(tables["table"]) == {"I", "II", "III", "IV", "discussion", "sensitivity"}
    assert tables[["published", "ours"]].dtypes.eq(float).all()
    assert not tables[["table", "row", "column"]].duplicated().any()
    claims = pd.read_csv(files / "claims.csv", keep_default_na=False)
    assert tuple(claims.columns) == CLAIM_COLUMNS
    assert set(claims["verdict"]) <= {v.value for v in Verdict}
    assert not claims["claim"].duplicated().any()
    assert len(pd.read_csv(files / "draws.csv")) == TINY.noise_seeds
    assert "gaitcal" in json.loads((files / "manifest.json").read_text())
    readme = (files / "README.txt").read_text()
    assert all(name in readme for name in names - {"README.txt"})


def test_every_sensitivity_has_claims_and_may_be_left_out(
    reproduction: Reproduction, clean: SeedResult, draws: list[SeedResult], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(reproduce, "noiseless", lambda *_: clean)
    monkeypatch.setattr(reproduce, "noisy_draws", lambda *_: draws)
    without = run(replace(TINY, sensitivities=None))
    assert [c.claim for c in without.claims] == [c.claim for c in reproduction.claims]
    of_them = [c for c in without.claims if c.kind is Kind.SENSITIVITY]
    assert len(of_them) == 1 + 1 + 2 + 2
    assert of_them == without.claims[-6:]
    assert {c.kind for c in reproduction.claims[-6:]} == {Kind.SENSITIVITY}
    assert {c.verdict for c in of_them} == {Verdict.NOT_RUN}
    others = [row for row in reproduction.tables if row.table != "sensitivity"]
    assert without.tables == others  # nothing else depends on them


def test_command_prints_and_writes(
    reproduction: Reproduction, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    asked = []
    monkeypatch.setenv("COLUMNS", "200")
    monkeypatch.delenv("GAITCAL_DATA", raising=False)
    monkeypatch.setattr(
        command, "reproduce", lambda settings, kept, step: asked.append((settings, kept)) or reproduction
    )
    command.run_reproduction(
        Console(quiet=False, verbose=False), tmp_path / "out", draws=0, noise_seeds=5, seed=3, sensitivities=False
    )
    settings, kept = asked[0]
    assert settings.sensitivities is None
    assert (settings.noise_seeds, settings.seed, settings.draws, settings.data, kept) == (5, 3, 0, None, None)
    assert (tmp_path / "out" / "tables.csv").is_file()
    printed = capsys.readouterr().out
    assert "synthetic with noise: position error RMS" in printed
    assert "380 s" in printed
    assert "claims of the paper: " in printed
    assert "sensitivities, ours: " in printed
    of_paper, of_ours = (
        sum(int(n) for n in re.findall(r"(\d+) [a-z]", re.search(f"{t}: (.*)", printed)[1]))
        for t in ("claims of the paper", "sensitivities, ours")
    )
    assert (of_paper, of_ours) == (len(reproduction.claims) - 6, 6)
    assert "this run: tables " in printed
    assert "everything" in printed


def test_command_refuses_a_foreign_folder_before_it_works(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("GAITCAL_DATA", raising=False)
    monkeypatch.setattr(command, "reproduce", lambda *_: pytest.fail("worked first"))
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(InputError, match="holds 'notes.txt'"):
        command.run_reproduction(
            Console(quiet=True, verbose=False), tmp_path, draws=0, noise_seeds=2, seed=0, sensitivities=True
        )


def test_data_folder_must_exist(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GAITCAL_DATA", str(tmp_path / "nowhere"))
    with pytest.raises(InputError, match="no folder"):
        command.run_reproduction(
            Console(quiet=True, verbose=False), tmp_path / "out", draws=0, noise_seeds=2, seed=0, sensitivities=True
        )
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_subject01_and_uf3(data_dir: Path) -> None:
    said: list[str] = []
    rows = {(r.table, r.row, r.column): r for r in people_rows(data_dir, said.append)}
    assert all(r.published is None and r.ours is not None for r in rows.values())
    assert all("another person" in r.note for r in rows.values())
    for joint in ("hip", "knee", "ankle"):
        before, after = (
            rows["I", f"uf3, {words}: marker distance RMS", joint].ours for words in ("anatomical", "phase 1")
        )
        assert before is not None and after is not None
        assert rows["I", "uf3: fall of marker distance", joint].ours == pytest.approx(100.0 * (1.0 - after / before))
        assert after < before
    force = {
        words: rows["III", f"subject01, {words}", "residual force RMS"].ours for words in ("phase 1", "third step")
    }
    assert (force["third step"] or 0.0) < 0.6 * (force["phase 1"] or 0.0)
    scaled = [
        rows["discussion", f"subject01, torque divided by {w}", "residual torque RMS"].ours for w in ("BW*H", "BW*1 mm")
    ]
    assert (scaled[1] or 0.0) < (scaled[0] or 0.0)
    assert any("third step" in line for line in said)
