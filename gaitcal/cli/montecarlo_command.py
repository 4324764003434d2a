"""Commands `montecarlo` and `reproduce` (the published study of 2007)."""

import json
import os
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import pandas as pd
import typer
from rich import progress
from rich.text import Text

from gaitcal.cli import options
from gaitcal.cli.console import Console, make_frameless_table
from gaitcal.errors import Code, ConvergenceError, InputError, UsageError, suggest_name
from gaitcal.io.atomic import InterruptedWork, Stopped
from gaitcal.io.result_folder import (
    ResultKind,
    amend_result,
    check_output_folder,
    write_result_folder,
)
from gaitcal.montecarlo import draw
from gaitcal.montecarlo.case import MODEL, load_case, read_case
from gaitcal.montecarlo.draw_statistics import (
    FEWEST,
    compute_linear_agreement,
    compute_statistics,
    compute_variance_contributions,
    estimate_expected_errors,
    list_cells_with_failures,
    select_levels,
    select_unconverged,
)
from gaitcal.montecarlo.draw_study import PURPOSE, DrawProgress, MonteCarloStudy, Store, monte_carlo
from gaitcal.montecarlo.protocol import (
    MOST_LEVEL,
    MonteCarloSettings,
    ParameterChoice,
    Plan,
    ReactionFrame,
    Varied,
)
from gaitcal.montecarlo.workers import choose_workers, lock_folder
from gaitcal.report.figures.monte_carlo_figures import FRAME_WORDS, write_monte_carlo_figures
from gaitcal.report.page.monte_carlo_sections import add_monte_carlo
from gaitcal.report.page.page_data import PAGE_DATA
from gaitcal.report.page.page_folder import PAGE, read_page, rewrite_page
from gaitcal.reproduction import printed_tables
from gaitcal.reproduction.claims import Claim, ClaimOutcome
from gaitcal.reproduction.reproduce import (
    Reproduction,
    ReproductionSettings,
    reproduce,
    write_tables,
)
from gaitcal.results.summary import require_not_refused

FOLDER, SUMMARY = "montecarlo", "summary.json"
HEADINGS = ("hip flex", "hip add", "hip rot", "knee flex", "knee add", "ankle dors", "subt inv")
SHOWN_SIDE = "l"
"""Leg that is printed, as in the publication; the tables have both."""


def _parse_plan(vary: str, levels: str, draws: int) -> Plan:
    """Parse the sets and levels of a study.

    `vary`: comma-separated sets of parameters: values of `Varied`. `levels`: comma-separated
    percentages of the bounds. `draws`: draws of each set at each level. Raises UsageError: a set or
    level is invalid, or there is none.
    """
    allowed = [varied.value for varied in Varied]
    sets = [_require_allowed(name, allowed, "--vary") for name in _split(vary)]
    for level in _split(levels):
        if not level.isdecimal() or not 1 <= int(level) <= MOST_LEVEL:
            raise UsageError(
                f"found '{level}'; allowed: whole per cents from 1 to {MOST_LEVEL}",
                field="--levels",
            )
    numbers = tuple(int(level) for level in _split(levels))
    if not sets or not numbers:
        raise UsageError(
            "found nothing; at least one is needed", field="--levels" if sets else "--vary"
        )
    return Plan(tuple(Varied(name) for name in sets), numbers, draws)


def run_monte_carlo(
    console: Console,
    folder: options.ResultOrStudy,
    vary: Annotated[
        str,
        typer.Option(help="Comma-separated: jp (joint parameters), ip (inertial), both, noise."),
    ] = "jp,ip,both,noise",
    levels: Annotated[
        str, typer.Option(help="Comma-separated percentages of the bounds.")
    ] = "25,50,75,100",
    draws: Annotated[
        int, typer.Option(min=1, help="Number of draws of each set at each level.")
    ] = 5000,
    jobs: options.Jobs = -1,
    cluster: options.Scheduler = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of all draws.")] = 0,
    grf: Annotated[
        str,
        typer.Option(
            help="Ground reactions: lab (fixed in the laboratory) or foot (carried with the foot)."
        ),
    ] = "lab",
    parameters: Annotated[
        str, typer.Option(help="Number of joint parameters: 27 or 17 of each leg, or all 98.")
    ] = "27",
    position_bound: Annotated[
        float, typer.Option(min=0, help="Bound of joint positions, mm.")
    ] = 10.0,
    orientation_bound: Annotated[
        float, typer.Option(min=0, max=45, help="Bound of joint orientations, deg.")
    ] = 10.0,
    ip_bound: Annotated[
        float, typer.Option(min=0, max=90, help="Bound of inertial parameters, %.")
    ] = 10.0,
    noise_bound: Annotated[
        float, typer.Option(min=0, help="Largest amplitude of marker noise, mm.")
    ] = 10.0,
    trial: Annotated[
        str | None, typer.Option(help="Gait trial. Default: the first with ground reactions.")
    ] = None,
    until_converged: options.UntilConverged = False,
    expect: options.Expect = None,
) -> None:
    """Run the missing draws of a study, write tables and figures, and print a summary.

    Parameters
    ----------
    expect
        Marker error (RMS, mm) for which torque errors are printed. If the study has draws, only
        these are printed, and nothing is computed.

    Raises
    ------
    UsageError
        An option is invalid.
    InputError
        The folder has no usable result, or draws with other settings.
    ConvergenceError
        `until_converged` is set, and the draws do not suffice.
    InterruptedWork
        The run was interrupted; finished draws are kept.
    """
    store, plan = Store(folder / FOLDER), _parse_plan(vary, levels, draws)
    choice = _require_allowed(parameters, [str(c.value) for c in ParameterChoice], "--parameters")
    settings = MonteCarloSettings(
        seed=seed,
        parameters=ParameterChoice(int(choice)),
        position_mm=position_bound,
        orientation_deg=orientation_bound,
        inertial_percent=ip_bound,
        noise_mm=noise_bound,
    )
    frame = ReactionFrame(_require_allowed(grf, [frame.value for frame in ReactionFrame], "--grf"))
    workers = choose_workers(jobs, cluster)
    drawn = store.read() if expect is not None else None
    if expect is not None and drawn is not None and not drawn.empty:
        # A later calibration keeps the draws of an earlier one, which has another model.
        if (folder / MODEL).exists():
            store.require_model(load_case(folder, trial or store.case_name, lambda text: None))
        _print_expectation(console, compute_statistics(drawn), expect)
        return
    require_not_refused(folder)
    with console.show_progress() as step:
        step("reading the model and its motion")
        case, read = read_case(folder, trial, step)
    # The draws have one writer at a time.
    with lock_folder(store.folder, PURPOSE):
        try:
            with _show_draw_progress(console) as draws_done:
                study = monte_carlo(
                    case,
                    store.folder,
                    settings=settings,
                    plan=plan,
                    workers=workers,
                    progress=draws_done,
                    until_converged=until_converged,
                )
        except (KeyboardInterrupt, Stopped) as ending:
            work = "finished draws are kept; the same command continues with the others"
            raise InterruptedWork(ending, work) from None
        with console.show_progress() as step, amend_result(store.folder) as stage:
            step("tables and figures")
            context = draw.MonteCarloContext(case, settings)
            contributions = compute_variance_contributions(context)
            contributions.to_csv(stage / "contributions.csv", index=False, lineterminator="\n")
            write_monte_carlo_figures(
                study.statistics, contributions, stage / "figures", SHOWN_SIDE
            )
            read.require_unchanged()
            on_page = _add_to_page(folder, study, contributions)
    for remark in read.remarks:
        console.print_line(f"warning: {remark}")
    _print_study(console, study, frame)
    _print_linearity(console, context, study)
    if expect is not None:
        _print_expectation(console, study.statistics, expect)
    console.print_line(f"tables and figures: {store.folder}")
    if on_page:
        console.print_line(on_page)
    if until_converged and not study.converged:
        raise ConvergenceError(
            f"not converged after {study.plan.draws} draws of each set and level"
        )


def _add_to_page(folder: Path, study: MonteCarloStudy, contributions: pd.DataFrame) -> str:
    """Add the study to the page of the result; return a line for the user, empty without a page."""
    if not (folder / PAGE_DATA).exists():
        return ""
    with amend_result(folder) as stage:
        try:
            shown = read_page(folder)
        except InputError as error:
            return f"warning: the page was not updated: {error}"
        rms = _read_marker_rms(folder, study.case.name)
        page_data = add_monte_carlo(
            shown.data or {}, study, marker_rms=rms, contributions=contributions
        )
        rewrite_page(stage, shown.scene, page_data)
    return f"page: {folder / PAGE}, preset Trust"


def _read_marker_rms(folder: Path, trial: str) -> float | None:
    """Read the calibrated marker error of pelvis and legs (RMS, mm) from the summary.

    None for a study folder, or a trial without markers.
    """
    try:
        summary = json.loads((folder / SUMMARY).read_text(encoding="utf-8"))["trials"][trial]
        return float((summary.get("pelvis_and_legs_mm") or summary["rms_mm"])["calibrated"])
    except (OSError, ValueError, KeyError, TypeError):
        return None


def _split(text: str) -> list[str]:
    """Split comma-separated text."""
    return [part.strip() for part in text.split(",") if part.strip()]


def _require_allowed(name: str, allowed: list[str], option: str) -> str:
    """Return a name that is allowed; raise UsageError for any other."""
    if name not in allowed:
        raise UsageError(
            f"found '{name}'; allowed: {', '.join(allowed)}{suggest_name(name, allowed)}",
            field=option,
        )
    return name


@contextmanager
def _show_draw_progress(console: Console) -> Iterator[DrawProgress]:
    """Show the progress of draws on standard error.

    A bar on a terminal; else, with `-v`, one line for each tenth of the draws.
    """
    started = time.monotonic()
    if console.err.is_terminal and not console.quiet:
        columns = (
            progress.TextColumn("draws"),
            progress.BarColumn(),
            progress.TaskProgressColumn(),
            progress.MofNCompleteColumn(),
            progress.TextColumn("{task.fields[rate]}"),
            progress.TimeRemainingColumn(elapsed_when_finished=True),
        )
        with progress.Progress(*columns, console=console.err) as bar:
            task = bar.add_task("draws", total=None, rate="")

            def show(done: int, todo: int) -> None:
                bar.update(
                    task,
                    total=todo,
                    completed=done,
                    rate=f"{_compute_rate(done, started):.0f} draws/s",
                )

            yield show
        return
    tenths = 0

    def print_tenth(done: int, todo: int) -> None:
        nonlocal tenths
        if console.verbose and 10 * done // max(todo, 1) > tenths:
            tenths = 10 * done // max(todo, 1)
            rate = _compute_rate(done, started)
            left = (todo - done) / rate
            console.err.print(
                Text(f"{done} of {todo} draws, {rate:.0f} draws/s, {left:.0f} s left")
            )

    yield print_tenth


def _compute_rate(done: int, started: float) -> float:
    """Compute draws per second since `started` (s, of `time.monotonic`)."""
    return done / max(time.monotonic() - started, 1e-9)


def _print_study(console: Console, study: MonteCarloStudy, frame: ReactionFrame) -> None:
    """Print torque errors, failures and convergence of a study."""
    table = study.statistics
    console.print_line(
        f"{study.case.name}: mean RMS torque errors, left leg, %BW*H; {FRAME_WORDS[frame]}"
    )
    _print_errors(console, table, frame)
    for note in study.notes:
        console.print_line(note)
    failures = [
        f"{row.set} {row.level} %: {row.failed} of {row.draws + row.failed}"
        for row in list_cells_with_failures(table).itertuples()
    ]
    if failures:
        console.print_line(
            f"not converged, and left out of these figures: {'; '.join(failures)} draws"
        )
    open_rows = select_unconverged(table)
    if open_rows.empty:
        console.print_line(
            "convergence: mean and CV of every torque stay within 2 % over the last tenth of the "
            "draws"
        )
    else:
        settles = open_rows[["mean_settles", "cv_settles"]].max(axis=1)
        worst = "too few draws" if settles.isna().any() else f"worst {settles.max():.1f} %"
        rows = int((table["measure"].eq("rms") & table["grf"].ne("")).sum())
        console.print_line(
            f"convergence: not met by {len(open_rows)} of {rows} distributions, {worst}; "
            "--until-converged"
        )
    console.print_line(
        f"draws: {len(study.draws)}, of which {study.computed} in this run and {study.failed} not "
        "converged"
    )


def _print_linearity(
    console: Console, context: draw.MonteCarloContext, study: MonteCarloStudy
) -> None:
    """Print how well the linearised contributions of the parameters predict the draws."""
    if study.plan.draws < FEWEST:
        return
    for varied, level in study.plan.cells:
        if varied is Varied.JP and level in (min(study.plan.levels), max(study.plan.levels)):
            agreement = [
                compute_linear_agreement(context, study.draws, (varied, level), frame)
                for frame in ReactionFrame
            ]
            ranges = ", ".join(
                f"R² {r.min():.2f} to {r.max():.2f} ({frame.value})"
                for r, frame in zip(agreement, ReactionFrame, strict=True)
            )
            console.print_line(f"linearised contributions against draws, JP at {level} %: {ranges}")


def _print_errors(console: Console, table: pd.DataFrame, frame: ReactionFrame) -> None:
    """Print mean errors of torques (%BW*H) and markers (mm) for each set and level."""
    shown = make_frameless_table(
        ("set",), (head.replace(" ", "\n") for head in ("level %", *HEADINGS, "markers mm"))
    )
    for varied in Varied:
        columns = [select_levels(table, varied, f"{t}_{SHOWN_SIDE}", frame) for t in draw.TORQUES]
        columns.append(select_levels(table, varied, f"markers_{SHOWN_SIDE}"))
        for k in range(len(columns[0])):
            level = str(columns[0]["level"].iloc[k])
            shown.add_row(varied.title, level, *(f"{c['average'].iloc[k]:.3f}" for c in columns))
    console.out.print(shown)


def _print_expectation(console: Console, table: pd.DataFrame, rms_mm: float) -> None:
    """Print the torque errors to expect at a marker error (RMS, mm).

    Raises InputError: the study has no set that changes marker errors.
    """
    causes = estimate_expected_errors(table, rms_mm, SHOWN_SIDE)
    if not causes:
        message = "the study has neither the set jp nor the set noise, which change marker errors"
        raise InputError(message, field="--expect", code=Code.MONTE_CARLO)
    for cause in causes:
        more = "more than " if cause.beyond else ""
        console.print_line(
            f"a marker RMS of {rms_mm:g} mm corresponds to {cause.varied.title} at "
            f"{more}{cause.level:.0f} %:"
        )
        shown = make_frameless_table(
            ("RMS error, %BW*H", "ground reactions"), ("average", "10 %", "50 %", "90 %")
        )
        for row in cause.torques.itertuples():
            numbers = (f"{value:.3f}" for value in (row.average, row.p10, row.p50, row.p90))
            shown.add_row(draw.TORQUE_LABELS[row.torque[:-2]], str(row.grf), *numbers)
        console.out.print(shown)


DATA = "GAITCAL_DATA"
"""Environment variable: folder of public recordings."""
DRAWS_SUFFIX = ".draws"
"""Suffix of the folder beside the output that keeps the draws, so that a study can continue."""
_PRINTED_TABLES = ("I", "III", "discussion")


def run_reproduction(
    console: Console,
    out: options.Out,
    draws: Annotated[
        int, typer.Option(min=0, help="Monte Carlo draws (published: 5000); 0: tables only.")
    ] = 0,
    noise_seeds: Annotated[
        int, typer.Option(min=2, help="Draws of marker noise for medians and ranges.")
    ] = 20,
    seed: Annotated[
        int, typer.Option(min=0, help="Seed of noise, inertial seeds and Monte Carlo draws.")
    ] = 0,
) -> None:
    """Repeat the published study, write its tables and print them.

    Raises
    ------
    InputError
        The output folder has other content, or the folder of recordings does not exist.
    """
    settings = ReproductionSettings(
        noise_seeds=noise_seeds, seed=seed, draws=draws, data=_find_data_folder()
    )
    kept = out.with_name(out.name + DRAWS_SUFFIX) if draws else None
    check_output_folder(out, ResultKind.REPRODUCTION)
    with (
        console.show_progress() as step,
        write_result_folder(out, ResultKind.REPRODUCTION) as folder,
    ):
        reproduction = reproduce(settings, kept, step)
        step("tables and figures")
        write_tables(reproduction, folder)
        if reproduction.disturbances is not None:
            write_monte_carlo_figures(
                reproduction.disturbances, None, folder / "figures", SHOWN_SIDE
            )
    _print_reproduction(console, reproduction)
    console.print_line(f"tables: {out}")
    if kept is not None:
        console.print_line(f"draws:  {kept} (a further run with the same seed continues from them)")


def _find_data_folder() -> Path | None:
    """Find the folder of public recordings; None if the variable is not set."""
    name = os.environ.get(DATA)
    if not name:
        return None
    if not Path(name).is_dir():
        raise InputError("is not a folder", source=name, field=DATA, code=Code.NO_FILE)
    return Path(name)


def _print_reproduction(console: Console, reproduction: Reproduction) -> None:
    """Print Tables I and III, the discussion, times and claims; the files have the other tables."""
    for name in _PRINTED_TABLES:
        rows = [row for row in reproduction.tables if row.table == name]
        console.print_line()
        console.print_line("Discussion" if name == "discussion" else f"Table {name}")
        _print_rows(console, rows)
    console.print_line()
    console.print_line(
        f"With noise: medians of {len(reproduction.noisy)} draws; ranges are in tables.csv. Times:"
    )
    _print_rows(console, [row for row in reproduction.times if row.row != printed_tables.RUN])
    laps = (
        f"{row.column} {row.ours:.0f} s"
        for row in reproduction.times
        if row.row == printed_tables.RUN
    )
    console.print_line(f"{printed_tables.RUN}: {', '.join(laps)}")
    console.print_line()
    _print_claims(console, reproduction.claims)


def _print_rows(console: Console, rows: Sequence[printed_tables.TableRow]) -> None:
    """Print rows of a table with our and the published value in each cell."""
    columns = list(dict.fromkeys(row.column for row in rows))
    table = make_frameless_table(("ours | published",), columns)
    for title in dict.fromkeys(row.row for row in rows):
        cells = {row.column: _format_cell(row) for row in rows if row.row == title}
        table.add_row(Text(title), *(cells.get(column, "") for column in columns))
    console.out.print(table)


def _format_cell(row: printed_tables.TableRow) -> str:
    """Format our and the published value with their unit."""
    ours, published = (
        "-" if value is None else f"{value:.3g}" for value in (row.ours, row.published)
    )
    return f"{ours} | {published} {row.unit}"


def _print_claims(console: Console, claims: Sequence[Claim]) -> None:
    """Print the claims that can be tested (with `-v`: all), and the number of each outcome."""
    table = make_frameless_table(("claims of the paper", "published", "ours", "verdict"))
    for claim in claims:
        if claim.verdict is not ClaimOutcome.NOT_TESTABLE or console.verbose:
            table.add_row(
                *(Text(t) for t in (claim.claim, claim.published, claim.ours, claim.verdict.value))
            )
    console.out.print(table)
    counts = {v: sum(claim.verdict is v for claim in claims) for v in ClaimOutcome}
    console.print_line(
        "claims of the paper: "
        + ", ".join(f"{count} {v.value}" for v, count in counts.items() if count)
    )
