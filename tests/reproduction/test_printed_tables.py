"""Recovery of published parameters and the tables of it: every figure is there, and real people
beside them.
"""

import json
import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest

from gaitcal.calibration.inertial_calibration import RootEquations, fit_published
from gaitcal.cli import montecarlo_command as command
from gaitcal.cli.console import Console
from gaitcal.model.linkage import COORDINATES, get_segment
from gaitcal.model.parameters import (
    IP_INDEX,
    IP_NAMES,
    IP_TO_SI,
    JP_TO_SI,
    MASSIVE_SEGMENTS,
    Parameters,
    compute_dynamic_jacobian,
    list_leg_parameters,
    make_symmetric_set,
    read_published_parameters,
)
from gaitcal.montecarlo.protocol import (
    PROBLEMS,
    MonteCarloSettings,
    Plan,
    get_table_four,
    get_table_one,
    get_table_three,
    get_table_two,
)
from gaitcal.reproduction import reproduce
from gaitcal.reproduction.claims import ClaimOutcome
from gaitcal.reproduction.people_rows import compute_people_rows
from gaitcal.reproduction.printed_tables import (
    TableRow,
    make_discussion_rows,
    make_table_four,
    make_table_one,
    make_table_three,
    make_table_two,
    summarise_draws,
)
from gaitcal.reproduction.recovery import (
    LEG,
    SEED_RANGE,
    SeedResult,
    assemble_gait_equations,
    build_synthetic_problem,
    build_true_model,
    build_true_motion,
    compute_inertial_rms,
    compute_joint_errors,
    compute_joint_rms,
    compute_symmetric_errors,
    draw_random_seed,
    list_free_parameters,
    make_generators,
    recover_noisy_draw,
)
from gaitcal.reproduction.reproduce import (
    CLAIM_COLUMNS,
    TABLE_COLUMNS,
    Reproduction,
    ReproductionSettings,
    make_draw_frame,
    write_tables,
)
from gaitcal.reproduction.reproduce import reproduce as run
from tests.refusal import refusal
from tests.reproduction.conftest import FEW_SEEDS

TINY = ReproductionSettings(noise_seeds=2, random_seeds=FEW_SEEDS, draws=1, jobs=1)


@pytest.fixture(scope="module")
def reproduction(clean: SeedResult, draws: list[SeedResult]) -> Reproduction:
    """What `run(TINY)` gives, from the runs that other tests look at too."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(reproduce, "recover_noiseless", lambda *_: clean)
        patch.setattr(reproduce, "recover_noisy_draws", lambda *_: draws)
        return run(TINY)


@pytest.fixture(scope="module")
def files(reproduction: Reproduction, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("reproduction")
    write_tables(reproduction, folder)
    return folder


def test_spread_places_the_published_figure() -> None:
    found = summarise_draws([3.0, 1.0, 2.0, 10.0])
    assert (found.median, found.low, found.high, found.draws) == (2.5, 1.0, 10.0, 4)
    assert [found.locate(v) for v in (0.9, 1.0, 5.0, 10.0, 10.1)] == [
        "below",
        "inside",
        "inside",
        "inside",
        "above",
    ]
    row = TableRow("I", "row", "hip", "mm").fill_with_draws(0.5, [3.0, 1.0, 2.0, 10.0], "why")
    note = "median of 4 noise draws, range 1 to 10; published value below the range; why"
    assert (row.ours, row.note) == (2.5, note)


def test_tables_one_and_two(clean: SeedResult, draws: list[SeedResult]) -> None:
    rows = make_table_one(clean, draws)
    for condition in ("without", "with"):
        cells = [
            r
            for r in rows
            if r.row.startswith(f"synthetic {condition} noise: ") and r.row.endswith("RMS")
        ]
        assert len(cells) == 4 + 3 + 4
        assert all(r.published is not None and r.ours is not None for r in cells)
    hip = next(
        r for r in rows if r.row == "synthetic with noise: position error RMS" and r.column == "hip"
    )
    values = [d.joints["hip"].position_mm for d in draws]
    assert (hip.published, hip.ours) == (0.55, pytest.approx(sum(values) / 2))
    second = make_table_two(draws)
    assert len(second) == 4 * len(get_table_two())
    row = next(
        r
        for r in second
        if r.row == "knee, shank, lateral position" and r.column == "single joint, synthetic"
    )
    place = draws[0].joints["knee"].names.index("knee_l.shank.lat")
    errors = [d.joints["knee"].errors[place] for d in draws]
    assert (row.published, row.ours) == (-0.84, pytest.approx(sum(errors) / 2))


def test_minima_from_zero_and_from_the_truth_are_compared(
    clean: SeedResult, draws: list[SeedResult]
) -> None:
    def ended(draw: SeedResult, cost: float) -> SeedResult:
        hip = replace(draw.joints["hip"], cost=cost, cost_from_truth=1.0)
        return replace(draw, joints={**draw.joints, "hip": hip})

    rows = make_table_one(clean, [ended(draws[0], 1.00005), ended(draws[1], 1.001)])
    (row,) = (r for r in rows if "same minimum" in r.row and r.column == "hip")
    assert (row.published, row.ours, row.unit) == (None, 50.0, "%")


def test_tables_three_and_four(clean: SeedResult, draws: list[SeedResult]) -> None:
    rows = make_table_three(clean, draws)
    first = [r for r in rows if r.row == "synthetic without noise, correct seed"]
    assert [r.published for r in first] == [8.04e-10, 2.16e-10, 5.13e-07, 1.22e-10, 7.11e-10]
    assert [r.ours for r in first][:2] == [clean.correct.force, clean.correct.torque]
    noisy = {(r.row, r.column): r for r in rows}
    mean = noisy["synthetic with noise, random seeds: mean", "mass error RMS"]
    assert mean.published == 1.33
    assert mean.ours == pytest.approx(
        sum(r.errors.mass for d in draws for r in d.random) / (2 * FEW_SEEDS)
    )
    fourth = make_table_four(draws)
    assert len(fourth) == 4 * len(get_table_four()) + 1
    trunk = next(
        r for r in fourth if r.row == "mass, head and trunk" and r.column == "correct seed"
    )
    ours = sum(d.correct.each["head_trunk.mass"] for d in draws) / 2
    assert (trunk.published, trunk.ours) == (-3.38, pytest.approx(ours))
    third = {(r.row, r.column): r for r in make_discussion_rows(draws)}
    assert third["third step, after", "residual force RMS"].published == 15


def test_experimental_rows_have_no_figure_of_ours(
    clean: SeedResult, draws: list[SeedResult]
) -> None:
    rows = [*make_table_one(clean, draws), *make_table_two(draws), *make_table_three(clean, draws)]
    rows += make_table_four(draws)
    experimental = [r for r in rows if "experimental" in r.row or "experimental" in r.column]
    assert len(experimental) > 100
    assert all(r.ours is None and "unpublished experimental trial" in r.note for r in experimental)
    others = [r for r in rows if r not in experimental]
    assert all(r.ours is not None for r in others)


def test_csv_schema(files: Path) -> None:
    names = {path.name for path in files.iterdir()}
    tables = {"tables.csv", "claims.csv", "draws.csv", "times.csv", "montecarlo.csv"}
    assert names == tables | {"README.txt", "manifest.json"}
    tables = pd.read_csv(files / "tables.csv")
    assert tuple(tables.columns) == TABLE_COLUMNS
    assert set(tables["table"]) == {"I", "II", "III", "IV", "discussion"}
    assert tables[["published", "ours"]].dtypes.eq(float).all()
    assert not tables[["table", "row", "column"]].duplicated().any()
    claims = pd.read_csv(files / "claims.csv", keep_default_na=False)
    assert tuple(claims.columns) == CLAIM_COLUMNS
    assert set(claims["verdict"]) <= {v.value for v in ClaimOutcome}
    assert not claims["claim"].duplicated().any()
    assert len(pd.read_csv(files / "draws.csv")) == TINY.noise_seeds
    assert "gaitcal" in json.loads((files / "manifest.json").read_text())
    readme = (files / "README.txt").read_text()
    assert all(name in readme for name in names - {"README.txt"})


def test_draws_have_the_published_sets_levels_and_bounds(
    clean: SeedResult, draws: list[SeedResult], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[tuple[object, ...]] = []

    def study(case: object, folder: Path | None, **options: Any) -> SimpleNamespace:
        asked.append((folder, options["settings"], options["plan"]))
        return SimpleNamespace(statistics=None)

    monkeypatch.setattr(reproduce, "recover_noiseless", lambda *_: clean)
    monkeypatch.setattr(reproduce, "recover_noisy_draws", lambda *_: draws)
    monkeypatch.setattr(reproduce, "monte_carlo", study)
    run(replace(TINY, draws=0))
    assert asked == []
    run(replace(TINY, seed=3, draws=7), tmp_path)
    assert asked == [(tmp_path / "published", MonteCarloSettings(seed=3), Plan(draws=7))]


def reproduced(
    out: Path, *, quiet: bool = True, draws: int = 0, noise_seeds: int = 2, seed: int = 0
) -> None:
    console = Console(quiet=quiet, verbose=False)
    command.run_reproduction(console, out, draws=draws, noise_seeds=noise_seeds, seed=seed)


def test_command_prints_and_writes(
    reproduction: Reproduction,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    asked = []
    monkeypatch.setenv("COLUMNS", "200")
    monkeypatch.delenv("GAITCAL_DATA", raising=False)
    monkeypatch.setattr(
        command,
        "reproduce",
        lambda settings, kept, _: asked.append((settings, kept)) or reproduction,
    )
    reproduced(tmp_path / "out", quiet=False, draws=1, noise_seeds=5, seed=3)
    assert asked == [
        (ReproductionSettings(seed=3, noise_seeds=5, draws=1, data=None), tmp_path / "out.draws")
    ]
    assert (tmp_path / "out" / "tables.csv").is_file()
    figures = {path.stem for path in (tmp_path / "out" / "figures").glob("*.png")}
    assert figures == {"figure_3_lab", "figure_3_foot", "figure_4_lab", "figure_4_foot"}
    printed = capsys.readouterr().out
    for words in (
        "synthetic with noise: position error RMS",
        "380 s",
        "this run: tables ",
        "everything",
    ):
        assert words in printed
    counts = re.search("claims of the paper: (.*)", printed)
    assert counts is not None
    assert sum(int(n) for n in re.findall(r"(\d+) [a-z]", counts[1])) == len(reproduction.claims)


def test_command_refuses_a_foreign_folder_and_data_that_are_not_there_before_it_works(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(command, "reproduce", lambda *_: pytest.fail("worked first"))
    monkeypatch.setenv("GAITCAL_DATA", str(tmp_path / "nowhere"))
    assert "is not a folder" in refusal(reproduced, tmp_path / "out")
    assert not (tmp_path / "out").exists()
    monkeypatch.delenv("GAITCAL_DATA")
    (tmp_path / "notes.txt").write_text("mine")
    assert "contains 'notes.txt'" in refusal(reproduced, tmp_path)


@pytest.mark.slow
def test_subject01_and_uf3(data_dir: Path) -> None:
    lines: list[str] = []
    rows = compute_people_rows(data_dir, 1, lines.append)
    assert all(
        r.published is None and r.ours is not None and "another person" in r.note for r in rows
    )
    ours = {(r.table, r.row, r.column): r.ours or 0.0 for r in rows}
    for joint in ("hip", "knee", "ankle"):
        before, after = (
            ours["I", f"uf3, {w}: marker distance RMS", joint] for w in ("anatomical", "phase 1")
        )
        assert ours["I", "uf3: fall of marker distance", joint] == pytest.approx(
            100.0 * (1.0 - after / before)
        )
        assert 0.0 < after < before
    joints, loads = (
        ours["III", f"subject01, {words}", "residual force RMS"]
        for words in ("phase 1", "third step")
    )
    assert loads < 0.6 * joints
    assert any("third step" in line for line in lines)


MARKER_MM = 1e-9
"""What is asked for; the paper reached 1e-8 to 2e-6."""
PARAMETER = 1e-6
"""deg, mm."""
NODES = 1e-9
"""m, rad."""


@pytest.mark.parametrize("problem", PROBLEMS)
def test_exact_without_noise(clean: SeedResult, problem: str) -> None:
    found = clean.joints[problem]
    assert (
        found.converged and found.marker_mm < MARKER_MM and np.abs(found.errors).max() < PARAMETER
    )
    assert found.coefficients == pytest.approx(build_true_motion(problem).coefficients, abs=NODES)


def test_problems_are_the_published_ones(clean: SeedResult) -> None:
    assert [len(list_free_parameters(p)) for p in PROBLEMS] == [6, 9, 12, 17]
    assert [len(clean.joints[p].names) for p in PROBLEMS] == [
        6,
        9,
        12,
        len(list_leg_parameters("l")),
    ]
    for problem in PROBLEMS:
        markers = build_synthetic_problem(problem, None)
        assert markers.data.measured.shape == (41, 3, 208 if problem == "full leg" else 1200)
        assert (markers.basis.control_points, len(markers.chain.coordinates)) == (
            20,
            len(COORDINATES),
        )
        assert set(np.unique(markers.data.weight)) == {1.0}


def test_noise_moves_the_minimum_below_the_truth(draws: list[SeedResult]) -> None:
    for draw in draws:
        for problem in PROBLEMS[:3]:
            found = draw.joints[problem]
            assert found.converged and found.cost < found.cost_at_truth
            assert 4.0 < found.marker_mm < min(9.0, found.largest_mm)
            assert found.marker_mm == pytest.approx(1e3 * np.sqrt(found.cost / (41 * 1200)))


def test_gait_keeps_what_isolated_trials_found(draws: list[SeedResult]) -> None:
    joints = draws[0].joints
    leg = dict(zip(LEG, joints["full leg"].errors, strict=True))
    for problem in PROBLEMS[:3]:
        for name, error in zip(joints[problem].names, joints[problem].errors, strict=True):
            assert (leg[name] == pytest.approx(error, abs=1e-9)) == (
                name not in list_free_parameters("full leg")
            )


RESIDUAL = 1e-9
"""N, N·m: asked for; the paper reached 8e-10 and 2e-10 from the correct seed."""
INERTIA = 1e-6
"""kg mm^2."""
SEEN = 31
"""Of 36 directions: what the pelvis residual of this gait tells of the symmetric parameters."""


@pytest.fixture(scope="module")
def equations() -> RootEquations:
    return assemble_gait_equations(
        build_true_model().parameters, build_true_motion("full leg").coefficients
    )


def test_correct_seed_without_noise_is_exact_and_random_ones_leave_no_residual(
    clean: SeedResult,
) -> None:
    assert len(clean.random) == 2
    for found in (clean.correct, *clean.random):
        assert found.converged and max(found.force, found.torque) < RESIDUAL
    errors = clean.correct.errors
    assert max(errors.inertia, errors.mass, errors.centre, abs(clean.correct.total_mass)) < INERTIA
    assert all(found.errors.inertia > 1.0 for found in clean.random), "the seed was not random"


def test_falling_penalty_keeps_the_fixed_points(equations: RootEquations) -> None:
    """Its solution is a fixed point of the published procedure: re-seeded there, nothing moves."""
    seed = draw_random_seed(np.random.default_rng(1), with_held=False)
    solution = fit_published(equations, seed, make_symmetric_set(), decay=0.1)
    again = fit_published(equations, solution.inertial, make_symmetric_set())
    assert again.seeds == 1
    assert again.inertial == pytest.approx(solution.inertial, rel=1e-9, abs=1e-12)
    assert solution.seeds > 2


def test_pelvis_residual_sees_31_of_36_directions(equations: RootEquations) -> None:
    which, truth = make_symmetric_set(), build_true_model().parameters.inertial
    s = which.selection[
        :, [which.names.index(row.name) for row in get_table_four() if row.name != "foot.com.sup"]
    ]
    blocks = np.einsum(
        "rsd,sdk->rsk",
        equations.factor.reshape(-1, len(MASSIVE_SEGMENTS), 10),
        compute_dynamic_jacobian(truth),
    )
    scaled = blocks.reshape(-1, len(IP_NAMES)) @ s * (s.T @ truth / (s * s).sum(axis=0))
    values = np.linalg.svd(scaled, compute_uv=False)
    assert (values > 1e-10 * values[0]).sum() == SEEN and values[SEEN] < 1e-13


@pytest.mark.parametrize("with_held", [False, True])
def test_random_seeds(with_held: bool) -> None:
    truth, which = build_true_model().parameters.inertial, make_symmetric_set()
    seeds = np.array(
        [draw_random_seed(np.random.default_rng(k), with_held=with_held) for k in range(200)]
    )
    moved = truth != 0.0
    ratio = seeds[:, moved] / truth[moved] - 1.0
    assert np.abs(ratio).max() <= SEED_RANGE
    free = which.selection.any(axis=1)[moved]
    assert np.abs(ratio[:, free]).max(axis=0).min() > 0.9 * SEED_RANGE
    right, left = (seeds[:, IP_INDEX[f"thigh_{side}.com.sup"]] for side in "rl")
    assert np.array_equal(right, left)
    held = seeds[:, IP_INDEX["foot_l.com.sup"]]
    assert (np.ptp(held) > 0) == with_held
    assert not seeds[:, IP_INDEX["thigh_l.com.ant"]].any()


def test_third_step_lowers_both_residuals(draws: list[SeedResult]) -> None:
    for draw in draws:
        assert draw.third.converged
        for before, after in (draw.third.force, draw.third.torque):
            assert after < 0.6 * before
        assert draw.third.marker_mm[0] == draw.joints["full leg"].marker_mm
        assert 1.0 < draw.third.marker_mm[1] / draw.third.marker_mm[0] < 1.1


@pytest.mark.slow
def test_processes_do_not_matter(draws: list[SeedResult]) -> None:
    """Those of the fixture come from two processes."""
    here = recover_noisy_draw(0, 1, random_seeds=FEW_SEEDS)
    assert make_draw_frame([here]).equals(make_draw_frame(draws[1:]))
    assert np.array_equal(
        here.joints["full leg"].coefficients, draws[1].joints["full leg"].coefficients
    )
    assert [r.each for r in here.random] == [r.each for r in draws[1].random]


def test_draws_and_seeds_differ(draws: list[SeedResult]) -> None:
    assert not np.allclose(draws[0].joints["hip"].errors, draws[1].joints["hip"].errors)
    markers = [
        build_synthetic_problem("full leg", rng).data.measured
        for seed, draw in ((0, 0), (0, 1), (1, 0))
        for rng in make_generators(seed, draw)[0]
    ]
    assert len({m.tobytes() for m in markers}) == 3 * len(PROBLEMS)
    masses = [[r.each["thigh.mass"] for r in d.random] for d in draws]
    assert len({*masses[0], *masses[1]}) == 2 * FEW_SEEDS


ROUNDING = 0.01
"""The paper prints two decimals, the ankle's 3.377 deg as 3.37."""


@pytest.mark.parametrize("problem", PROBLEMS)
def test_table_two_gives_table_one(problem: str) -> None:
    joints = {"hip": ("hip",), "knee": ("knee",), "ankle": ("talocrural", "subtalar")}
    rows = [
        r for r in get_table_two() if problem == "full leg" or r.name.startswith(joints[problem])
    ]
    errors = np.array([(r.full_leg if problem == "full leg" else r.single_joint)[0] for r in rows])
    position, orientation = compute_joint_rms(errors, [r.name for r in rows])
    assert position == pytest.approx(
        get_table_one("synthetic_with_noise", "position_mm")[problem], abs=ROUNDING
    )
    expected = get_table_one("synthetic_with_noise", "orientation_deg")[problem]
    assert (orientation is None) == (expected is None)
    if expected is not None:
        assert orientation == pytest.approx(expected, abs=ROUNDING)


def test_table_four_gives_table_three() -> None:
    which, truth = make_symmetric_set(), read_published_parameters().inertial
    printed = {r.name: r.correct_seed for r in get_table_four()}
    assert printed.keys() <= {*which.names, "foot.com.sup"}
    found = truth + IP_TO_SI * (
        which.selection @ np.array([printed.get(name, 0.0) for name in which.names])
    )
    errors = compute_inertial_rms(found, truth)
    segments = {name.split(".")[0] for name in printed}  # the mean is taken over these alone
    share = np.sqrt(np.mean([get_segment(s).name in segments for s in MASSIVE_SEGMENTS]))
    _, _, inertia, mass, centre = get_table_three("synthetic_with_noise_correct_seed")
    assert errors.inertia == pytest.approx(share * inertia, rel=2e-3)
    assert errors.mass == pytest.approx(share * mass, abs=ROUNDING)
    assert errors.centre == pytest.approx(share * centre, abs=0.02)
    back = compute_symmetric_errors(found, truth)
    assert {name: back[name] for name in printed} == pytest.approx(
        printed | {"foot.com.sup": 0.0}, abs=1e-6
    )


def test_errors_are_found_minus_true_in_printed_units() -> None:
    truth = read_published_parameters()
    found = Parameters(truth.joint + JP_TO_SI, truth.inertial, truth.zero_angles)
    assert compute_joint_errors(found, truth, list_leg_parameters("l")) == pytest.approx(
        np.ones(len(list_leg_parameters("l")))
    )
    one = truth.inertial.copy()
    one[IP_NAMES.index("foot_l.com.sup")] += 3e-3
    assert compute_symmetric_errors(one, truth.inertial)["foot.com.sup"] == pytest.approx(1.5)
