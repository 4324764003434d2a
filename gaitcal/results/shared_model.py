"""`gaitcal compare A B --shared-model`: joint parameters from both sessions, and every walk anew with them.

Each session keeps its static trial, with its own places of markers and segment frames, its own masses, trunk and arms.
On one static trial the joints of the legs are fitted to all trials together; with a static trial each they are
`joined`. Walks are tracked and their torques computed as `gaitcal dynamics` does.

Markers that are put on anew make other segment frames, so that the same joints have other parameters, theta_A and
theta_B. Each session's calibration (`calibration/joint_estimate.py`) says of its deviations d = theta - p0 from its
nominal joints: the estimate d^ with covariance C, in which the prior N(m0, P0) counts already. What its markers say
alone is S = C^-1 - P0^-1 (nothing negative), and S m = C^-1 d^ - P0^-1 m0, m being where the markers alone would have
it. Deviations x = d - m0 of a person in two sessions go together, but for where markers were put (Q, or P0 = F F^T
without what is the person's own, `parameter_differences.own_causes`):

    cov [x_A, x_B] = Pi = [P0, P0 - Q; P0 - Q, P0],    P0 - Q = F R R^T F^T (1 - 1e-9)    (R = 1 on one static trial),

    [x_A, x_B] = L^-1 [C_A^-1 x^_A, C_B^-1 x^_B],    L = diag(S_A, S_B) + Pi^-1,    covariance L^-1.

To first order that is one calibration of all trials with a static trial for each session: the trials' information meets
in full, and no trial is fitted again. It is about each session's own fit that the trials are taken as linear.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.linalg import block_diag

from gaitcal.arrays import Array
from gaitcal.calibration.error_sources import ErrorSources
from gaitcal.calibration.joint_prior import prior_of, prior_root
from gaitcal.compare.difference import own_causes, told_parameters
from gaitcal.compare.sessions import SessionComparison, compare_sessions
from gaitcal.compare.stride_sets import Common, NotComparableError, Session, common_to
from gaitcal.errors import ConvergenceError
from gaitcal.faults.study import examined
from gaitcal.gait.cycles import typed
from gaitcal.io.result_folder import MANIFEST, read_object
from gaitcal.model import anthropometry, linkage
from gaitcal.model.parameters import JOINT_PARAMETERS, JP_INDEX, JP_NAMES, Parameters
from gaitcal.model.subject_model import SubjectModel
from gaitcal.results import cycles, cycles_export, saved, sessions, stride_files, summary
from gaitcal.runtime import Progress, silent, with_one_blas_thread
from gaitcal.session import joint_parameters, result, trial_result
from gaitcal.session.session import session_of
from gaitcal.study.joint_prior import JointPrior
from gaitcal.study.study import Study

SAME = 1e-9  # What is the same in both sessions is it but for rounding
RANK = 1e-6  # Part of the largest standard error, in units of the prior, below which a direction would be known exactly


@dataclass(frozen=True, kw_only=True)
class JointKnowledge:
    """What one session knows of n joint parameters."""

    nominal: Array  # (n,) m, rad: p0
    fitted: Array  # (n,) m, rad
    covariance: Array  # (n, n) C


@dataclass(frozen=True, kw_only=True)
class SharedJoints:
    """Joint parameters of both sessions, from both."""

    names: tuple[str, ...]
    a: Array  # (n,) m, rad, in the frames of A
    b: Array  # (n,) the same in those of B
    influences: tuple[ErrorSources, ErrorSources]  # Their errors by source, of A and of B

    @property
    def errors(self) -> tuple[Array, Array]:
        """(n,) m, rad each: standard errors of A's and of B's."""
        one, other = (np.sqrt((i.parameters**2).sum(axis=1)) for i in self.influences)
        return one, other


def require_fit_to_share(a: Session, b: Session) -> None:
    """InputError where a session is refused, or its joint parameters were not calibrated by itself."""
    for session in (a, b):
        if session.verdict == "refused":
            raise NotComparableError("is refused: it has no say in a shared model", source=session.name)
        if session.leans_on_cohort:
            message = "leans on priors of a cohort: calibrate it without to share a model"
            raise NotComparableError(message, source=session.name)
        if session.influence is None:
            message = "its joint parameters were not calibrated, which a shared model needs"
            raise NotComparableError(message, source=session.name)
    (mean, spread), (other, wide) = (prior_of(JP_NAMES, session.prior) for session in (a, b))
    if (mean != other).any() or (spread != wide).any():
        message = "their studies expect other joints ([calibration] joint_prior); calibrate both with one of them"
        raise NotComparableError(message, source=f"{a.name}, {b.name}")


def shared_joints(a: Session, b: Session, common: Common) -> SharedJoints:
    """The legs' joint parameters that both sessions told something of.

    Raises InputError: A session is refused, its joint parameters were not calibrated, lean on a cohort, or had another
    prior.
    """
    require_fit_to_share(a, b)
    known = set(told_parameters(b.influence))
    names = tuple(n for n in told_parameters(a.influence) if n in known and n.startswith(linkage.LEG_JOINTS))
    if not names:
        raise NotComparableError("no joint parameter was fitted in both", source=f"{a.name}, {b.name}")
    return joined(names, knowledge(a, names), knowledge(b, names), common is Common.PERSON, a.prior)


def knowledge(session: Session, names: tuple[str, ...]) -> JointKnowledge:
    """What the result of a session says of `names`."""
    index = [JP_INDEX[name] for name in names]
    model, influence = session.model, session.influence
    if influence is None:
        raise NotComparableError("its joint parameters were not calibrated", source=session.name)
    rows = influence.parameters[[influence.free.index(name) for name in names]]
    sizes = np.linalg.svd(np.linalg.solve(prior_root(names, session.prior), rows), compute_uv=False)
    if rows.shape[1] < len(rows) or sizes[-1] <= RANK * sizes[0]:
        message = (
            "its joint errors are not those of the evidence of all trials (protocol = 'evidence'); calibrate again"
        )
        raise NotComparableError(message, source=session.name)
    return JointKnowledge(
        nominal=model.nominal.joint[index], fitted=model.parameters.joint[index], covariance=rows @ rows.T
    )


def joined(
    names: tuple[str, ...], a: JointKnowledge, b: JointKnowledge, placed_anew: bool, prior: JointPrior | None = None
) -> SharedJoints:
    """Both sessions' knowledge together.

    `placed_anew`: each has a static trial of its own.
    `prior`: of both calibrations; anatomy's unless given.
    """
    count = len(names)
    mean, spread = prior_of(names, prior)
    root = prior_root(names, prior)
    own = root @ own_causes(names, prior) if placed_anew else root
    together = (1.0 - SAME) * (own @ own.T)
    precision = np.linalg.inv(np.block([[spread, together], [together, spread]]))
    roots = [_seen(root, k.covariance) for k in (a, b)]
    right = np.concatenate([np.linalg.solve(k.covariance, k.fitted - k.nominal - mean) for k in (a, b)])
    covariance = np.linalg.inv(block_diag(*(r @ r.T for r in roots)) + precision)
    moved = covariance @ right + np.tile(mean, 2)
    by_markers = covariance @ block_diag(*roots)
    by_nominal = covariance @ np.linalg.cholesky(precision)
    clusters = (
        *(f"markers/{session}/{k}" for session in ("A", "B") for k in range(count)),
        *(f"nominal/{name}" for name in names),
    )

    def errors_of(rows: slice) -> ErrorSources:
        compressed = np.asarray(np.linalg.qr(by_nominal[rows].T, mode="r")).T
        return ErrorSources(names, np.hstack([by_markers[rows], compressed]), clusters)

    halves = slice(0, count), slice(count, 2 * count)
    return SharedJoints(
        names=names,
        a=a.nominal + moved[halves[0]],
        b=b.nominal + moved[halves[1]],
        influences=(errors_of(halves[0]), errors_of(halves[1])),
    )


def _seen(root: Array, covariance: Array) -> Array:
    """(n, n) R with R R^T = C^-1 - (F F^T)^-1, nothing of it negative in units of the prior's root F."""
    values, vectors = np.linalg.eigh(root.T @ np.linalg.solve(covariance, root))
    out: Array = np.linalg.solve(root.T, vectors * np.sqrt(np.maximum(values - 1.0, 0.0)))
    return out


DIGITS = 6


@with_one_blas_thread
def compare_with_shared_model(
    a: Path | str, b: Path | str, studies: Sequence[Path | str] = (), progress: Progress = silent
) -> tuple[SessionComparison, pd.DataFrame]:
    """Fit one set of joints to two result folders of one person, and compare their walks with it.

    Returns the comparison, and `shared_parameters.csv`: of each session, alone and shared, with standard errors.

    `studies`: the study file of A, then of B; those that lie in the results unless given.

    Raises InputError: A result is refused, its joints were not calibrated by the evidence of all trials, or its study
    is not found or is another one.
    Raises ConvergenceError: The fit to all trials ended early.
    """
    folders = Path(a), Path(b)
    one, other = sessions.named_apart(*(sessions.load_session(folder)[0] for folder in folders))
    common = common_to(one, other)
    if common is Common.MODEL:
        raise NotComparableError("both results have one model already", source=f"{one.name}, {other.name}")
    plain = compare_sessions(one, other)
    require_fit_to_share(one, other)
    shared = None if common is Common.STATIC else shared_joints(one, other, common)
    files = tuple(map(Path, studies)) or tuple(folder / cycles_export.STUDY for folder in folders)
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
        spread, errors = saved.load_uncertainty(folder / saved.UNCERTAINTY).inertial, shared.influences[k]
        if (known := session.influence) is not None:  # of trunk and arms, errors stay as they were
            errors = known.of([name for name in known.free if name in JP_INDEX]).updated(errors)
        uncertainty = result.Uncertainty(errors, spread)
        anew.append(retracked(session, study, shared.names, (shared.a, shared.b)[k], uncertainty))
    now = Common.SHARED_FRAMES if common is Common.STATIC else Common.SHARED_JOINTS
    found = compare_sessions(anew[0], anew[1], common=now)
    words = _words(one, other, shared, plain, found)
    return replace(found, warnings=plain.warnings, notes=words), _table(one, other, shared)


def fitted_together(a: Study, b: Study) -> SharedJoints:
    """One fit of the legs' joints to the trials of two studies on one static trial.

    Raises InputError: The settings leave joint parameters alone.
    Raises ConvergenceError: The fit ended early.
    """
    read = {t.name: t for t in a.trials}
    files = {a.inputs[a.input_names(t)["file"]] for t in a.trials}
    new = [t for t in b.moving if b.inputs[b.input_names(t)["file"]] not in files]
    named = [replace(t, name=f"{t.name}, second" if t.name in read else t.name) for t in new]
    whole = replace(a, trials=(*a.trials, *named))
    joint = joint_parameters.fit_joints(session_of(examined(whole))).joint
    if joint is None:
        raise NotComparableError("its settings leave joint parameters alone (jp = false)", source=a.source)
    if late := [phase for phase in joint.phases if not phase.converged]:
        raise ConvergenceError(f"phase {late[0].name} of both sessions together did not converge: {late[0].message}")
    names = tuple(name for name in joint.free if name.startswith(linkage.LEG_JOINTS))
    values = joint.parameters.joint[[JP_INDEX[name] for name in names]]
    errors = joint.errors.of(names)
    return SharedJoints(names=names, a=values, b=values, influences=(errors, errors))


def study_of_result(folder: Path, file: Path) -> Study:
    """The study that a result was made from, with the trials that it used.

    Raises InputError: It is not there, or its recordings are others.
    """
    if not file.is_file():
        raise NotComparableError(f"not found; say with --study FILE which study {folder} was made from", source=file)
    study, manifest = Study.load(file), read_object(folder / MANIFEST)
    known, names = set(summary.table_of(manifest, "inputs_sha256").values()), set(summary.table_of(manifest, "trials"))
    chosen = replace(study, trials=tuple(t for t in study.trials if t.name in names))
    read = {digest for name, digest in study.inputs.items() if not name.endswith(".toml")}
    if {t.name for t in chosen.trials} != names or not read & known:
        raise NotComparableError(f"is not the study that {folder} was made from: other recordings", source=file)
    return chosen


def retracked(
    session: Session, study: Study, names: Sequence[str], values: np.ndarray, uncertainty: result.Uncertainty
) -> Session:
    """The session with other joint parameters `names`: every walk tracked anew."""
    model, settings, clean = session.model, study.settings, examined(study)
    joints = model.parameters.with_joint(tuple(names), values)
    if settings.ip != "published":  # else mass centres would stay apart by what the joints of both sessions were
        joints = joints.with_inertial(anthropometry.with_joints_of(joints.inertial, model.parameters, joints))
    if settings.keeps_ankle_zero:
        begun = Parameters(joints.joint, joints.inertial, model.nominal.zero_angles)
        joints = trial_result.counted_from_static(
            model.with_parameters(model.nominal), begun, clean.completed.static
        ).parameters
    fitted: SubjectModel = model.with_parameters(joints)
    walks, moves = [t.trial for t in clean.trials if t.is_gait], clean.moves()
    results = [trial_result.analyse(fitted, trial, settings, uncertainty, moves.get(trial.name, {})) for trial in walks]
    strides = cycles.cycle_table(fitted, results)
    measures = stride_files.spatiotemporal_table(fitted.subject, results)
    return replace(
        session,
        model=fitted,
        strides=typed(strides) if len(strides) else strides,
        measures=measures,
        influence=uncertainty.joint,
    )


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
