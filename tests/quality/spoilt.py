"""A sound synthetic study in memory, and ways to spoil one trial of it."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gaitcal.errors import Code, Finding, Severity
from gaitcal.intake.draft_file import build_study
from gaitcal.intake.drafting import draft_folder
from gaitcal.intake.recordings_folder import read_folder
from gaitcal.intake.subject_metadata import Options
from gaitcal.io.recording import ForcePlate, Recording
from gaitcal.model.marker_set import load_marker_set
from gaitcal.model.subject_model import Subject, SubjectModel
from gaitcal.preprocess.clean_trial import clean_trial
from gaitcal.preprocess.trial_evidence import TrialEvidence
from gaitcal.quality.study_checks import check_study
from gaitcal.study.settings import CalibrationSettings
from gaitcal.study.study import Study
from gaitcal.study.study_trial import Role, Trial
from gaitcal.synthetic.synthetic_motion import (
    simulate_gait,
    simulate_isolated_trial,
    simulate_static_trial,
)
from tests.synthetic_studies import made_plates, made_recording, only

Array = NDArray[np.float64]
Change = Callable[[Recording], Recording]

CORNERS = np.array([[10.0, 0.0, -10.0], [-10.0, 0.0, -10.0], [-10.0, 0.0, 10.0], [10.0, 0.0, 10.0]])
"""A plate as large as the room: every centre of pressure lies on it."""


@cache
def sound_study() -> Study:
    """Standing, walking over two plates, a moving knee: nothing to find."""
    walk = simulate_gait()
    plates = made_plates(walk)
    recordings = {
        "static": made_recording(simulate_static_trial(), static=True),
        "walk": replace(made_recording(walk), plates=plates),
        "knee_r": made_recording(simulate_isolated_trial("knee_r")),
    }
    trials = (
        Trial(name="static", role=Role.STATIC, recording=recordings["static"]),
        Trial(name="walk", role=Role.GAIT, recording=recordings["walk"]),
        Trial(name="knee_r", role=Role.JOINT, joint="knee_r", recording=recordings["knee_r"]),
    )
    subject = Subject("synthetic", 69.4, 1.70, "male")
    return Study(
        subject=subject,
        marker_set=load_marker_set("published"),
        trials=trials,
        settings=CalibrationSettings(),
        weights={},
        inputs={},
    )


def with_trial(study: Study, name: str, change: Change) -> Study:
    """The study with one recording changed."""
    trials = tuple(
        replace(t, recording=change(t.recording)) if t.name == name else t for t in study.trials
    )
    return replace(study, trials=trials)


def findings(
    study: Study,
    topic: str = "",
    severity: Severity | None = None,
    *,
    cause: str = "",
    code: Code | None = None,
) -> list[Finding]:
    """Find findings of a topic, severity, cause text and code."""
    wanted = {"topic": topic or None, "severity": severity, "code": code}
    found = [f for f in check_study(study) if cause in f.cause]
    return [
        f
        for f in found
        if all(getattr(f, name) == value for name, value in wanted.items() if value is not None)
    ]


def serious(study: Study) -> list[Finding]:
    """Find warnings and errors."""
    return [f for f in check_study(study) if f.severity is not Severity.INFO]


def recording_of(study: Study, name: str = "walk") -> Recording:
    return next(t.recording for t in study.trials if t.name == name)


def evidence(study: Study, trial: Trial, model: SubjectModel | None = None) -> TrialEvidence:
    """Build the evidence of one trial, as the checks use it."""
    marker_set = study.marker_set.with_weights(study.weights)
    return TrialEvidence(
        trial=clean_trial(trial, marker_set.segment_of, marker_set.noise),
        marker_set=marker_set,
        subject=study.subject,
        settings=study.settings,
        model=model,
    )


def drafted(folder: Path) -> Study:
    """The study that is drafted from a real folder."""
    return build_study(draft_folder(read_folder(folder), Options(sex="female")))


def moved(label: str, change: Callable[[Array], Array]) -> Change:
    """The trajectory (nf, 3) of one marker changed."""

    def spoil(recording: Recording) -> Recording:
        markers = recording.markers.copy()
        at = recording.labels.index(label)
        markers[:, at] = change(markers[:, at].copy())
        return replace(recording, markers=markers)

    return spoil


def swapped(a: str, b: str, frames: slice = slice(None)) -> Change:
    """Two labels swapped in some frames."""
    return put_into(a, b, frames, back=True)


def put_into(a: str, b: str, frames: slice = slice(None), *, back: bool = False) -> Change:
    """The trajectory of `b` under the label `a` as well, in some frames; `back`: and that of `a`
    under `b`.
    """

    def spoil(recording: Recording) -> Recording:
        markers = recording.markers.copy()
        i, j = recording.labels.index(a), recording.labels.index(b)
        markers[frames, i] = recording.markers[frames, j]
        if back:
            markers[frames, j] = recording.markers[frames, i]
        return replace(recording, markers=markers)

    return spoil


def taken(a: str, b: str, frames: slice) -> Change:
    """The label `a` at the position of `b`, which is not visible meanwhile."""
    return lambda r: gone(frames, b)(put_into(a, b, frames)(r))


def relabelled(old: str, new: str) -> Change:
    """One label spelt differently."""
    return lambda r: replace(r, labels=tuple(new if label == old else label for label in r.labels))


def without(*labels: str) -> Change:
    """Some markers not recorded."""
    return lambda r: only(r, lambda label: label not in labels)


def plates(change: Callable[[ForcePlate], ForcePlate], number: int | None = None) -> Change:
    """Every force plate changed, or one: 1, 2."""

    def spoil(recording: Recording) -> Recording:
        changed = (
            change(p) if number in (None, k) else p for k, p in enumerate(recording.plates, start=1)
        )
        return replace(recording, plates=tuple(changed))

    return spoil


def times(factor: float) -> Callable[[ForcePlate], ForcePlate]:
    """A plate of another gain."""
    return lambda p: replace(p, force=factor * p.force, moment=factor * p.moment)


def backwards(recording: Recording) -> Recording:
    """Reverse the frames: the body walks backwards, with feet rotated accordingly."""
    reverse = plates(
        lambda p: replace(p, force=p.force[::-1], point=p.point[::-1], moment=p.moment[::-1])
    )
    return replace(reverse(recording), markers=recording.markers[::-1].copy())


def scaled(factor: float) -> Change:
    return lambda r: replace(r, markers=factor * r.markers)


def gone(frames: slice, label: str = "R.Thigh.Front") -> Change:
    return moved(label, lambda x: put(x, frames, np.nan))


def put(x: Array, where: object, value: object) -> Array:
    x[where] = value  # type: ignore[index]
    return x


def held(x: Array) -> Array:
    return put(x, slice(60, 100), x[60])


def spiked(x: Array) -> Array:
    return put(x, ([40, 90, 140], 1), x[[40, 90, 140], 1] + 0.1)


def lying(recording: Recording) -> Recording:
    return replace(
        recording, markers=recording.markers[:, :, [1, 0, 2]] * [1.0, -1.0, 1.0], plates=()
    )


def mirrored(recording: Recording) -> Recording:
    order = [
        recording.labels.index(label[0].translate(str.maketrans("RL", "LR")) + label[1:])
        if label[:2] in ("R.", "L.") and "ASIS" not in label
        else i
        for i, label in enumerate(recording.labels)
    ]
    return replace(recording, markers=recording.markers[:, order])


def with_corners(x_end: float) -> Change:
    """Plate 1 ends at x_end m."""
    corners = np.column_stack([np.minimum(CORNERS[:, 0], x_end), CORNERS[:, 1:]])
    return plates(lambda p: replace(p, corners=corners), 1)
