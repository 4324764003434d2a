"""`gaitcal convert` and `export`: files from other programs, and for them, and joints for a model
of the user's own.
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, TypeVar

import numpy as np
import typer
from rich.text import Text

from gaitcal.calibration.joint_prior import make_study_prior
from gaitcal.cli import options
from gaitcal.cli.console import Console, frameless_table
from gaitcal.cli.options import MODELS
from gaitcal.dynamics.joint_kinetics import MomentFrame
from gaitcal.errors import Code, InputError, UsageError, nearest, note_of
from gaitcal.export import other_formats
from gaitcal.export.opensim import joint_moves, joint_transfer, osim_writer, transfer_account
from gaitcal.gait.conventions import Acting, Convention, MomentUnit, Signs
from gaitcal.io.atomic import convert_disk_errors, write_bytes_atomically, write_text_atomically
from gaitcal.io.formats import convert
from gaitcal.io.result_folder import amend_result
from gaitcal.report.figures.comparison_sheets import (
    render_list,
    render_plain_page,
    render_plain_table,
    render_warning,
)
from gaitcal.results import cycles_export
from gaitcal.results.cycle_tables import CYCLES
from gaitcal.results.recording_export import write_recordings
from gaitcal.results.saved_result import (
    MODEL,
    load_recorded_coordinates,
    load_result,
    load_result_model,
)
from gaitcal.results.table_files import Json

C3D, STRIDES, DYNAMICS = "c3d", "cycles", "dynamics"
JOINTS, MASSES = (
    "joints",
    "masses",
)  # What `--parameters` allows; the second never without the first
STAY, FOLLOW = "stay", "follow"  # What `--attachments` allows
SIGNS = {s.value: s for s in Signs} | {"gaitcal": Signs.OPENSIM}
"""What `--convention` allows; a file of normal bands says `gaitcal` or `opensim` for the same."""
WRITERS = {
    "osim": (osim_writer.write_osim, "model.osim"),
    "urdf": (other_formats.write_urdf, "model.urdf"),
    "mjcf": (other_formats.write_mjcf, "model.xml"),
}


def convert_recording(
    console: Console,
    source: Annotated[
        Path, typer.Argument(metavar="IN", help="A .c3d, .trc, .mot, .sto or .csv file.")
    ],
    target: Annotated[Path, typer.Argument(metavar="OUT", help="A .csv, .trc or .mot file.")],
) -> None:
    """Convert one recording and say which files were written."""
    for path in convert(source, target):
        console.line(f"wrote {path}")


Choice = TypeVar("Choice", Signs, MomentFrame, MomentUnit)


def convention_of(
    signs: str | None, moments: str | None, units: str | None, *, external: bool
) -> Convention | None:
    """The convention that the options of `export` say; None where they say none.

    Raises UsageError: There is no convention of such a name.
    """
    if signs is None and moments is None and units is None and not external:
        return None
    return Convention(
        signs=Signs.OPENSIM if signs is None else _chosen(SIGNS, signs, "--convention"),
        frame=MomentFrame.COORDINATES
        if moments is None
        else _chosen({f.key: f for f in MomentFrame}, moments, "--moments"),
        acting=Acting.EXTERNAL if external else Acting.INTERNAL,
        unit=MomentUnit.NM
        if units is None
        else _chosen({u.key: u for u in MomentUnit}, units, "--units"),
    )


def _chosen(known: Mapping[str, Choice], text: str, field: str) -> Choice:
    """The member of that name, capitals or not."""
    for name, member in known.items():
        if name.lower() == text.strip().lower():
            return member
    raise UsageError(
        f"found '{text}'; allowed: {', '.join(known)}{nearest(text, tuple(known))}", field=field
    )


def export(
    console: Console,
    result: options.Result,
    formats: options.Formats = MODELS,
    out: options.ExportFolder = None,
    inputs: options.Inputs = None,
    replace: options.Replace = False,
    convention: options.Signs = None,
    moments: options.Moments = None,
    external: options.External = False,
    units: options.Units = None,
    into: options.Into = None,
    names: options.Names = None,
    parameters: options.Transferred = JOINTS,
    attachments: options.Attachments = STAY,
    muscles: options.Muscles = False,
    draws: options.ModelDraws = 0,
    seed: options.ModelSeed = 0,
) -> None:
    """The fitted model in other programs' formats, or its joints in the user's own model."""
    of_result: dict[str, object] = {
        "inputs": inputs,
        "replace": replace,
        "convention": convention,
        "moments": moments,
    }
    of_result |= {"format": formats != MODELS, "external": external, "units": units}
    of_model: dict[str, object] = {
        "names": names,
        "parameters": parameters != JOINTS,
        "attachments": attachments != STAY,
    }
    of_model |= {"muscles": muscles, "draws": draws, "seed": seed}
    for name, value in (of_model if into is None else of_result).items():
        if value and into is None:
            raise UsageError(
                "found without --into; allowed: with --into MODEL.osim", field=f"--{name}"
            )
        if value:
            message = "found with --into, which writes one OpenSim model; allowed: without --into"
            raise UsageError(message, field=f"--{name}")
    if into is None:
        signs = convention_of(convention, moments, units, external=external)
        export_model(result, formats, out, inputs, console, signs, replace=replace)
    else:
        chosen = (parameters, attachments, names, muscles, draws, seed)
        export_into(result, into, out, console, *chosen)


def export_model(
    result: Path,
    formats: str,
    out: Path | None,
    inputs: Path | None,
    console: Console,
    convention: Convention | None,
    *,
    replace: bool,
) -> None:
    """Write the fitted model of a result in other programs' formats, its recordings as C3D files,
    its strides.

    `convention`: of the strides; None: as in `cycles.csv`. `replace`: of recordings,
    `write_recordings`.
    """
    allowed = (*WRITERS, C3D, STRIDES)
    chosen = [name.strip() for name in formats.split(",") if name.strip()]
    if not chosen:
        raise UsageError(
            f"found nothing; at least one of {', '.join(allowed)} is needed", field="--format"
        )
    for name in chosen:
        if name not in allowed:
            raise UsageError(
                f"found '{name}'; allowed: {', '.join(allowed)}{nearest(name, allowed)}",
                field="--format",
            )
    if inputs is not None and not inputs.is_dir():
        raise UsageError(
            f"found '{inputs}'; allowed: a folder that holds the recordings", field="--inputs"
        )
    if convention is not None and STRIDES not in chosen:
        message = (
            f"found a convention without the format it is for; allowed: with --format {STRIDES}"
        )
        raise UsageError(message, field="--convention, --moments, --external, --units")
    if replace and C3D not in chosen:
        raise UsageError(
            "found without the format it is for; allowed: with --format c3d", field="--replace"
        )
    strides = convention or Convention()
    model, read, doubts = load_result_model(result)
    folder = out or result / "export"
    recordings: dict[str, tuple[str, str, tuple[str, ...]]] = {}
    of_recordings: Mapping[str, str | None] = {}
    with amend_result(folder) as stage, console.working() as step:
        for name in (name for name in chosen if name in WRITERS):
            write, file = WRITERS[name]
            write(model, stage / file)
        if C3D in chosen:
            step("recordings as C3D files")
            recordings, whole = write_recordings(result, inputs, stage, instead=replace)
            whole.require_unchanged()
            of_recordings = whole.sha256
        tables: dict[str, int] = {}
        further: tuple[str, ...] = ()
        if STRIDES in chosen:
            step("strides")
            for source, file in ((result, CYCLES), (result / DYNAMICS, f"{DYNAMICS}_{CYCLES}")):
                if source == result or (source / CYCLES).exists():
                    tables[file], table = cycles_export.write_cycles_export(
                        source, strides, stage / file, model
                    )
                    table.require_unchanged()
                    start = "" if source == result else f"{DYNAMICS}/"
                    of_recordings = {
                        **of_recordings,
                        **{start + name: sha for name, sha in table.sha256.items()},
                    }
                    further = cycles_export.list_stale_trials(source, read.sha256[MODEL])
        read.require_unchanged()
        written: dict[str, dict[str, Json]] = {
            WRITERS[n][1]: {"format": n} for n in chosen if n in WRITERS
        }
        written |= {
            f"{trial}.c3d": {
                "format": C3D,
                "source": source,
                "source_sha256": digest,
                "notes": list(notes),
            }
            for trial, (source, digest, notes) in recordings.items()
        }
        written |= {
            f: {"format": STRIDES, "convention": dict[str, Json](strides.keys)} for f in tables
        }
        cycles_export.write_export_manifest(
            stage, folder, {**read.sha256, **of_recordings}, model.subject.name, written
        )
    for text in (*read.remarks, *map(note_of, doubts)):
        console.line(f"warning: {text}")
    for name in (name for name in chosen if name in WRITERS):
        console.line(f"wrote {folder / WRITERS[name][1]}")
    for trial, (_, _, notes) in recordings.items():
        console.line(f"wrote {folder / f'{trial}.c3d'}: {'; '.join(notes)}")
    for file, rows in tables.items():
        console.line(f"wrote {folder / file}: {rows} rows; {', '.join(strides.keys.values())}")
    if further:
        console.line(
            f"warning: made with another model than {MODEL} now is: {', '.join(further)}; run "
            "dynamics again"
        )
    if C3D in chosen and (
        still := sorted(set(cycles_export.read_trial_files(result)) - set(recordings))
    ):
        console.line(f"not written: {', '.join(still)}; a result holds no motion of static trials")


def _draws_folder(out: Path) -> Path:
    return out.with_name(f"{out.stem}_draws")


def _earlier(out: Path) -> list[Path]:
    """Draws and tables of muscles that an earlier run wrote for this file, which then fit it no
    more.
    """
    draws = sorted(p for p in _draws_folder(out).glob("*.osim") if re.fullmatch(r"\d{3,}", p.stem))
    tables = (out.with_suffix(end) for end in (".muscles.csv", ".attachments.csv"))
    return [*draws, *(p for p in tables if p.is_file())]


def export_into(
    result: Path,
    model: Path,
    out: Path | None,
    console: Console,
    parameters: str,
    attachments: str,
    names: Path | None,
    muscles: bool,
    draws: int,
    seed: int,
) -> None:
    """Write the user's OpenSim model with this person's joints, tables of what was done, and draws
    of it.
    """
    if out is None or out.suffix != ".osim":
        message = (
            f"found {'nothing' if out is None else repr(str(out))}; allowed: a file FILE.osim to "
            "be written"
        )
        raise UsageError(message, field="--out")
    if out.resolve() == model.resolve():
        raise UsageError("found the model that is read; allowed: another file", field="--out")
    if model.resolve().parent == _draws_folder(out).resolve():
        raise UsageError(
            "found a draw of --out, whose draws are replaced; allowed: another file", field="--into"
        )
    wanted = {word.strip() for word in parameters.split(",")}
    if wanted not in ({JOINTS}, {JOINTS, MASSES}):
        message = f"found '{parameters}'; allowed: {JOINTS} or {JOINTS},{MASSES}"
        raise UsageError(message, field="--parameters")
    if attachments not in (STAY, FOLLOW):
        raise UsageError(
            f"found '{attachments}'; allowed: {STAY} or {FOLLOW}", field="--attachments"
        )
    if muscles and not transfer_account.is_opensim_installed():
        raise UsageError(
            "needs OpenSim, which is not installed: pip install opensim", field="--muscles"
        )
    saved = load_result(result)
    if saved.uncertainty.joint is None:
        message = "its joint parameters were not calibrated: there is nothing to put into a model"
        raise InputError(message, source=result, code=Code.NO_RESULT)
    done = joint_transfer.transfer_joints(
        saved.model,
        model,
        errors=saved.uncertainty.joint,
        prior=make_study_prior(saved.settings.joint_prior),
        names=names,
        recorded=load_recorded_coordinates(result),
        marker_set=saved.marker_set,
        masses=MASSES in wanted,
        inertial=saved.uncertainty.inertial,
        follow=attachments == FOLLOW,
    )
    warnings = (*saved.files.remarks, *map(note_of, saved.doubts))
    for text in warnings:
        console.line(f"warning: {text}")
    saved.files.require_unchanged()
    write_bytes_atomically(out, done.content)
    write_text_atomically(
        out.with_suffix(".joints.csv"), joint_moves.format_joints_csv(done.joints)
    )
    earlier = _earlier(out)
    for path in earlier:
        with convert_disk_errors(path):
            path.unlink()
    if earlier:
        console.line(
            "removed, as of an earlier run: "
            f"{', '.join(str(p.relative_to(out.parent)) for p in earlier)}"
        )
    if done.moved_points:
        write_text_atomically(
            out.with_suffix(".attachments.csv"),
            joint_moves.format_moved_points_csv(done.moved_points),
        )
    tables, said = (
        [*transfer_account.make_joint_tables(done)],
        [*transfer_account.describe_transfer(done)],
    )
    for table in tables:
        _tell_table(console, table)
    for text in said:
        console.line(text)
    drawn = [_draws_folder(out) / f"{k + 1:03d}.osim" for k in range(draws)]
    with console.working() as step:
        rng = np.random.default_rng(seed)
        for k, path in enumerate(drawn):
            step(f"draw {k + 1} of {len(drawn)}")
            write_bytes_atomically(path, done.draw(rng))
        if muscles:
            ranges = transfer_account.list_leg_ranges(done.legs)
            step("muscles before")
            before = transfer_account.compute_muscle_paths(model, ranges)
            step("muscles after")
            changes = transfer_account.compare_muscles(
                before, transfer_account.compute_muscle_paths(out, ranges)
            )
            spread: list[Mapping[tuple[str, str], transfer_account.MusclePath]] = []
            for k, path in enumerate(drawn):
                step(f"muscles of draw {k + 1} of {len(drawn)}")
                spread.append(transfer_account.compute_muscle_paths(path, ranges))
            write_text_atomically(
                out.with_suffix(".muscles.csv"),
                transfer_account.format_muscles_csv(changes, spread),
            )
            tables.append(transfer_account.make_muscle_table(changes, spread))
    console.line()
    if muscles:
        _tell_table(console, tables[-1])
    else:
        said.append(
            "muscles: not computed; --muscles has OpenSim compute lengths and moment arms before "
            "and after"
        )
        console.line(said[-1])
    facts = (("result", str(result)), ("model", str(model)), ("now", str(out)))
    page = account_page(
        out.name, (("person", saved.model.subject.name), *facts), warnings, said, tables
    )
    write_text_atomically(out.with_suffix(".html"), page)
    written = (
        ".osim",
        ".html",
        ".joints.csv",
        *[".attachments.csv"] * bool(done.moved_points),
        *[".muscles.csv"] * muscles,
    )
    for end in written:
        console.line(f"wrote {out.with_suffix(end)}")
    if drawn:
        console.line(f"wrote {len(drawn)} draws: {drawn[0].parent}")
        if done.unchanged:
            console.line(
                f"draws have {', '.join(done.unchanged)} about the place that the model gives them, by "
                "their standard errors"
            )
        if done.masses and saved.uncertainty.inertial is None:
            console.line("all draws have the same masses: the result holds no errors of them")


def account_page(
    name: str,
    facts: Sequence[tuple[str, str]],
    warnings: Iterable[str],
    said: Iterable[str],
    tables: Iterable[transfer_account.AccountTable],
) -> str:
    """The page of what was done to a model: what was read, what to know, and whole tables."""
    parts = [
        render_plain_table("What was read and written", facts[0], facts[1:], name="who"),
        *map(render_warning, warnings),
        render_list(said),
    ]
    for t in tables:
        parts += [f'<h2>{t.title}</h2><p class="soft">{t.description}</p>']
        parts += [
            render_plain_table(
                t.title, (*t.text_columns, *t.number_columns), t.rows, words=len(t.text_columns)
            )
        ]
    return render_plain_page(f"What the export did to {name}", parts)


def _tell_table(console: Console, told: transfer_account.AccountTable) -> None:
    table = frameless_table(told.text_columns, told.number_columns)
    shown = told.rows[:SHOWN] if told.of_muscles else told.rows
    for row in shown:
        table.add_row(*map(Text, row))
    console.out.print(table)
    if len(told.rows) > len(shown):
        console.line(f"and {len(told.rows) - len(shown)} more in the file")
    console.line()


SHOWN = 12  # Muscles on the screen; the files have all
