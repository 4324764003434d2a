"""Commands `convert` and `export`.

`convert` reads and writes recordings of other programs. `export` writes the model, recordings and
strides of a result for other programs, or puts its joints into an OpenSim model of the user.
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, TypeVar

import numpy as np
import typer
from rich.text import Text

from gaitcal.calibration.joint_prior import combine_joint_priors
from gaitcal.cli import options
from gaitcal.cli.console import Console, make_frameless_table
from gaitcal.cli.options import MODELS
from gaitcal.dynamics.joint_kinetics import MomentFrame
from gaitcal.errors import Code, InputError, UsageError, format_note, suggest_name
from gaitcal.export import other_formats
from gaitcal.export.opensim import joint_moves, joint_transfer, osim_writer, transfer_account
from gaitcal.export.opensim.osim_correspondence import LegJoint
from gaitcal.gait.conventions import Acting, Convention, MomentUnit, Signs
from gaitcal.io.atomic import convert_disk_errors, write_bytes_atomically, write_text_atomically
from gaitcal.io.formats import convert
from gaitcal.io.result_folder import amend_result
from gaitcal.model.subject_model import SubjectModel
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
from gaitcal.runtime import Progress

C3D, STRIDES, DYNAMICS = "c3d", "cycles", "dynamics"
JOINTS, MASSES = "joints", "masses"
"""Values of `--parameters`: joints, or joints and masses."""
STAY, FOLLOW = "stay", "follow"
"""Values of `--attachments`."""
SIGNS = {s.value: s for s in Signs} | {"gaitcal": Signs.OPENSIM}
"""Values of `--convention`; `gaitcal` is another name of `opensim` in files of normal bands."""
MAX_PRINTED_MUSCLES = 12
"""Printed rows of a table of muscles; the files have all."""
WRITERS = {
    "osim": (osim_writer.write_osim, "model.osim"),
    "urdf": (other_formats.write_urdf, "model.urdf"),
    "mjcf": (other_formats.write_mjcf, "model.xml"),
}
"""Format -> its writer, and the name of its file."""


def convert_recording(
    console: Console,
    source: Annotated[
        Path, typer.Argument(metavar="IN", help="A .c3d, .trc, .mot, .sto or .csv file.")
    ],
    target: Annotated[Path, typer.Argument(metavar="OUT", help="A .csv, .trc or .mot file.")],
) -> None:
    """Convert a recording, and print the files that were written."""
    for path in convert(source, target):
        console.print_line(f"wrote {path}")


Choice = TypeVar("Choice", Signs, MomentFrame, MomentUnit)


def choose_convention(
    signs: str | None, moments: str | None, units: str | None, *, external: bool
) -> Convention | None:
    """Choose the convention that the options describe.

    Parameters
    ----------
    signs, moments, units
        Names of signs, of the frame of moments and of their unit; None: the default.
    external
        Whether moments are external.

    Returns
    -------
    Convention or None
        None if no option is given.

    Raises
    ------
    UsageError
        A name is unknown.
    """
    if signs is None and moments is None and units is None and not external:
        return None
    return Convention(
        signs=Signs.OPENSIM if signs is None else _choose_member(SIGNS, signs, "--convention"),
        frame=MomentFrame.COORDINATES
        if moments is None
        else _choose_member({f.key: f for f in MomentFrame}, moments, "--moments"),
        acting=Acting.EXTERNAL if external else Acting.INTERNAL,
        unit=MomentUnit.NM
        if units is None
        else _choose_member({u.key: u for u in MomentUnit}, units, "--units"),
    )


def _choose_member(known: Mapping[str, Choice], text: str, field: str) -> Choice:
    """Choose the member of that name, ignoring case."""
    for name, member in known.items():
        if name.lower() == text.strip().lower():
            return member
    raise UsageError(
        f"found '{text}'; allowed: {', '.join(known)}{suggest_name(text, tuple(known))}",
        field=field,
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
    """Write the fitted model in other programs' formats, or its joints into the user's model.

    Raises
    ------
    UsageError
        An option is invalid, or does not apply with or without `--into`.
    InputError
        The result or the model cannot be read.
    """
    # Two commands in one: an option of the other one is an error, not ignored.
    result_options: dict[str, object] = {
        "inputs": inputs,
        "replace": replace,
        "convention": convention,
        "moments": moments,
    }
    result_options |= {"format": formats != MODELS, "external": external, "units": units}
    model_options: dict[str, object] = {
        "names": names,
        "parameters": parameters != JOINTS,
        "attachments": attachments != STAY,
    }
    model_options |= {"muscles": muscles, "draws": draws, "seed": seed}
    if into is None:
        message = "found without --into; allowed: with --into MODEL.osim"
    else:
        message = "found with --into, which writes one OpenSim model; allowed: without --into"
    for name, value in (model_options if into is None else result_options).items():
        if value:
            raise UsageError(message, field=f"--{name}")
    if into is None:
        signs = choose_convention(convention, moments, units, external=external)
        _export_model(result, formats, out, inputs, console, signs, replace=replace)
    else:
        chosen = (parameters, attachments, names, muscles, draws, seed)
        _export_into(result, into, out, console, *chosen)


def _export_model(
    result: Path,
    formats: str,
    out: Path | None,
    inputs: Path | None,
    console: Console,
    convention: Convention | None,
    *,
    replace: bool,
) -> None:
    """Write the model of a result for other programs, its recordings as C3D files, its strides.

    Parameters
    ----------
    result
        Result folder.
    formats
        Comma-separated: keys of `WRITERS`, `c3d`, `cycles`.
    out
        Folder for the files; `result/export` if None.
    inputs
        Folder of the recordings; None: as in `write_recordings`.
    convention
        Convention of the strides; None: that of `cycles.csv`.
    replace
        Whether outputs of another program in the recordings are replaced.

    Raises
    ------
    UsageError
        A format is unknown, or an option does not apply to the formats.
    InputError
        The result or a recording cannot be read, or changed meanwhile.
    """
    chosen = _check_formats(formats, inputs, convention, replace=replace)
    strides = convention or Convention()
    model, read, doubts = load_result_model(result)
    folder = out or result / "export"
    exported = _Exported()
    # All files appear together, or none.
    with amend_result(folder) as stage, console.show_progress() as step:
        for name in chosen:
            if name in WRITERS:
                write, file = WRITERS[name]
                write(model, stage / file)
                exported.entries[file] = {"format": name}
        if C3D in chosen:
            step("recordings as C3D files")
            _export_recordings(exported, result, inputs, stage, replace=replace)
        if STRIDES in chosen:
            step("strides")
            _export_strides(exported, result, strides, stage, model, read.sha256[MODEL])
        read.require_unchanged()
        cycles_export.write_export_manifest(
            stage, folder, {**read.sha256, **exported.sha256}, model.subject.name, exported.entries
        )
    for text in (*read.remarks, *map(format_note, doubts)):
        console.print_line(f"warning: {text}")
    for file in exported.entries:
        details = exported.details.get(file)
        console.print_line(f"wrote {folder / file}" + (f": {details}" if details else ""))
    if exported.stale:
        console.print_line(
            f"warning: {', '.join(exported.stale)} were analysed with another model than the "
            f"present {MODEL}; run dynamics again"
        )
    if exported.static:
        console.print_line(
            f"not written: {', '.join(exported.static)}; a result has no motion of static trials"
        )


@dataclass
class _Exported:
    """Files that an export has written, for its manifest and for the user."""

    entries: dict[str, dict[str, Json]] = field(default_factory=dict)
    """File -> its entry in the manifest."""
    details: dict[str, str] = field(default_factory=dict)
    """File -> what is printed about it."""
    sha256: dict[str, str | None] = field(default_factory=dict)
    """File of the result that was read -> its SHA-256."""
    stale: tuple[str, ...] = ()
    """Further trials that were analysed with another model."""
    static: tuple[str, ...] = ()
    """Trials without a motion, which have no C3D file."""


def _check_formats(
    formats: str, inputs: Path | None, convention: Convention | None, *, replace: bool
) -> list[str]:
    """Parse formats; raise UsageError if one is unknown or an option does not apply to them."""
    allowed = (*WRITERS, C3D, STRIDES)
    chosen = [name.strip() for name in formats.split(",") if name.strip()]
    if not chosen:
        raise UsageError(
            f"found nothing; at least one of {', '.join(allowed)} is needed", field="--format"
        )
    for name in chosen:
        if name not in allowed:
            raise UsageError(
                f"found '{name}'; allowed: {', '.join(allowed)}{suggest_name(name, allowed)}",
                field="--format",
            )
    if inputs is not None and not inputs.is_dir():
        raise UsageError(
            f"found '{inputs}'; allowed: the folder of the recordings", field="--inputs"
        )
    if convention is not None and STRIDES not in chosen:
        message = f"found without the format that has conventions; allowed: with --format {STRIDES}"
        raise UsageError(message, field="--convention, --moments, --external, --units")
    if replace and C3D not in chosen:
        raise UsageError(
            "found without the format of recordings; allowed: with --format c3d", field="--replace"
        )
    return chosen


def _export_recordings(
    exported: _Exported, result: Path, inputs: Path | None, stage: Path, *, replace: bool
) -> None:
    """Write the recordings of a result as C3D files."""
    recordings, read = write_recordings(result, inputs, stage, instead=replace)
    read.require_unchanged()
    exported.sha256 |= read.sha256
    for trial, (source, digest, notes) in recordings.items():
        file = f"{trial}.c3d"
        exported.entries[file] = {
            "format": C3D,
            "source": source,
            "source_sha256": digest,
            "notes": list(notes),
        }
        exported.details[file] = "; ".join(notes)
    trials = set(cycles_export.read_trial_files(result))
    exported.static = tuple(sorted(trials - set(recordings)))


def _export_strides(
    exported: _Exported,
    result: Path,
    convention: Convention,
    stage: Path,
    model: SubjectModel,
    model_sha256: str | None,
) -> None:
    """Write the strides of a result, and of its further trials, in a convention."""
    keys = convention.keys
    for source, file in ((result, CYCLES), (result / DYNAMICS, f"{DYNAMICS}_{CYCLES}")):
        if source != result and not (source / CYCLES).exists():
            continue
        rows, read = cycles_export.write_cycles_export(source, convention, stage / file, model)
        read.require_unchanged()
        prefix = "" if source == result else f"{DYNAMICS}/"
        exported.sha256 |= {prefix + name: digest for name, digest in read.sha256.items()}
        exported.stale = cycles_export.list_stale_trials(source, model_sha256)
        exported.entries[file] = {"format": STRIDES, "convention": dict[str, Json](keys)}
        exported.details[file] = f"{rows} rows; {', '.join(keys.values())}"


def _get_draws_folder(out: Path) -> Path:
    """Get the folder of the draws of an exported model."""
    return out.with_name(f"{out.stem}_draws")


def _find_earlier_files(out: Path) -> list[Path]:
    """Find draws and tables that an earlier run wrote for this file, and that are now outdated."""
    draws = sorted(
        p for p in _get_draws_folder(out).glob("*.osim") if re.fullmatch(r"\d{3,}", p.stem)
    )
    tables = (out.with_suffix(end) for end in (".muscles.csv", ".attachments.csv"))
    return [*draws, *(p for p in tables if p.is_file())]


def _export_into(
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
    """Write the user's OpenSim model with this person's joints, tables of changes, and draws.

    Parameters
    ----------
    result
        Result folder.
    model
        OpenSim model of the user.
    out
        File to write, ending in `.osim`.
    parameters
        `joints` or `joints,masses`.
    attachments
        `stay` or `follow`: what muscle points, wraps and meshes do.
    names
        TOML file with the names of hips, knees and ankles; None: they are found.
    muscles
        Whether OpenSim computes muscle lengths and moment arms before and after.
    draws, seed
        Number of further models drawn within the standard errors, and seed.

    Raises
    ------
    UsageError
        An option is invalid.
    InputError
        The result has no calibrated joints, or the model does not fit.
    """
    target = _check_transfer(model, out, parameters, attachments, muscles=muscles)
    saved = load_result(result)
    if saved.uncertainty.joint is None:
        message = "joint parameters were not calibrated; a model needs calibrated joints"
        raise InputError(message, source=result, code=Code.NO_RESULT)
    done = joint_transfer.transfer_joints(
        saved.model,
        model,
        errors=saved.uncertainty.joint,
        prior=combine_joint_priors(saved.settings.joint_prior),
        names=names,
        recorded=load_recorded_coordinates(result),
        marker_set=saved.marker_set,
        masses=MASSES in parameters,
        inertial=saved.uncertainty.inertial,
        follow=attachments == FOLLOW,
    )
    warnings = (*saved.files.remarks, *map(format_note, saved.doubts))
    for text in warnings:
        console.print_line(f"warning: {text}")
    # Nothing is written from a result that changed while it was read.
    saved.files.require_unchanged()
    write_bytes_atomically(target, done.content)
    write_text_atomically(
        target.with_suffix(".joints.csv"), joint_moves.format_joints_csv(done.joints)
    )
    _remove_earlier_files(console, target)
    # Muscle points that follow the bones are listed with their old and new positions.
    if done.moved_points:
        write_text_atomically(
            target.with_suffix(".attachments.csv"),
            joint_moves.format_moved_points_csv(done.moved_points),
        )
    tables, lines = (
        [*transfer_account.make_joint_tables(done)],
        [*transfer_account.describe_transfer(done)],
    )
    for table in tables:
        _print_table(console, table)
    for text in lines:
        console.print_line(text)
    drawn = [_get_draws_folder(target) / f"{k + 1:03d}.osim" for k in range(draws)]
    with console.show_progress() as step:
        rng = np.random.default_rng(seed)
        # All draws come from one generator, so that the first ones do not depend on their number.
        for k, path in enumerate(drawn):
            step(f"draw {k + 1} of {len(drawn)}")
            write_bytes_atomically(path, done.draw(rng))
        if muscles:
            tables.append(_compare_muscles(model, target, drawn, done.legs, step))
    console.print_line()
    if muscles:
        _print_table(console, tables[-1])
    else:
        lines.append(
            "muscles: not computed; with --muscles, OpenSim computes lengths and moment arms "
            "before and after"
        )
        console.print_line(lines[-1])
    facts = (("result", str(result)), ("model", str(model)), ("now", str(target)))
    # The page is the record of all changes to the user's model.
    page = render_account_page(
        target.name, (("person", saved.model.subject.name), *facts), warnings, lines, tables
    )
    write_text_atomically(target.with_suffix(".html"), page)
    written = (
        ".osim",
        ".html",
        ".joints.csv",
        *[".attachments.csv"] * bool(done.moved_points),
        *[".muscles.csv"] * muscles,
    )
    for end in written:
        console.print_line(f"wrote {target.with_suffix(end)}")
    if drawn:
        console.print_line(f"wrote {len(drawn)} draws: {drawn[0].parent}")
        if done.unchanged:
            console.print_line(
                f"in draws, {', '.join(done.unchanged)} vary about their positions in the model by "
                "their standard errors"
            )
        if done.masses and saved.uncertainty.inertial is None:
            console.print_line(
                "all draws have the same masses: the result has no standard errors of masses"
            )


def _check_transfer(
    model: Path, out: Path | None, parameters: str, attachments: str, *, muscles: bool
) -> Path:
    """Check the options of `--into` and return the file to write; raise UsageError if invalid."""
    if out is None or out.suffix != ".osim":
        message = (
            f"found {'nothing' if out is None else repr(str(out))}; allowed: a file to write, "
            "FILE.osim"
        )
        raise UsageError(message, field="--out")
    if out.resolve() == model.resolve():
        raise UsageError("found the model that is read; allowed: another file", field="--out")
    if model.resolve().parent == _get_draws_folder(out).resolve():
        raise UsageError(
            "found a draw of --out, which would be replaced; allowed: another file", field="--into"
        )
    # The order of the names does not matter.
    transferred = {name.strip() for name in parameters.split(",")}
    if transferred not in ({JOINTS}, {JOINTS, MASSES}):
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
    return out


def _remove_earlier_files(console: Console, out: Path) -> None:
    """Remove the outdated files of an earlier run, and print their names."""
    earlier = _find_earlier_files(out)
    for path in earlier:
        with convert_disk_errors(path):
            path.unlink()
    if earlier:
        names = ", ".join(str(path.relative_to(out.parent)) for path in earlier)
        console.print_line(f"removed (of an earlier run): {names}")


def _compare_muscles(
    model: Path, out: Path, drawn: Sequence[Path], legs: Sequence[LegJoint], step: Progress
) -> transfer_account.AccountTable:
    """Compute muscles before and after by OpenSim, write their table, and return it."""
    ranges = transfer_account.list_leg_ranges(legs)
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
        out.with_suffix(".muscles.csv"), transfer_account.format_muscles_csv(changes, spread)
    )
    return transfer_account.make_muscle_table(changes, spread)


def render_account_page(
    name: str,
    facts: Sequence[tuple[str, str]],
    warnings: Iterable[str],
    lines: Iterable[str],
    tables: Iterable[transfer_account.AccountTable],
) -> str:
    """Render the page of the changes of a model: files, warnings, remarks and complete tables.

    `name`: file name of the model. `facts`: heading and value of each row of the first table.
    `warnings`, `lines`: warnings and remarks. Returns: the HTML page.
    """
    parts = [
        render_plain_table("Files", facts[0], facts[1:], name="who"),
        *map(render_warning, warnings),
        render_list(lines),
    ]
    for t in tables:
        parts += [f'<h2>{t.title}</h2><p class="soft">{t.description}</p>']
        parts += [
            render_plain_table(
                t.title, (*t.text_columns, *t.number_columns), t.rows, words=len(t.text_columns)
            )
        ]
    return render_plain_page(f"What the export did to {name}", parts)


def _print_table(console: Console, content: transfer_account.AccountTable) -> None:
    """Print a table of changes; of muscles only the first rows."""
    table = make_frameless_table(content.text_columns, content.number_columns)
    shown = content.rows[:MAX_PRINTED_MUSCLES] if content.of_muscles else content.rows
    for row in shown:
        table.add_row(*map(Text, row))
    console.out.print(table)
    if len(content.rows) > len(shown):
        console.print_line(f"and {len(content.rows) - len(shown)} more in the file")
    console.print_line()
