"""`gaitcal convert` and `export`: files from other programs, and for them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TypeVar

from gaitcal.cli.console import Console
from gaitcal.dynamics.joint_kinetics import MomentFrame
from gaitcal.errors import UsageError, nearest
from gaitcal.export.osim import write_osim
from gaitcal.export.other_formats import write_mjcf, write_urdf
from gaitcal.findings import Finding, note_of
from gaitcal.gait.conventions import Acting, Convention, MomentUnit, Signs
from gaitcal.io.formats import convert
from gaitcal.io.result_folder import amended
from gaitcal.io.snapshot import Snapshot
from gaitcal.results.cycles import CYCLES
from gaitcal.results.cycles_export import (
    made_with_another_model,
    trial_files,
    write_cycles_export,
    write_export_manifest,
)
from gaitcal.results.recordings import WrittenRecording, write_recordings
from gaitcal.results.saved import MODEL, load_result_model
from gaitcal.results.table_file import Json

C3D, STRIDES, DYNAMICS = "c3d", "cycles", "dynamics"
SIGNS = {s.value: s for s in Signs} | {"gaitcal": Signs.OPENSIM}
"""What `--convention` allows; a file of normal bands says `gaitcal` or `opensim` for the same."""
WRITERS = {"osim": (write_osim, "model.osim"), "urdf": (write_urdf, "model.urdf"), "mjcf": (write_mjcf, "model.xml")}


def convert_recording(source: Path, target: Path, console: Console) -> None:
    """Convert one recording and say which files were written."""
    for path in convert(source, target):
        console.line(f"wrote {path}")


Choice = TypeVar("Choice", Signs, MomentFrame, MomentUnit)


def convention_of(signs: str | None, moments: str | None, units: str | None, *, external: bool) -> Convention | None:
    """The convention that the options of `export` say; None where they say none.

    Raises
    ------
    UsageError
        There is no convention of such a name.
    """
    if signs is None and moments is None and units is None and not external:
        return None
    return Convention(
        signs=Signs.OPENSIM if signs is None else _chosen(SIGNS, signs, "--convention"),
        frame=MomentFrame.COORDINATES
        if moments is None
        else _chosen({f.key: f for f in MomentFrame}, moments, "--moments"),
        acting=Acting.EXTERNAL if external else Acting.INTERNAL,
        unit=MomentUnit.NM if units is None else _chosen({u.key: u for u in MomentUnit}, units, "--units"),
    )


def _chosen(known: Mapping[str, Choice], text: str, field: str) -> Choice:
    """The member of that name, capitals or not."""
    for name, member in known.items():
        if name.lower() == text.strip().lower():
            return member
    raise UsageError(f"found '{text}'; allowed: {', '.join(known)}{nearest(text, tuple(known))}", field=field)


def export_model(
    result: Path,
    formats: str,
    out: Path | None,
    inputs: Path | None,
    console: Console,
    convention: Convention | None = None,
    *,
    replace: bool = False,
) -> None:
    """Write the fitted model of a result in other programs' formats, its recordings as C3D files, its strides.

    `convention`: of the strides; None: as in `cycles.csv`. `replace`: of recordings, `write_recordings`.
    """
    allowed = (*WRITERS, C3D, STRIDES)
    chosen = [name.strip() for name in formats.split(",") if name.strip()]
    if not chosen:
        raise UsageError(f"found nothing; at least one of {', '.join(allowed)} is needed", field="--format")
    for name in chosen:
        if name not in allowed:
            raise UsageError(f"found '{name}'; allowed: {', '.join(allowed)}{nearest(name, allowed)}", field="--format")
    if inputs is not None and not inputs.is_dir():
        raise UsageError(f"found '{inputs}'; allowed: a folder that holds the recordings", field="--inputs")
    if convention is not None and STRIDES not in chosen:
        message = f"found a convention without the format it is for; allowed: with --format {STRIDES}"
        raise UsageError(message, field="--convention, --moments, --external, --units")
    if replace and C3D not in chosen:
        raise UsageError("found without the format it is for; allowed: with --format c3d", field="--replace")
    strides = convention or Convention()
    model, read, doubts = load_result_model(result)
    folder = out or result / "export"
    recordings: tuple[WrittenRecording, ...] = ()
    of_recordings: Mapping[str, str | None] = {}
    with amended(folder) as stage, console.working() as step:
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
                    tables[file], table = write_cycles_export(source, strides, stage / file, model)
                    table.require_unchanged()
                    start = "" if source == result else f"{DYNAMICS}/"
                    of_recordings = {**of_recordings, **{start + name: sha for name, sha in table.sha256.items()}}
                    further = made_with_another_model(source, read.sha256[MODEL])
        read.require_unchanged()
        written: dict[str, dict[str, Json]] = {WRITERS[n][1]: {"format": n} for n in chosen if n in WRITERS}
        written |= {
            r.file: {"format": C3D, "source": r.source, "source_sha256": r.source_sha256, "notes": list(r.notes)}
            for r in recordings
        }
        written |= {f: {"format": STRIDES, "convention": dict[str, Json](strides.keys)} for f in tables}
        write_export_manifest(stage, folder, {**read.sha256, **of_recordings}, model.subject.name, written)
    _tell(console, read, doubts)
    for name in (name for name in chosen if name in WRITERS):
        console.line(f"wrote {folder / WRITERS[name][1]}")
    for recording in recordings:
        console.line(f"wrote {folder / recording.file}: {'; '.join(recording.notes)}")
    for file, rows in tables.items():
        console.line(f"wrote {folder / file}: {rows} rows; {', '.join(strides.keys.values())}")
    if further:
        console.line(f"warning: made with another model than {MODEL} now is: {', '.join(further)}; run dynamics again")
    if C3D in chosen and (still := sorted(set(trial_files(result)) - {r.trial for r in recordings})):
        console.line(f"not written: {', '.join(still)}; a result holds no motion of static trials")


def _tell(console: Console, read: Snapshot, doubts: Sequence[Finding]) -> None:
    """What a user of the model should know: files that were edited, a calibration that is doubtful or refused."""
    for text in (*read.remarks, *map(note_of, doubts)):
        console.line(f"warning: {text}")
