"""Where the marker on the knee turns about, against the shank's own markers: which hinge a
calibration can find.

On a hinge at its own height the marker on the epicondyle would stay where it is in the shank. It
moves with the angle theta of the knee in the sagittal plane of the shank as a point of the thigh
that turns about a centre c,

    p(theta) = c + R(-theta) d,

with c and d by linear least squares. Only the rigid fit of three or more shank markers and the
nominal knee angle enter, no soft tissue and no prior. c is told from the nominal knee centre, which
lies at the height of the marker.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from gaitcal.analysis.prepared_trials import MovingTrial, prepare_calibration
from gaitcal.arrays import Array
from gaitcal.model.linkage import SIDES
from gaitcal.model.parameters import JP_INDEX
from gaitcal.model.subject_model import SubjectModel
from gaitcal.preprocess.preprocessed_study import preprocess_study
from gaitcal.study.study_trial import Role
from gaitcal.tracking.motion import track_motion
from gaitcal.tracking.rigid import FEWEST_MARKERS, fit_rigid
from scripts.validation.people.fits import Fit, fitted
from scripts.validation.recordings import changed, study_of_person

AT_LANDMARK_MM = 2.0
"""A marker that lies so near a landmark stands for it."""


@dataclass(frozen=True, kw_only=True)
class Knee:
    """The path of a knee's marker in the shank, over the walks of one person."""

    name: str
    side: str
    bent_deg: float
    """Between the tenth of the frames that is bent most and the fifth that is bent least."""
    moved: Array
    """(2,) mm forward and up, meanwhile."""
    centre: Array
    """(2,) mm forward and up of the nominal knee centre."""
    misfit_mm: float
    """RMS distance of the path from that circle."""
    fitted_mm: float
    """How far calibration moves the axis up in the thigh."""
    error_mm: float
    """Its standard error."""


def circle(flexion: Array, path: Array) -> tuple[Array, float]:
    """Centre (2,) and RMS distance of a path (nf, 2), forward and up in the shank, of a thigh bent
    by (nf,) rad.
    """
    cos, sin, one, none = (
        np.cos(flexion),
        np.sin(flexion),
        np.ones(len(flexion)),
        np.zeros(len(flexion)),
    )
    forward, up = np.stack([one, none, cos, -sin], axis=1), np.stack([none, one, sin, cos], axis=1)
    rows = np.concatenate([forward, up])
    found, *_ = np.linalg.lstsq(rows, path.T.ravel(), rcond=None)
    off = rows @ found - path.T.ravel()
    return found[:2], float(np.sqrt(2.0 * np.mean(off**2)))


def path_of(trial: MovingTrial, model: SubjectModel, side: str) -> tuple[Array, Array]:
    """(nf,) rad and (nf, 2) mm of the frames that show it; empty where nobody wears such
    markers.
    """
    place, labels = model.markers, trial.recording.labels
    segment, landmark = model.landmarks[f"knee_lat_{side}"]
    near = np.linalg.norm(place.local - landmark, axis=1) < 1e-3 * AT_LANDMARK_MM
    knee = [
        k
        for k, s in enumerate(place.segments)
        if s == segment and near[k] and place.labels[k] in labels
    ]
    shank = [
        k
        for k, s in enumerate(place.segments)
        if s == f"shank_{side}" and place.labels[k] in labels
    ]
    if not knee or len(shank) < FEWEST_MARKERS:
        return np.empty(0), np.empty((0, 2))
    motion = track_motion(trial.whole_body_problem, model.parameters)
    seen = trial.recording.markers[:, [labels.index(place.labels[k]) for k in (*shank, knee[0])]]
    known = np.isfinite(seen).all(axis=(1, 2))
    cluster = seen[known, :-1].transpose(1, 2, 0)
    fit = fit_rigid(place.local[shank], cluster, np.ones((len(shank), cluster.shape[2])))
    path = 1e3 * np.einsum("fji,fj->fi", fit.rotation, seen[known, -1] - fit.origin)[:, :2]
    return motion.q[known, motion.coordinates.index(f"knee_angle_{side}")], path


def knees_of(name: str, settings: Mapping[str, object]) -> Iterator[Knee]:
    """Both knees of a person; none without a marker on the epicondyle that moves with three markers
    of the shank.
    """
    study = changed(study_of_person(name), settings)
    session = prepare_calibration(preprocess_study(study))
    nominal, walks = session.model, [trial for trial in session.trials if trial.role is Role.GAIT]
    fit: Fit | None = None
    for side in SIDES:
        found = [path_of(walk, nominal, side) for walk in walks]
        flexion, path = (
            (np.concatenate(parts) for parts in zip(*found, strict=True))
            if found
            else (np.empty(0),) * 2
        )
        if not len(flexion):
            continue
        least, most = np.percentile(flexion, (20, 90))
        bent, straight = flexion > most, flexion < least
        centre, misfit = circle(flexion, path)
        fit = fit or fitted(name, study)
        at = JP_INDEX[f"knee_{side}.thigh.sup"]
        yield Knee(
            name=name,
            side=side,
            bent_deg=float(np.degrees(flexion[bent].mean() - flexion[straight].mean())),
            moved=path[bent].mean(axis=0) - path[straight].mean(axis=0),
            centre=centre,
            misfit_mm=misfit,
            fitted_mm=1e3 * float(fit.parameters.joint[at] - nominal.parameters.joint[at]),
            error_mm=1e3 * float(fit.errors[at]),
        )


def lines(found: Sequence[Knee]) -> Iterator[str]:
    heads = f"{'bent':>6}{'forward, up':>14}{'turns about':>14}{'RMS':>6}{'fitted (SE)':>16}"
    yield f"{'knee marker in the shank':26}{heads}"
    for k in found:
        moved, centre = ("".join(f"{x:7.1f}" for x in pair) for pair in (k.moved, k.centre))
        told = f"{k.fitted_mm:9.1f} ({k.error_mm:4.1f})"
        yield (
            f"{k.name + ', ' + k.side:26}{k.bent_deg:6.0f}"
            f"{moved}{centre}{k.misfit_mm:6.1f}{told:>16}"
        )
