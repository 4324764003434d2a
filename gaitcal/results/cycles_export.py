"""The strides of a result in a convention of the user's choice: one table, each row with its unit
and what is positive; and the manifest of the folder that exports lie in.

Angles, powers, moments of the coordinates and which of them count are those of `cycles.csv`;
moments in the frames of segments or of the joint coordinate system come from
`moment_vectors/TRIAL.csv`, over the same strides.

A result does not say in which folder its study was, as it may be given away. Recordings are looked
for beside it, in the folder of the command, where the study that was drafted for it has them, or
where the user says; whatever is found must have the SHA-256 of what was read then.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import cast

import numpy as np
import pandas as pd

from gaitcal.dynamics.ground_reactions import leg_of
from gaitcal.dynamics.joint_kinetics import MomentFrame, vector_column
from gaitcal.errors import Code, InputError
from gaitcal.gait.conventions import Convention
from gaitcal.gait.cycles import (
    POINTS,
    CurveKind,
    FootEvents,
    GaitCycle,
    gait_cycles,
    kind_of,
    normalise,
)
from gaitcal.io import labels, result_folder, toml
from gaitcal.io.snapshot import Snapshot, read_whole
from gaitcal.model.linkage import SIDES
from gaitcal.model.subject_model import Subject, SubjectModel
from gaitcal.results import saved_result
from gaitcal.results.cycle_tables import CYCLES, DIGITS
from gaitcal.results.summary import SUMMARY, VECTOR_FOLDER, entries_of, read_vectors, table_of
from gaitcal.results.table_files import VERDICT, Json, json_text, read_csv, write_csv
from gaitcal.results.trial_tables import told_components

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
"""How the comment lines begin that tell of angles from the static posture."""


@dataclass(frozen=True)
class _Result:
    """What is read of a result."""

    model: SubjectModel
    table: pd.DataFrame  # `cycles.csv`, as text
    comments: tuple[str, ...]
    strides: Mapping[tuple[str, str], tuple[GaitCycle, ...]]  # Trial and side -> strides
    vectors: Mapping[str, pd.DataFrame]  # Trial -> table of moment vectors


def strides_in_convention(
    strides: pd.DataFrame, convention: Convention, model: SubjectModel
) -> pd.DataFrame:
    """Strides, as `read_cycles` gives them, in another convention about the axes of coordinates."""
    return in_convention(_Result(model, strides, (), {}, {}), convention)


def write_cycles_export(
    folder: Path, convention: Convention, target: Path, model: SubjectModel
) -> tuple[int, Snapshot]:
    """Write the strides of the result in `folder` to `target`; returns how many rows, and what was
    read.

    `model`: of the result, or of that which further trials in `folder` (`gaitcal dynamics`) were
    made with.

    Raises InputError: The result is damaged, or has no strides.
    """
    found, snapshot = _read_whole(folder, convention.frame, model)
    table = in_convention(found, convention)
    write_csv(table, target, (*found.comments, *HEADER, *convention.lines))
    return len(table), snapshot


def _read_whole(folder: Path, frame: MomentFrame, model: SubjectModel) -> tuple[_Result, Snapshot]:
    names = [CYCLES, SUMMARY]
    if frame is not MomentFrame.COORDINATES:
        names += sorted(
            path.relative_to(folder).as_posix() for path in (folder / VECTOR_FOLDER).glob("*.csv")
        )
    if not (folder / CYCLES).exists():
        raise InputError(f"has no {CYCLES}; calibrate again", source=folder, code=Code.NO_RESULT)
    return read_whole(folder, names, lambda: _read(folder, frame, model))


def made_with_another_model(folder: Path, digest: str | None) -> tuple[str, ...]:
    """Further trials in `folder` that were made with another model than that of this SHA-256."""
    made = table_of(result_folder.read_json_object(folder / result_folder.MANIFEST), "model_sha256")
    return tuple(trial for trial, of in made.items() if of != digest)


def _read(folder: Path, frame: MomentFrame, model: SubjectModel) -> _Result:
    table, comments = read_csv(folder / CYCLES)
    trials = table_of(result_folder.read_json_object(folder / SUMMARY), "trials")
    strides: dict[tuple[str, str], tuple[GaitCycle, ...]] = {}
    vectors = {}
    for name in dict.fromkeys(table["trial"]):
        events = saved_result.saved_events(table_of(trials, name))
        right, left = (
            FootEvents(
                np.array(labels.select_event_times(events, side, labels.FootMoment.STRIKE)),
                np.array(labels.select_event_times(events, side, labels.FootMoment.OFF)),
            )
            for side in SIDES
        )
        strides |= {(name, "r"): gait_cycles(right, left), (name, "l"): gait_cycles(left, right)}
        repeats = tuple(
            GaitCycle(c["start"], c["stop"], None)
            for c in entries_of(table_of(trials, name), "repetitions")
        )
        strides |= {(name, side): repeats for side in SIDES if repeats}
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
    # the head of cycles.csv says how trials stand, and OpenSim's convention, which is no longer
    # true
    kept_starts = (*(f"{name}: {VERDICT}" for name, _ in strides), *RELATIVE)
    kept = tuple(line for line in comments if line.startswith(kept_starts))
    return _Result(model, table, kept, strides, vectors)


def in_convention(found: _Result, convention: Convention) -> pd.DataFrame:
    """The rows of `cycles.csv` in another convention, with `unit` and `positive` at the end."""
    numbers = [name for name in NUMBERS if name in found.table]
    table = found.table.assign(**{name: pd.to_numeric(found.table[name]) for name in numbers})
    if convention.frame is not MomentFrame.COORDINATES:
        kept = table[~table["variable"].str.endswith(MOMENT)]
        table = pd.concat([kept, *_vector_rows(found, convention.frame)], ignore_index=True)
    subject, parts = found.model.subject, []
    for (variable, side), rows in table.groupby(["variable", "side"], sort=False):
        parts.append(_converted(rows, str(variable), str(side), convention, subject, numbers))
    whole = pd.concat(parts).sort_index() if parts else table.assign(unit="", positive="")
    whole[numbers] = whole[numbers].round(DIGITS)
    return whole


def _converted(
    rows: pd.DataFrame,
    variable: str,
    side: str,
    convention: Convention,
    subject: Subject,
    numbers: list[str],
) -> pd.DataFrame:
    """Rows of one variable of strides of one side."""
    changed = {
        name: convention.values(variable, rows[name].to_numpy(dtype=np.float64), side, subject)
        for name in numbers
    }
    changed |= {name: np.abs(values) for name, values in changed.items() if name != "value"}
    kind = kind_of(variable)
    units = {CurveKind.MOMENT: convention.unit.words, CurveKind.POWER: convention.unit.power}
    whose = f"{convention.acting.key}, " if kind is CurveKind.MOMENT else ""
    positive = f"{whose}{convention.senses(variable, side)[0]}"
    return rows.assign(**changed, unit=units.get(kind, kind.unit), positive=positive)


def _vector_rows(found: _Result, frame: MomentFrame) -> list[pd.DataFrame]:
    """Rows of the moments in a frame of segments or of the joint coordinate system, stride by
    stride.
    """
    parts = []
    for (trial, side), cycles in found.strides.items():
        table = found.vectors.get(trial)
        of_trial = found.table[(found.table["trial"] == trial) & (found.table["side"] == side)]
        if table is None or of_trial.empty:
            continue
        if len(cycles) != of_trial["stride"].nunique():
            message = f"{CYCLES} and {SUMMARY} differ in the strides of '{trial}'; calibrate again"
            raise InputError(message, code=Code.DAMAGED_RESULT)
        time, unknown = table["time"].to_numpy(dtype=np.float64), np.full(len(table), np.nan)
        names = [name for name in told_components(found.model.frozen) if leg_of(name) in (side, "")]
        for stride, cycle in enumerate(cycles, start=1):
            told_of_stride = of_trial[of_trial["stride"] == str(stride)].iloc[:POINTS]
            for name in names:
                leg = leg_of(name)
                column, counts = vector_column(name, frame), f"valid_{leg}" if leg else "valid"
                usable = np.where(table[counts].to_numpy() == 1, 1.0, np.nan)
                signals = (
                    table.get(f"{column}{ending}", unknown) for ending in ("", "_se", "_se_stride")
                )
                value, error, differing, valid = (
                    normalise(time, np.asarray(values, dtype=np.float64), cycle)
                    for values in (*signals, usable)
                )
                parts.append(
                    told_of_stride.assign(
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
    """Put a manifest into `stage` that lists its files and those of earlier exports that still lie
    in `folder`.

    Parameters
    ----------
    stage
        Holds the files that will join `folder`.
    folder
        May hold an earlier export, and a manifest of it; a manifest of another kind of result is
        left alone.
    read
        File of the result that these were made of -> SHA-256.
    subject
        The person's name.
    written
        File -> what is to be said of it: format, source, notes.

    Raises InputError: The earlier manifest is damaged.
    """
    earlier = result_folder.read_json_object(folder / result_folder.MANIFEST)
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
    hashes |= {
        name: result_folder.compute_sha256(stage / name) or ""
        for name in result_folder.list_files(stage)
    }
    about = {
        **cast(dict[str, Json], earlier.get("written", {})),
        **{name: dict(words) for name, words in written.items()},
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
    (stage / result_folder.MANIFEST).write_text(json_text(manifest), encoding="utf-8")


STUDY = "study.toml"


def trial_files(folder: Path) -> dict[str, dict[str, str]]:
    """Trial -> `file` and, where there is one, `forces`, as the manifest of a result names them.

    Raises InputError: It is no result.
    """
    trials = result_folder.read_json_object(folder / result_folder.MANIFEST).get("trials")
    if not isinstance(trials, dict):
        message = "found no list of its trials' files; calibrate again"
        raise InputError(
            message, source=folder / result_folder.MANIFEST, field="trials", code=Code.CHANGED_FILE
        )
    return {str(t): {str(k): str(v) for k, v in files.items()} for t, files in trials.items()}


def find_original(folder: Path, name: str, inputs: Path | None) -> Path:
    """The input `name` (as the manifest of the result in `folder` has it), unchanged since it was
    read.

    `inputs`: where the user says that recordings lie; it and its subfolders are looked through.
    Else they are looked for beside the result, in it, in the working folder, where its `study.toml`
    says, and in the folders there.

    Raises InputError: There is none, or it has changed.
    """
    hashes = result_folder.read_json_object(folder / result_folder.MANIFEST).get("inputs_sha256")
    wanted = hashes.get(name) if isinstance(hashes, Mapping) else None
    changed: Path | None = None
    for path, is_its_place in _places(folder, name, inputs):
        if not path.is_file():
            continue
        if wanted is not None and result_folder.compute_sha256(path) == wanted:
            return path
        changed = changed or (path if is_its_place else None)
    if changed is not None:
        message = "is not the file that the result was made from (another SHA-256); calibrate again"
        raise InputError(message, source=changed, code=Code.CHANGED_FILE)
    where = inputs or folder.resolve().parent
    cure = "" if inputs else "; say with --inputs FOLDER where the recordings lie"
    raise InputError(
        f"found no '{name}', which the result was made from{cure}",
        source=where,
        code=Code.CHANGED_FILE,
    )


def _places(folder: Path, name: str, inputs: Path | None) -> Iterator[tuple[Path, bool]]:
    """Where it may lie, and whether a file of that name there must be it: elsewhere others may
    share the name.
    """
    roots = [inputs] if inputs else [folder.resolve().parent, folder, Path.cwd()]
    last = PurePosixPath(name).name
    for root in roots:
        yield root / name, True
        yield root / last, True
    for path in () if inputs else _of_study(folder):
        if path.name == last:
            yield path, False
    for root in roots:
        for path in sorted(root.rglob(last) if inputs else root.glob(f"*/{last}")):
            yield path, False


def _of_study(folder: Path) -> Iterator[Path]:
    """Files of the trials of the study that was drafted into a result; none where it says nothing."""
    try:
        content = toml.read_toml(folder / STUDY)
    except InputError:
        return
    for trial in entries_of(content, "trial"):
        named = (trial.get(key) for key in ("file", "forces"))
        yield from (folder / name for name in named if isinstance(name, str))
