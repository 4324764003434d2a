"""How near the truth, in rows and sentences: one source for the page and the terminal."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from gaitcal.arrays import Array
from gaitcal.dynamics.ground_reactions import leg_of
from gaitcal.gait.moments import moment_names
from gaitcal.model.linkage import LEG_JOINTS
from gaitcal.model.parameters import JOINT_PARAMETERS, JP_INDEX
from gaitcal.session.result import Calibration
from gaitcal.session.truth_errors import INTERVAL, CurveTruth, ParameterTruth, TruthErrors

LEGS, ARMS, TURNING = "legs", "back and arms", "arms, in segments of two markers"
"""Which joint parameters are told together."""
UNDETERMINED = "unidentifiable"


@dataclass(frozen=True, kw_only=True)
class TruthSum:
    """One number for many: RMS error before and after calibration, and how often the truth lies within."""

    words: str
    unit: str
    count: int
    """Parameters, or curves."""
    undetermined: int = 0
    """Of these parameters: such as the trials do not show, which their prior holds; they have no part in `bars`."""
    nominal: float
    fitted: float
    within: int
    """Parameters or frames with a standard error whose truth lies within 1.96 of it."""
    bars: int
    """Parameters or frames with a standard error."""

    @property
    def share(self) -> float | None:
        """Part (0 to 1) that lies within; None without standard errors."""
        return self.within / self.bars if self.bars else None

    @property
    def farther(self) -> bool:
        """Calibration led away from the truth, by as much as is shown."""
        return round(self.fitted, 2) > round(self.nominal, 2)

    @property
    def over(self) -> str:
        """`58, 2 of them undetermined`."""
        return f"{self.count}, {self.undetermined} of them undetermined" if self.undetermined else str(self.count)

    @property
    def sentence(self) -> str:
        """`joint positions against the truth (RMS over 58): nominal 5.6 mm, calibrated 1.2 mm; ...`."""
        text = f"{self.words} against the truth (RMS over {self.over}): nominal {self.nominal:.2f} {self.unit}, "
        text += f"calibrated {self.fitted:.2f} {self.unit}"
        return text if self.share is None else f"{text}; within 1.96 standard errors: {100 * self.share:.0f} %"


@dataclass(frozen=True, kw_only=True)
class CurveRow:
    """One leg coordinate of one trial: its angle and its moment beside the true ones; what is unknown is None."""

    name: str
    angle: CurveTruth | None
    moment: CurveTruth | None


def sums(calibration: Calibration, truth: TruthErrors) -> tuple[TruthSum, ...]:
    """Joint parameters that were sought, of legs and of the others; masses; angles and moments of legs in each walk."""
    turning = two_marker_segments(calibration)
    groups = [
        (f"{kind}s, {part}", tuple(p for p in truth.sought(kind) if _part(p.name, turning) == part))
        for part in (LEGS, ARMS, TURNING)
        for kind in ("joint position", "joint orientation")
    ]
    groups.append(("segment masses", tuple(p for p in truth.parameters if p.kind == "mass")))
    out = [_of_parameters(words, group) for words, group in groups if group]
    for trial in calibration.trials:
        rows = curve_rows(calibration, truth, trial.name) if trial.joint is None else ()
        for words, unit, curves in (
            (f"{trial.name}: leg angles", "deg", [row.angle for row in rows]),
            (f"{trial.name}: leg moments", "N·m", [row.moment for row in rows]),
        ):
            compared = [curve for curve in curves if curve is not None and curve.rms is not None]
            if compared:
                out.append(_of_curves(words, unit, compared))
    return tuple(out)


def curve_rows(calibration: Calibration, truth: TruthErrors, trial: str) -> tuple[CurveRow, ...]:
    """The coordinates and moments of both legs, in the order of the result."""
    known = truth.of(trial)
    names = [name for name in moment_names(calibration.model) if leg_of(name)]
    rows = (CurveRow(name=n, angle=known.coordinates.get(n), moment=known.forces.get(n)) for n in names)
    return tuple(row for row in rows if row.angle is not None or row.moment is not None)


def compared_trials(calibration: Calibration, truth: TruthErrors) -> tuple[str, ...]:
    """Walks of which true curves are known."""
    return tuple(t.name for t in calibration.trials if t.joint is None and t.name in truth.trials)


def two_marker_segments(calibration: Calibration) -> tuple[str, ...]:
    """Segments outside of the legs that two markers or fewer track: how these turn about their line, none shows."""
    markers = calibration.model.markers
    counted = Counter(s for s, w in zip(markers.segments, markers.weight, strict=True) if w > 0)
    known = dict.fromkeys(p.segment for p in JOINT_PARAMETERS if p.joint.split("_")[0] not in LEG_JOINTS)
    return tuple(s for s in known if 0 < counted[s] <= 2)


def turning_sentence(calibration: Calibration) -> str:
    """What is to be known of the parameters in such segments; empty where there are none."""
    segments = [s.replace("_", " ") for s in two_marker_segments(calibration)]
    if not segments:
        return ""
    return (
        f"Two markers track {', '.join(segments)}: how such a segment is turned about the line through them no motion "
        "shows, and an axis that is turned with it meets the markers as well. There the nominal value decides, which "
        "the landmarks of the static trial may place tens of degrees off."
    )


def _part(name: str, turning: Sequence[str]) -> str:
    parameter = JOINT_PARAMETERS[JP_INDEX[name]]
    if parameter.joint.split("_")[0] in LEG_JOINTS:
        return LEGS
    return TURNING if parameter.segment in turning else ARMS


def settings_sentence(calibration: Calibration) -> str:
    """With which knowledge it was calibrated: settings that are not the default ones."""
    own = calibration.study.settings.model_dump(exclude_defaults=True, mode="json")
    if not own:
        return "It was calibrated with the default settings, every one."
    told = "; ".join(f"{name}: {_shown(value)}" for name, value in own.items())
    return f"It was calibrated with the default settings, but for what its study file says: {told}."


def _shown(value: object) -> str:
    return ", ".join(f"{k} {_shown(v)}" for k, v in value.items()) if isinstance(value, dict) else str(value)


def not_compared_sentence(truth: TruthErrors) -> str:
    """Trials whose curves are not, or not all, held against true ones; empty where all are."""
    trials = [f"{name}: {why}" for name, why in truth.not_compared.items()]
    return f"Not compared: {'; '.join(trials)}." if trials else ""


def truth_sentence(truth: TruthErrors) -> str:
    """What the error bars are held to."""
    unknown = "" if truth.trials else " No true curves are known."
    return (
        f"Of honest error bars, ±{INTERVAL} standard errors hold the truth in 95 of 100 cases; neighbouring frames of "
        f"a curve err together, so that the share of one person scatters widely about that.{unknown}"
    )


def _of_parameters(words: str, group: Sequence[ParameterTruth]) -> TruthSum:
    z = [p.z for p in group if p.z is not None and p.status != UNDETERMINED]
    return TruthSum(
        words=words,
        unit=group[0].unit,
        count=len(group),
        undetermined=sum(p.status == UNDETERMINED for p in group),
        nominal=_rms(np.array([p.nominal_error for p in group])),
        fitted=_rms(np.array([p.error for p in group])),
        within=sum(abs(value) <= INTERVAL for value in z),
        bars=len(z),
    )


def _of_curves(words: str, unit: str, curves: Sequence[CurveTruth]) -> TruthSum:
    nominal, fitted = (
        _rms(_errors(values, curves)) for values in ((c.nominal for c in curves), (c.fitted for c in curves))
    )
    within = [c.within for c in curves]
    return TruthSum(
        words=words,
        unit=unit,
        count=len(curves),
        nominal=nominal,
        fitted=fitted,
        within=int(sum(w.sum() for w in within)),
        bars=sum(map(len, within)),
    )


def _errors(values: Iterable[Array], curves: Sequence[CurveTruth]) -> Array:
    return np.concatenate([(v - c.truth)[c.compared] for v, c in zip(values, curves, strict=True)])


def _rms(errors: Array) -> float:
    return float(np.sqrt(np.mean(errors**2)))
