"""Preset Provenance: what was recorded, how it was computed, with what, and what was assumed.

The three lines at the top of the page: can it be believed, does it fit, and what of the moments counts.
"""

from __future__ import annotations

import platform
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Final

import numpy as np

from gaitcal.faults.verdict import Judgement
from gaitcal.gait.cycles import POINTS, normalise, usable
from gaitcal.gait.moments import SIDE_WORDS, counted, explained, moment_of
from gaitcal.gait.spatiotemporal import LEAST_VALID, StridePeaks, stride_peaks
from gaitcal.gait.strides import strides_of, turns
from gaitcal.io.toml import package_version
from gaitcal.model.linkage import SIDES
from gaitcal.page.sections.blocks import (
    MISSING,
    Block,
    Cell,
    bullets,
    cell,
    fold,
    heading,
    named,
    number,
    table,
    text,
    visible,
    words_column,
)
from gaitcal.page.sections.error_bars import FIRST
from gaitcal.page.sections.summary import FAIR_RATIO, GOOD_RATIO, GaitNumbers, complete_strides
from gaitcal.page.sections.trust import file_name, phase_words, trial_facts
from gaitcal.session.result import Calibration, TrialResult
from gaitcal.session.trial_result import leg_fit

LIBRARIES: Final = ("pin", "numpy", "scipy")
LONG_NOTE: Final = 300
"""Characters of a note from which it is folded."""
HASHES: Final = "inputs_sha256"
OF_FILES: Final = ("kind", "files", "sha256", HASHES)
"""Entries of a manifest that are no settings."""
NOISE: Final = (
    "Noise: the marker error that would say as little of the joint parameters, if every frame of every marker were "
    "independent of all others. Skin movement repeats itself, so it is larger than the residuals; what was known "
    "before a phase, of people and by earlier trials, is weighed against it. How long each phase took: summary.json."
)
FILES: Final = (
    "Beside this page: parameters.csv (every parameter with its error), summary.json, manifest.json (settings, "
    "versions, SHA-256 of every file), cycles.csv and ensemble.csv (curves of each stride, and their means), "
    "spatiotemporal.csv, motion/, moments/, powers/, forces/, markers/ and marker_errors/ (each trial at each "
    "instant), model.osim, model.urdf, model.xml, model.toml. This page needs no network and can be archived as it is."
)


def provenance_blocks(calibration: Calibration, manifest: Mapping[str, object] | None) -> list[Block]:
    """Of the whole result."""
    made = dict(manifest) if manifest is not None else default_manifest(calibration)
    return [
        *_recordings(calibration),
        *_assumptions(calibration),
        *_phases(calibration),
        *_settings(made),
        *_hashes(made),
        text(FILES, "soft"),
    ]


def default_manifest(calibration: Calibration) -> dict[str, object]:
    """Versions, settings and hashes as far as the calibration knows them."""
    study = calibration.study
    return {
        "gaitcal": package_version("gaitcal"),
        "versions": {"python": platform.python_version()} | {name: package_version(name) for name in LIBRARIES},
        "marker_set": study.marker_set.name,
        "settings": study.settings.model_dump(mode="json"),
        HASHES: dict(study.inputs),
    }


def _recordings(calibration: Calibration) -> list[Block]:
    head: list[Cell] = [
        "Trial",
        words_column("Used as"),
        words_column("File"),
        "Length",
        "Frames",
        "Rate",
        "Markers",
        "Seen",
        "Force plates",
    ]
    rows: list[list[Cell]] = [
        [
            cell(named(facts.name)),
            cell(facts.role),
            cell(named(facts.file)),
            f"{number(facts.seconds, 2)} s",
            number(facts.frames, 0),
            f"{number(facts.rate, 0)} Hz",
            str(facts.markers),
            f"{number(facts.seen)} %",
            str(facts.plates or "none"),
        ]
        for facts in trial_facts(calibration)
    ]
    subject = calibration.model.subject
    person = (
        f"Body mass {number(subject.mass)} kg, height {number(subject.height, 3)} m, anthropometric table "
        f"{subject.sex}; marker set {calibration.study.marker_set.name}."
    )
    return [heading("What was recorded"), text(person), table(head, rows)]


def _assumptions(calibration: Calibration) -> list[Block]:
    out = [heading("What was assumed")]
    if not calibration.notes:
        out.append(text("Nothing beyond the study file."))
    of_trials = {trial.name: f"{trial.name}: " for trial in calibration.trials}
    every = [note for note in calibration.notes if not note.startswith(tuple(of_trials.values()))]
    out += note_blocks(every)
    for name, begin in of_trials.items():
        if own := [note.removeprefix(begin) for note in calibration.notes if note.startswith(begin)]:
            out.append(fold(f"Trial {named(name)}: {counted(len(own), 'note')}", note_blocks(own)))
    if calibration.model.frozen:
        held = ", ".join(name.replace("_", " ") for name in calibration.model.frozen)
        out.append(text(f"No marker shows {held}: the trunk stays upright, arms hang along it."))
    return out


def note_blocks(notes: Sequence[str]) -> list[Block]:
    """Notes as a list; long ones stand below it, folded away."""
    short = [note for note in notes if len(note) <= LONG_NOTE]
    long = [fold(f"{note[:120]}…", [text(note)]) for note in notes if len(note) > LONG_NOTE]
    return [bullets(short), *long] if short else [*long]


def _phases(calibration: Calibration) -> list[Block]:
    if not calibration.phases:
        return [heading("Phases of the calibration"), text("No phase was run.")]
    head: list[Cell] = [
        "Phase",
        words_column("Trials"),
        "Parameters",
        "Iterations",
        "Noise",
        words_column("Status"),
        words_column("Why it ended"),
    ]
    rows: list[list[Cell]] = [
        [
            cell(phase_words(phase)),
            cell(", ".join(named(trial) for trial in phase.trials)),
            str(phase.parameters),
            str(phase.iterations),
            "" if phase.marker_noise is None else f"{number(1e3 * phase.marker_noise)} mm",
            cell(phase.status, tone="good" if phase.converged else "look"),
            cell(phase.message),
        ]
        for phase in calibration.phases
    ]
    return [heading("Phases of the calibration"), table(head, rows), text(NOISE, "soft")]


def _settings(manifest: Mapping[str, object]) -> list[Block]:
    rows = [[cell(name), cell(value)] for name, value in flat({k: v for k, v in manifest.items() if k not in OF_FILES})]
    return [heading("Versions and settings"), table(["Name", words_column("Value")], rows)]


def _hashes(manifest: Mapping[str, object]) -> list[Block]:
    inputs = manifest.get(HASHES)
    if not isinstance(inputs, Mapping) or not inputs:
        return []
    rows: list[list[Cell]] = [[cell(named(file_name(str(name)))), cell(value)] for name, value in inputs.items()]
    return [heading("Inputs"), table(["File", words_column("SHA-256")], rows)]


def flat(manifest: Mapping[str, object], prefix: str = "") -> Iterator[tuple[str, str]]:
    """Nested tables as rows of dotted names and values."""
    for key, value in manifest.items():
        name = f"{prefix}{key}"
        if isinstance(value, Mapping):
            yield from flat(value, f"{name}.")
        elif isinstance(value, list | tuple):
            yield name, ", ".join(visible(v) for v in value) or MISSING
        else:
            yield name, MISSING if value is None else str(value)


TONES = {Judgement.TRUSTWORTHY: "good", Judgement.DOUBTFUL: "look", Judgement.REFUSED: "poor"}
ORDER = ("plain", "good", "look", "poor")


@dataclass(frozen=True)
class Line:
    """One of the three."""

    tone: str
    """`good`, `look`, `poor` or `plain`."""
    text: str

    def as_data(self) -> dict[str, str]:
        """As the sheet holds it."""
        return asdict(self)


def top_lines(calibration: Calibration, walks: Sequence[GaitNumbers]) -> tuple[Line, ...]:
    """Of a calibration with these walks."""
    mass = calibration.model.subject.mass
    return _believed(calibration), agreement_line(calibration.trials, walks), counting_line(mass, walks)


def _believed(calibration: Calibration) -> Line:
    verdict = calibration.verdict
    tone, words = TONES[verdict.judgement], f"{verdict.judgement.value.capitalize()}"
    if verdict.reasons:
        worst, rest = verdict.reasons[0], len(verdict.reasons) - 1
        where = f" ({', '.join(named(trial) for trial in worst.trials)})" if worst.trials else ""
        words += f": {explained(worst.cause)}{where}" + (f", and {counted(rest, 'other reason')}" if rest else "")
    words += f". {verdict.sentence}"
    if not calibration.converged:
        tone, words = "poor", f"Not converged: do not use these numbers before that is settled. {words}"
    return Line(tone, visible(words))


def agreement_line(trials: Sequence[TrialResult], walks: Sequence[GaitNumbers]) -> Line:
    """How near the model is to the markers of these trials, and to the forces of these walks."""
    fit, residual = _fit(trials), _residual(walks)
    told = [line for line in (fit, residual) if line is not None]
    if not told:
        return Line("plain", "Nothing was fitted: this study has no moving trial.")
    return Line(max((line.tone for line in told), key=ORDER.index), " ".join(line.text for line in told))


def _fit(every: Sequence[TrialResult]) -> Line | None:
    """Of the walk, or other trial, that is met worst against what its joints could reach."""
    trials = [t for t in every if t.joint is None] or list(every)
    fits = [(fit, t) for t in trials if (fit := leg_fit(t)).calibrated is not None]
    if not fits:
        return None
    fit, trial = max(fits, key=lambda pair: pair[0].joint_ratio or pair[0].ratio or 0.0)
    of = "Markers of pelvis and legs" if trial.joint is None else "Markers"
    words = f"{of} are met to {number(fit.calibrated)} mm RMS ({named(trial.name)})"
    ratio, floor = (fit.joint_ratio, fit.joint_floor) if fit.joint_ratio is not None else (fit.ratio, fit.floor)
    if ratio is None:
        return Line("plain", visible(f"{words}."))
    least = "each joint by itself to" if fit.joint_ratio is not None else "rigid segments alone to"
    tone = "good" if ratio <= GOOD_RATIO else "look" if ratio <= FAIR_RATIO else "poor"
    return Line(tone, visible(f"{words}, {least} {number(floor)} mm."))


def _residual(walks: Sequence[GaitNumbers]) -> Line | None:
    """Of the walk whose residual is largest against its limit."""
    found = [walk for walk in walks if walk.stages]
    if not found:
        return None
    walk = max(found, key=lambda w: 0.0 if w.expected is None else w.expected.share)
    last, held = walk.stages[-1], walk.expected
    words = f"Forces and motion agree to {number(last.rms_force)} N and {number(last.rms_moment)} N·m RMS"
    words += f" ({named(walk.trial.name)})"
    if held is None:
        return Line("plain", visible(f"{words}."))
    limits = f"(limits {number(held.force.limit)} N, {number(held.moment.limit)} N·m)"
    if held.within:
        return Line("good", visible(f"{words}, within what their errors explain {limits}."))
    return Line("look", visible(f"{words}: more than their errors explain {limits}."))


def counting_line(mass: float, walks: Sequence[GaitNumbers]) -> Line:
    """Strides with valid moments, and the peak knee adduction moment of each leg. `mass`: kg."""
    if not walks:
        return Line("plain", "No walk: joint parameters alone.")
    loaded = [walk for walk in walks if walk.numbers]
    if not loaded:
        plates = any(walk.trial.loads is not None for walk in walks)
        why = "no foot is wholly on a force plate of its own" if plates else "there are no force plates"
        return Line("look" if plates else "plain", f"Angles alone count, no moments: {why}.")
    strides = {side: [complete_strides(walk, side) for walk in loaded] for side in SIDES}
    valid = {side: sum(v for v, _ in found) for side, found in strides.items()}
    total = {side: sum(n for _, n in found) for side, found in strides.items()}
    told = [f"{valid[side]} of {total[side]} {SIDE_WORDS[side]}" for side in SIDES]
    words = f"Moments count throughout {told[0]} and {told[1]} strides."
    peaks = {side: adduction_peaks([walk.trial for walk in walks], side) for side in SIDES}
    both = ", ".join(_peak(peak, side, mass) for side, peak in peaks.items() if peak.strides)
    if both:
        words += (
            " Peak external knee adduction moment, N·m/kg, mean ± SD of the peaks of all straight strides that are "
            f"valid to {number(100.0 * LEAST_VALID, 0)} %: {both}."
        )
    known = any(walk.trial.loads is not None and walk.trial.loads.errors is not None for walk in loaded)
    if not known:
        words += " No standard errors are known."
    return Line("plain" if all(valid.values()) and known else "look", words)


def adduction_peaks(walks: Sequence[TrialResult], side: str) -> StridePeaks:
    """Largest external adduction moment (N·m) of a knee in each straight stride, as in the page's table of peaks."""
    name = f"{FIRST}_{side}"
    values, errors = [], []
    for walk in walks:
        time, straight = walk.body.time, {s.number: not turns(s.turn) for s in walk.strides if s.side == side}
        for k, cycle in enumerate(strides_of(walk.events)[side], start=1):
            if walk.loads is None or not straight.get(k, True):
                continue
            counts = usable(time, walk.loads.reactions.valid_for(name), cycle)
            laid = normalise(time, -moment_of(walk.loads.final, name), cycle)
            values.append(np.where(counts, laid, np.nan))
            known = walk.loads.errors
            errors.append(np.full(POINTS, np.nan) if known is None else normalise(time, moment_of(known, name), cycle))
    shape = (len(values), POINTS)
    return stride_peaks(np.reshape(values, shape), np.reshape(errors, shape))


def _peak(peak: StridePeaks, side: str, mass: float) -> str:
    """`right 0.42 ± 0.03 (4 of 5)`."""
    share = f"{peak.count} of {counted(peak.strides, 'stride')}"
    if not peak.count:
        return f"{SIDE_WORDS[side]} – ({share})"
    value = number(peak.mean / mass, 2)
    if np.isfinite(peak.error):
        value += f" ± {number(peak.error / mass, 2)}"
        if peak.count == 1:
            share += ", ± its standard error"
    return f"{SIDE_WORDS[side]} {value} ({share})"
