"""Export the strides of a result in another convention, and write the manifest of an export folder.

Angles, powers, moments about the coordinates and their validity are those of `cycles.csv`. Moments
in segment frames or in the joint coordinate system come from `moment_vectors/TRIAL.csv`, over the
same strides.

A result does not contain the folder of its study, as it may be given away. Recordings are searched
for beside the result, in the working folder, where its drafted study has them, or in the folder
that the user gives. A file that is found must have the SHA-256 that the manifest records.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import cast

import numpy as np
import pandas as pd

from gaitcal.dynamics.ground_reactions import get_leg
from gaitcal.dynamics.joint_kinetics import MomentFrame, name_vector_column
from gaitcal.errors import Code, InputError
from gaitcal.gait.conventions import Convention
from gaitcal.gait.cycles import POINTS, CurveKind, GaitCycle, get_curve_kind, normalise
from gaitcal.io import result_folder, toml
from gaitcal.io.snapshot import Snapshot, read_whole
from gaitcal.model.subject_model import Subject, SubjectModel
from gaitcal.results.cycle_tables import CYCLES, DIGITS
from gaitcal.results.stride_uses import STRIDES, read_uses
from gaitcal.results.summary import VECTOR_FOLDER, get_entries, get_table, read_vectors
from gaitcal.results.table_files import VERDICT, Json, format_json, read_csv, write_csv
from gaitcal.results.trial_tables import select_free_components

MOMENT = CurveKind.MOMENT.ending
NUMBERS = ("value", "se", "se_stride")
"""Columns that a convention changes; the second part of the error where the table has it."""
HEADER = (
    "strides of each foot, from its strike (0 %) to its next one (100 %), numbered from 1 in each "
    "trial and side",
    "se: standard error, se_stride: the part of it that strides do not share, empty where unknown; "
    "valid: 1 where the",
    "value may be used; as in cycles.csv of the result",
)
"""Comment lines above the header, before those of the convention."""
RELATIVE = ("joint angles are relative", "static trial, deg")
"""Beginnings of comment lines on angles from the static posture."""


@dataclass(frozen=True)
class _StrideTables:
    """The tables of a result that a conversion needs."""

    model: SubjectModel
    table: pd.DataFrame  # `cycles.csv`, as text
    comments: tuple[str, ...]
    strides: Mapping[tuple[str, str], tuple[GaitCycle, ...]]  # Trial and side -> strides
    vectors: Mapping[str, pd.DataFrame]  # Trial -> table of moment vectors


def convert_strides(
    strides: pd.DataFrame, convention: Convention, model: SubjectModel
) -> pd.DataFrame:
    """Convert a table of strides to another convention about the axes of the coordinates.

    Parameters
    ----------
    strides
        As `read_cycles` returns them.
    convention
        Signs, moment unit, acting body and frame.
    model
        The calibrated subject.

    Returns
    -------
    pandas.DataFrame
        The same rows with `unit` and `positive` at the end.
    """
    return apply_convention(_StrideTables(model, strides, (), {}, {}), convention)


def write_cycles_export(
    folder: Path, convention: Convention, target: Path, model: SubjectModel
) -> tuple[int, Snapshot]:
    """Write the strides of a result in another convention.

    Parameters
    ----------
    folder
        The result, or its folder of further trials (`gaitcal dynamics`).
    convention
        Signs, moment unit, acting body and frame.
    target
        The CSV file to write.
    model
        The model with which the trials were made.

    Returns
    -------
    int
        Number of rows.
    Snapshot
        The files that were read.

    Raises
    ------
    InputError
        The result is damaged, or has no strides.
    """
    found, snapshot = _read_whole(folder, convention.frame, model)
    table = apply_convention(found, convention)
    write_csv(table, target, (*found.comments, *HEADER, *convention.lines))
    return len(table), snapshot


def _read_whole(
    folder: Path, frame: MomentFrame, model: SubjectModel
) -> tuple[_StrideTables, Snapshot]:
    names = [CYCLES]
    if frame is not MomentFrame.COORDINATES:
        names += [STRIDES]
        names += sorted(
            path.relative_to(folder).as_posix() for path in (folder / VECTOR_FOLDER).glob("*.csv")
        )
    if not (folder / CYCLES).exists():
        raise InputError(f"has no {CYCLES}; calibrate again", source=folder, code=Code.NO_RESULT)
    return read_whole(folder, names, lambda: _read(folder, frame, model))


def list_stale_trials(folder: Path, digest: str | None) -> tuple[str, ...]:
    """List the further trials that were made with another model.

    Parameters
    ----------
    folder
        Folder of further trials.
    digest
        SHA-256 of the present model.

    Returns
    -------
    tuple of str
        Names of trials.
    """
    made = get_table(
        result_folder.read_json_object(folder / result_folder.MANIFEST), "model_sha256"
    )
    return tuple(trial for trial, model_digest in made.items() if model_digest != digest)


def _read(folder: Path, frame: MomentFrame, model: SubjectModel) -> _StrideTables:
    table, comments = read_csv(folder / CYCLES)
    strides: dict[tuple[str, str], tuple[GaitCycle, ...]] = {}
    vectors = {}
    for use in () if frame is MomentFrame.COORDINATES else read_uses(folder):
        key = use.trial, use.side
        strides[key] = (*strides.get(key, ()), use.cycle)
    names = list(dict.fromkeys(table["trial"]))
    for name in names:
        of_trial = None if frame is MomentFrame.COORDINATES else read_vectors(folder, name)
        if of_trial is not None:
            vectors[name] = of_trial
        elif frame is not MomentFrame.COORDINATES and any(
            variable.endswith(MOMENT)
            for variable in table["variable"][table["trial"] == name].unique()
        ):
            message = (
                f"has no {VECTOR_FOLDER}/{name}.csv, which moments in this frame need; calibrate "
                "again"
            )
            raise InputError(message, source=folder, code=Code.DAMAGED_RESULT)
    # keep comment lines on verdicts and relative angles, not those on the former convention
    kept_starts = (*(f"{name}: {VERDICT}" for name in names), *RELATIVE)
    kept = tuple(line for line in comments if line.startswith(kept_starts))
    return _StrideTables(model, table, kept, strides, vectors)


def apply_convention(found: _StrideTables, convention: Convention) -> pd.DataFrame:
    """Convert the rows of `cycles.csv`, with `unit` and `positive` at the end."""
    numbers = [name for name in NUMBERS if name in found.table]
    table = found.table.assign(**{name: pd.to_numeric(found.table[name]) for name in numbers})
    if convention.frame is not MomentFrame.COORDINATES:
        kept = table[~table["variable"].str.endswith(MOMENT)]
        table = pd.concat([kept, *_build_vector_rows(found, convention.frame)], ignore_index=True)
    subject, parts = found.model.subject, []
    for (variable, side), rows in table.groupby(["variable", "side"], sort=False):
        parts.append(_convert_rows(rows, str(variable), str(side), convention, subject, numbers))
    whole = pd.concat(parts).sort_index() if parts else table.assign(unit="", positive="")
    whole[numbers] = whole[numbers].round(DIGITS)
    return whole


def _convert_rows(
    rows: pd.DataFrame,
    variable: str,
    side: str,
    convention: Convention,
    subject: Subject,
    numbers: list[str],
) -> pd.DataFrame:
    """Convert the rows of one variable of one side."""
    changed = {
        name: convention.values(variable, rows[name].to_numpy(dtype=np.float64), side, subject)
        for name in numbers
    }
    # A convention may reverse the sign of a curve, but not of a standard error.
    changed |= {name: np.abs(values) for name, values in changed.items() if name != "value"}
    kind = get_curve_kind(variable)
    units = {CurveKind.MOMENT: convention.unit.label, CurveKind.POWER: convention.unit.power}
    quantity = f"{convention.acting.key}, " if kind is CurveKind.MOMENT else ""
    positive = f"{quantity}{convention.senses(variable, side)[0]}"
    return rows.assign(**changed, unit=units.get(kind, kind.unit), positive=positive)


def _build_vector_rows(found: _StrideTables, frame: MomentFrame) -> list[pd.DataFrame]:
    """Build the rows of moments in segment frames or in the joint coordinate system."""
    parts = []
    for (trial, side), cycles in found.strides.items():
        table = found.vectors.get(trial)
        of_trial = found.table[(found.table["trial"] == trial) & (found.table["side"] == side)]
        if table is None or of_trial.empty:
            continue
        # Both files are of one run unless one of them was edited.
        if len(cycles) != of_trial["stride"].nunique():
            message = f"{CYCLES} and {STRIDES} differ in the strides of '{trial}'; calibrate again"
            raise InputError(message, code=Code.DAMAGED_RESULT)
        time, unknown = table["time"].to_numpy(dtype=np.float64), np.full(len(table), np.nan)
        names = [
            name
            for name in select_free_components(found.model.frozen)
            if get_leg(name) in (side, "")
        ]
        for stride, cycle in enumerate(cycles, start=1):
            # Person, session, turn and the other identifying columns are those of the stride.
            template = of_trial[of_trial["stride"] == str(stride)].iloc[:POINTS]
            for name in names:
                leg = get_leg(name)
                column, validity = (
                    name_vector_column(name, frame),
                    f"valid_{leg}" if leg else "valid",
                )
                usable = np.where(table[validity].to_numpy() == 1, 1.0, np.nan)
                signals = (
                    table.get(f"{column}{ending}", unknown) for ending in ("", "_se", "_se_stride")
                )
                value, error, differing, valid = (
                    normalise(time, np.asarray(values, dtype=np.float64), cycle)
                    for values in (*signals, usable)
                )
                parts.append(
                    template.assign(
                        variable=f"{name[:-2] if leg else name}{MOMENT}",
                        value=value,
                        se=error,
                        valid=np.isfinite(valid).astype(int).astype(str),
                        **({"se_stride": differing} if "se_stride" in found.table else {}),
                    )
                )
    return parts


def write_export_manifest(
    stage: Path,
    folder: Path,
    read: Mapping[str, str | None],
    subject: str,
    written: Mapping[str, Mapping[str, Json]],
) -> None:
    """Write a manifest of the new files and of those of earlier exports in the same folder.

    Parameters
    ----------
    stage
        Contains the files that will join `folder`.
    folder
        May contain an earlier export and its manifest; a manifest of another kind of result stays.
    read
        File of the result that was read -> SHA-256.
    subject
        Name of the subject.
    written
        File -> its entry: format, source, notes.

    Raises
    ------
    InputError
        The earlier manifest is damaged.
    """
    earlier = result_folder.read_json_object(folder / result_folder.MANIFEST)
    # The folder is a result of another kind: its manifest is not touched.
    if earlier and earlier.get("kind") != result_folder.ResultKind.EXPORT.value:
        return
    if "result" in earlier and not isinstance(earlier.get("written"), dict):
        message = "is damaged; move it away and export again"
        raise InputError(message, source=folder / result_folder.MANIFEST, code=Code.DAMAGED_RESULT)
    hashes = {
        name: digest
        for name, digest in result_folder.read_listed_hashes(folder).items()
        if (folder / name).is_file()
    }
    # New files replace entries of earlier exports with the same name.
    hashes |= {
        name: result_folder.compute_sha256(stage / name) or ""
        for name in result_folder.list_files(stage)
    }
    about = {
        **cast(dict[str, Json], earlier.get("written", {})),
        **{name: dict(entry) for name, entry in written.items()},
    }
    result: dict[str, Json] = {"subject": subject, "sha256": dict(read)}
    for name in written:
        about[name] = {**cast(dict[str, Json], about[name]), "result": result}
    manifest: dict[str, Json] = {
        "gaitcal": toml.get_package_version("gaitcal"),
        "kind": result_folder.ResultKind.EXPORT.value,
        "written": {name: about[name] for name in sorted(about) if name in hashes},
        "files": list[Json](sorted(hashes)),
        result_folder.HASHES: dict[str, Json](sorted(hashes.items())),
    }
    manifest[result_folder.SELF_HASH] = result_folder.hash_manifest(manifest)
    (stage / result_folder.MANIFEST).write_text(format_json(manifest), encoding="utf-8")


STUDY = "study.toml"


def read_trial_files(folder: Path) -> dict[str, dict[str, str]]:
    """Read the input files of each trial from the manifest of a result.

    Parameters
    ----------
    folder
        A result folder.

    Returns
    -------
    dict
        Trial -> `file` and, if there is one, `forces`.

    Raises
    ------
    InputError
        The folder is not a result.
    """
    trials = result_folder.read_json_object(folder / result_folder.MANIFEST).get("trials")
    if not isinstance(trials, dict):
        message = "found no list of its trials' files; calibrate again"
        raise InputError(
            message, source=folder / result_folder.MANIFEST, field="trials", code=Code.CHANGED_FILE
        )
    files: dict[str, dict[str, str]] = {}
    for trial, named in trials.items():
        files[str(trial)] = {str(kind): str(name) for kind, name in named.items()}
    return files


def find_original(folder: Path, name: str, inputs: Path | None) -> Path:
    """Find an input of a result, unchanged since it was read.

    Parameters
    ----------
    folder
        The result.
    name
        The input, as the manifest names it.
    inputs
        Folder of recordings, searched with its subfolders. None: search beside the result, in it,
        in the working folder, in the places of its `study.toml`, and in the folders there.

    Returns
    -------
    Path
        A file with the recorded SHA-256.

    Raises
    ------
    InputError
        There is none, or it has changed.
    """
    hashes = result_folder.read_json_object(folder / result_folder.MANIFEST).get("inputs_sha256")
    wanted = hashes.get(name) if isinstance(hashes, Mapping) else None
    changed: Path | None = None
    for path, is_its_place in _list_candidates(folder, name, inputs):
        if not path.is_file():
            continue
        if wanted is not None and result_folder.compute_sha256(path) == wanted:
            return path
        changed = changed or (path if is_its_place else None)
    if changed is not None:
        message = "is not the file that the result was made from (another SHA-256); calibrate again"
        raise InputError(message, source=changed, code=Code.CHANGED_FILE)
    where = inputs or folder.resolve().parent
    cure = "" if inputs else "; name the folder of the recordings with --inputs FOLDER"
    raise InputError(
        f"found no '{name}', which the result was made from{cure}",
        source=where,
        code=Code.CHANGED_FILE,
    )


def _list_candidates(folder: Path, name: str, inputs: Path | None) -> Iterator[tuple[Path, bool]]:
    """Yield candidate paths, and whether a changed file there is an error.

    Elsewhere another file may have the same name.
    """
    roots = [inputs] if inputs else [folder.resolve().parent, folder, Path.cwd()]
    last = PurePosixPath(name).name
    for root in roots:
        yield root / name, True
        yield root / last, True
    for path in () if inputs else _list_study_files(folder):
        if path.name == last:
            yield path, False
    for root in roots:
        for path in sorted(root.rglob(last) if inputs else root.glob(f"*/{last}")):
            yield path, False


def _list_study_files(folder: Path) -> Iterator[Path]:
    """Yield the files of the drafted study in a result; none if it cannot be read."""
    try:
        content = toml.read_toml(folder / STUDY)
    except InputError:
        return
    for trial in get_entries(content, "trial"):
        named = (trial.get(key) for key in ("file", "forces"))
        yield from (folder / name for name in named if isinstance(name, str))
