"""Several static trials of one person: each segment's markers, and lengths across joints, must be those of the first.

The markers of a segment that both trials show are laid on each other (rotation R and shift t, least squares); what is
left of marker k, e_k = R x_k + t - x0_k, is its disagreement. Of three markers a displaced one shares its disagreement
with the others; of four or more the one without which the rest agrees best is named. Where fewer than three are common,
the distance between them is compared.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from gaitcal.arrays import Array
from gaitcal.codes import Code
from gaitcal.errors import InputError
from gaitcal.faults.evidence import LIGHT, TrialEvidence
from gaitcal.findings import Finding, Severity, listed
from gaitcal.io.still import still_window
from gaitcal.motion.rigid import rigid_fit

DISAGREE_M = 0.008
"""Largest disagreement of a marker between two times that one person stands: within a session markers of a segment keep
their shape to 5 mm (p99 over pelvis, thigh, shank and foot, standing against moving)."""
GROSS_M = 0.020
"""From here it moves a joint by more than nominal joints are uncertain: an error."""


def statics_agree(trials: Sequence[TrialEvidence]) -> Iterator[Finding]:
    """Whether further static trials show the body of the first."""
    standing = [trial for trial in trials if trial.is_static]
    if not standing:
        return
    first, *others = standing
    reference = still_positions(first)
    for other in others:
        positions = still_positions(other)
        told = [
            (away, label, segment)
            for segment, labels in _segments(first).items()
            if (found := _disagreement([m for m in labels if m in reference and m in positions], reference, positions))
            for away, label in [found]
            if away > DISAGREE_M
        ]
        if not told:
            if positions and reference:
                yield other.info(
                    "static trial",
                    f"agrees with '{first.name}', which the model is made of",
                    code=Code.STATICS_DISAGREE,
                )
            continue
        told.sort(reverse=True)
        words = listed([f"'{label}' {1e3 * away:.0f} mm ({segment})" for away, label, segment in told])
        yield other.finding(
            Severity.ERROR if told[0][0] > GROSS_M else Severity.WARNING,
            "static trial",
            f"against the other markers of its segment: {words}; allowed: {1e3 * DISAGREE_M:.0f} mm",
            f"leave out the static trial whose markers moved or whose labels are wrong; '{first.name}', the first, "
            "gives the model",
            cause=f"static trials '{first.name}' and '{other.name}' do not show the same body",
            weight=told[0][0] / DISAGREE_M,
            code=Code.STATICS_DISAGREE,
        )


def still_positions(trial: TrialEvidence) -> dict[str, Array]:
    """Label -> (3,) m, mean over the still window, of the set's markers; empty where nobody stands still."""
    try:
        still = still_window(trial.recording, trial.marker_set.labels).frames
    except InputError:
        return {}
    out = {}
    for label in trial.marker_set.labels:
        if label in trial.place:
            path = trial.path(label)[still]
            seen = path[np.isfinite(path).all(axis=1)]
            if len(seen):
                out[label] = seen.mean(axis=0)
    return out


def _segments(trial: TrialEvidence) -> dict[str, list[str]]:
    """Segment -> its markers that decide anything, those of the static trial alone and landmarks included."""
    marker_set = trial.marker_set
    out: dict[str, list[str]] = {}
    for group in (marker_set.tracking, marker_set.static_only):
        for segment, labels in group.items():
            out.setdefault(segment, []).extend(m for m in labels if not 0 < marker_set.weight(m) <= LIGHT)
    loose = ("head_trunk", "upper_arm", "forearm")
    return {segment: labels for segment, labels in out.items() if not segment.startswith(loose)}


def _disagreement(
    labels: list[str], reference: dict[str, Array], positions: dict[str, Array]
) -> tuple[float, str] | None:
    """The largest disagreement (m) and the marker that is named for it."""
    if len(labels) < 2:
        return None
    a, b = (np.array([where[m] for m in labels]) for where in (reference, positions))
    if len(labels) == 2:
        away = abs(float(np.linalg.norm(a[1] - a[0]) - np.linalg.norm(b[1] - b[0])))
        return away, labels[0] + "' or '" + labels[1]
    left = _left(a, b)
    if len(labels) == 3:
        return float(left.max()), labels[int(left.argmax())]
    without = [_left(np.delete(a, k, axis=0), np.delete(b, k, axis=0)) for k in range(len(labels))]
    culprit = int(np.argmin([float(np.sum(rest**2)) for rest in without]))
    kept = [k for k in range(len(labels)) if k != culprit]
    return float(_left(a, b, kept)[culprit]), labels[culprit]


def _left(a: Array, b: Array, fitted: list[int] | None = None) -> Array:
    """(nm,) m, distances of b (nm, 3) from a (nm, 3) after the rigid motion that fits the markers `fitted` best."""
    weight = np.zeros((len(a), 1))
    weight[slice(None) if fitted is None else fitted] = 1.0
    fit = rigid_fit(a, b[:, :, None], weight)
    out: Array = np.linalg.norm(b - (fit.origin[0] + a @ fit.rotation[0].T), axis=1)
    return out
