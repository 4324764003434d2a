"""`gaitcal compare A B --shared-model`: joint parameters from both sessions, and every walk anew with them.

Each session keeps its static trial, with its own places of markers and segment frames, its own masses, trunk and arms.
On one static trial the joints of the legs are fitted to all trials together; with a static trial each they are those of
`compare/shared_model.py`. Walks are tracked and their torques computed as `gaitcal dynamics` does.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

from gaitcal.calibration.error_sources import ErrorSources
from gaitcal.compare.sessions import SessionComparison, compare_sessions
from gaitcal.compare.shared_model import SharedJoints, require_fit_to_share, shared_joints
from gaitcal.compare.stride_sets import Common, NotComparableError, Session, common_to
from gaitcal.errors import ConvergenceError
from gaitcal.gait.cycles import typed
from gaitcal.io.result_folder import MANIFEST, read_object
from gaitcal.model.linkage import LEG_JOINTS
from gaitcal.model.parameters import JOINT_PARAMETERS, JP_INDEX, Parameters
from gaitcal.model.subject_model import SubjectModel
from gaitcal.results.cycles import cycle_table
from gaitcal.results.cycles_export import STUDY
from gaitcal.results.saved import UNCERTAINTY, load_uncertainty
from gaitcal.results.sessions import load_session, named_apart
from gaitcal.results.stride_files import spatiotemporal_table
from gaitcal.results.summary import table_of
from gaitcal.runtime import Progress, silent, with_one_blas_thread
from gaitcal.session.joint_parameters import fit_joints
from gaitcal.session.result import Uncertainty
from gaitcal.session.session import session_of
from gaitcal.session.trial_result import analyse, counted_from_static
from gaitcal.study.study import Study, completed_static, nominal_of
from gaitcal.study.study_trial import Role

DIGITS = 6


@with_one_blas_thread
def compare_with_shared_model(
    a: Path | str, b: Path | str, studies: Sequence[Path | str] = (), progress: Progress = silent
) -> tuple[SessionComparison, pd.DataFrame]:
    """Fit one set of joints to two result folders of one person, and compare their walks with it.

    Returns the comparison, and `shared_parameters.csv`: of each session, alone and shared, with standard errors.

    Parameters
    ----------
    studies : the study file of A, then of B; those that lie in the results unless given.

    Raises
    ------
    InputError
        A result is refused, its joints were not calibrated by the evidence of all trials, or its study is not found
        or is another one.
    ConvergenceError
        The fit to all trials ended early.
    """
    folders = Path(a), Path(b)
    one, other = named_apart(*(load_session(folder)[0] for folder in folders))
    common = common_to(one, other)
    if common is Common.MODEL:
        raise NotComparableError("both results have one model already", source=f"{one.name}, {other.name}")
    plain = compare_sessions(one, other)
    require_fit_to_share(one, other)
    shared = None if common is Common.STATIC else shared_joints(one, other, common)
    files = tuple(map(Path, studies)) or tuple(folder / STUDY for folder in folders)
    if len(files) != len(folders):
        raise NotComparableError(f"found {len(files)} study files; allowed: that of A, then that of B", field="--study")
    progress("reading the recordings")
    read = [study_of_result(folder, file) for folder, file in zip(folders, files, strict=True)]
    if shared is None:
        progress("joint parameters from all trials")
        shared = fitted_together(*read)
    anew = []
    for k, (session, folder, study) in enumerate(zip((one, other), folders, read, strict=True)):
        progress(f"walks of {session.name} with the shared joints")
        spread = load_uncertainty(folder / UNCERTAINTY).inertial
        uncertainty = Uncertainty(_with_others(session.influence, shared.influences[k]), spread)
        anew.append(retracked(session, study, shared.names, (shared.a, shared.b)[k], uncertainty))
    now = Common.SHARED_FRAMES if common is Common.STATIC else Common.SHARED_JOINTS
    found = compare_sessions(anew[0], anew[1], common=now)
    words = _words(one, other, shared, plain, found)
    return replace(found, warnings=plain.warnings, notes=words), _table(one, other, shared)


def fitted_together(a: Study, b: Study) -> SharedJoints:
    """One fit of the legs' joints to the trials of two studies on one static trial.

    Raises
    ------
    InputError
        The settings leave joint parameters alone.
    ConvergenceError
        The fit ended early.
    """
    read = {t.name: t for t in a.trials}
    files = {a.inputs[a.input_names(t)["file"]] for t in a.trials}
    new = [t for t in b.moving if b.inputs[b.input_names(t)["file"]] not in files]
    named = [replace(t, name=f"{t.name}, second" if t.name in read else t.name) for t in new]
    whole = replace(a, trials=(*a.trials, *named))
    joint = fit_joints(session_of(whole, nominal_of(whole))).joint
    if joint is None:
        raise NotComparableError("its settings leave joint parameters alone (jp = false)", source=a.source)
    if late := [phase for phase in joint.phases if not phase.converged]:
        raise ConvergenceError(f"phase {late[0].name} of both sessions together did not converge: {late[0].message}")
    names = tuple(name for name in joint.free if name.startswith(LEG_JOINTS))
    values = joint.parameters.joint[[JP_INDEX[name] for name in names]]
    errors = joint.errors.of(names)
    return SharedJoints(names=names, a=values, b=values, influences=(errors, errors))


def study_of_result(folder: Path, file: Path) -> Study:
    """The study that a result was made from, with the trials that it used.

    Raises
    ------
    InputError
        It is not there, or its recordings are others.
    """
    if not file.is_file():
        raise NotComparableError(f"not found; say with --study FILE which study {folder} was made from", source=file)
    study, manifest = Study.load(file), read_object(folder / MANIFEST)
    known, names = set(table_of(manifest, "inputs_sha256").values()), set(table_of(manifest, "trials"))
    chosen = replace(study, trials=tuple(t for t in study.trials if t.name in names))
    read = {digest for name, digest in study.inputs.items() if not name.endswith(".toml")}
    if {t.name for t in chosen.trials} != names or not read & known:
        raise NotComparableError(f"is not the study that {folder} was made from: other recordings", source=file)
    return chosen


def retracked(
    session: Session, study: Study, names: Sequence[str], values: np.ndarray, uncertainty: Uncertainty
) -> Session:
    """The session with other joint parameters `names`: every walk tracked anew."""
    model, settings = session.model, study.settings
    joints = model.parameters.with_joint(tuple(names), values)
    if settings.keeps_ankle_zero:
        begun = Parameters(joints.joint, joints.inertial, model.nominal.zero_angles)
        static = completed_static(study).static
        joints = counted_from_static(model.with_parameters(model.nominal), begun, static).parameters
    fitted: SubjectModel = model.with_parameters(joints)
    walks = [t for t in study.trials if t.role is Role.GAIT]
    results = [analyse(fitted, trial, settings, uncertainty) for trial in walks]
    strides = cycle_table(fitted, results)
    measures = spatiotemporal_table(fitted.subject, results)
    return replace(
        session,
        model=fitted,
        strides=typed(strides) if len(strides) else strides,
        measures=measures,
        influence=uncertainty.joint,
    )


def _with_others(known: ErrorSources | None, errors: ErrorSources) -> ErrorSources:
    """Errors of the shared parameters, beside those of trunk and arms as they were."""
    return errors if known is None else known.of([name for name in known.free if name in JP_INDEX]).updated(errors)


def _table(a: Session, b: Session, shared: SharedJoints) -> pd.DataFrame:
    rows = []
    for k, name in enumerate(shared.names):
        p = JOINT_PARAMETERS[JP_INDEX[name]]
        row: dict[str, object] = {"name": name, "unit": p.kind.unit}
        for letter, session, values, errors in zip("ab", (a, b), (shared.a, shared.b), shared.errors, strict=True):
            alone = session.influence.standard_errors[name] if session.influence else np.nan
            own = session.model.parameters.joint[JP_INDEX[name]]
            numbers = {"alone": own, "alone_se": alone, "shared": values[k], "shared_se": errors[k]}
            row |= {f"{letter}_{key}": round(float(value / p.kind.to_si), DIGITS) for key, value in numbers.items()}
        rows.append(row)
    return pd.DataFrame(rows)


def _words(
    a: Session, b: Session, shared: SharedJoints, plain: SessionComparison, found: SessionComparison
) -> tuple[str, ...]:
    """How much better the joints are known, and what that makes of the differences."""
    ratios = [
        error / session.influence.standard_errors[name]
        for session, errors in zip((a, b), shared.errors, strict=True)
        if session.influence is not None
        for name, error in zip(shared.names, errors, strict=True)
    ]
    limits = [
        {(d.side, d.name, d.measure): d.mdc95 for d in c.found if d.kind in ("angle", "moment") and d.spread_known}
        for c in (plain, found)
    ]
    both = [(limits[1][key], limits[0][key]) for key in limits[0] if key in limits[1] and limits[0][key] > 0.0]
    told = [
        f"joint parameters from both sessions together: error bars {100.0 * (1.0 - float(np.median(ratios))):.0f} % "
        f"smaller than of each session alone (median of {len(ratios)})"
    ]
    if both:
        less = 100.0 * (1.0 - float(np.median([new / old for new, old in both])))
        told.append(f"what angles and moments could miss is {less:.0f} % smaller with it (median of {len(both)})")
    return tuple(told)
