"""The static trial: is there a still window, and does a nominal model follow from it?"""

from __future__ import annotations

from collections.abc import Iterator

from gaitcal.codes import Code
from gaitcal.errors import InputError
from gaitcal.faults.evidence import TrialEvidence
from gaitcal.findings import Finding
from gaitcal.io.still import LAG_S, RESTLESS_M_S, STILL_M_S, still_window
from gaitcal.model.subject_model import SubjectModel
from gaitcal.study.study import Study, nominal_of

FEWEST_FRAMES, SHORTEST_S = 3, LAG_S
"""Of a static trial: speed is told over that time."""
RESTLESS = 0.5
"""Share of the speed of a still window above which the stillest one is doubted: 1 to 7 mm/s in clean static trials."""


def nominal_model_of(study: Study) -> tuple[SubjectModel | None, tuple[Finding, ...]]:
    """The nominal model, or what keeps the static trial from giving one."""
    try:
        return nominal_of(study), ()
    except InputError as fault:
        return None, (Finding.of_fault(fault, study.static.name, study.static.recording.source, "static trial"),)


def length(trial: TrialEvidence) -> Iterator[Finding]:
    """Whether the static trial is long enough to tell that anybody stands still; one that is not is taken as it is."""
    time = trial.recording.time
    if not trial.is_static or (len(time) >= FEWEST_FRAMES and time[-1] - time[0] >= SHORTEST_S):
        return
    yield trial.warning(
        "still window",
        f"found {len(time)} frames over {time[-1] - time[0]:.3g} s, all of them used; at least {FEWEST_FRAMES} frames "
        f"over {SHORTEST_S:g} s tell standing still from moving",
        "make sure that the person stands still there, or give a longer part of the recording",
        cause="the static trial is too short to tell whether the person stands still",
        code=Code.SHORT_STATIC,
    )


def stillness(trial: TrialEvidence) -> Iterator[Finding]:
    """How still the person stood."""
    if not trial.is_static or trial.model is None or any(length(trial)):
        return
    try:
        window = still_window(trial.recording, trial.marker_set.labels)
    except InputError:
        return  # told as what keeps the nominal model from being made
    words = f"stillest window {window.start:.2f}-{window.stop:.2f} s, markers move at {1e3 * window.speed:.0f} mm/s RMS"
    words += f" and stray by {1e3 * window.scatter:.1f} mm RMS from their means"
    if window.speed > RESTLESS * STILL_M_S:
        yield trial.warning(
            "still window",
            f"{words}; most people stand within 10 mm/s, more than {1e3 * RESTLESS_M_S:.0f} are refused",
            "let the person stand still for some seconds; segment frames come from this posture",
            weight=window.speed / STILL_M_S,
            code=Code.STILLNESS,
        )
    else:
        yield trial.info("still window", words, code=Code.STILLNESS)
