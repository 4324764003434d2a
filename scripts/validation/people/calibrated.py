"""Calibrations of real people, whole (fit of their trials, pelvis residuals, moments beside the hospital's) and of the
joints by some of their recordings; and hips of simulated people, whose truth is known, by their walk alone, their
isolated trials alone, and by both.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np

import gaitcal
from gaitcal import Calibration, Study, SubjectModel
from gaitcal.arrays import Array
from gaitcal.calibration.error_sources import ErrorSources
from gaitcal.model.linkage import SIDES
from gaitcal.model.parameters import JOINT_PARAMETERS, JP_INDEX, JP_NAMES, Parameters, leg_parameters
from gaitcal.session.joint_parameters import fit_joints
from gaitcal.session.result import Stage
from gaitcal.session.session import session_of
from gaitcal.study.joint_prior import JointPrior
from gaitcal.study.study import nominal_of
from scripts.validation.error_bars import Bars, bars, rms
from scripts.validation.recordings import changed, only, study_of_person
from scripts.validation.truth.people import hip_parameters, isolated_person, static_frames
from scripts.validation.truth.report import TO_UNIT
from scripts.validation.truth.skin import TABLE_MM, Kind, disturbed
from scripts.validation.vendors import LABS, QUANTITIES, Walk, agreement, calibrated_walk, unit_of_walks

STAGES = {"nominal": Stage.NOMINAL, "hips": Stage.JP, "final": Stage.JP_IP}
"""Column -> model."""
Settings = tuple[tuple[str, object], ...]


@lru_cache(maxsize=32)
def calibrated(person: str, settings: Settings) -> Calibration:
    """All recordings of a person together."""
    return gaitcal.calibrate(changed(study_of_person(person), dict(settings)))


def fit_lines(people: Sequence[str], settings: Settings, out: dict[str, float]) -> Iterator[str]:
    """Marker distance of each trial over its floors, pelvis residual over valid frames; figures into `out`."""
    yield (
        f"{'RMS marker distance, mm':32}{'nominal':>8}{'final':>7}{'rigid':>7}{'ratio':>7}{'to joint floor':>16}"
        f"{'pelvis residual':>20}   verdict"
    )
    for person in people:
        calibration = calibrated(person, settings)
        for trial in calibration.trials:
            nominal, _, rigid = trial.rms_mm()
            final, floor = 1e3 * (trial.final.errors.rms() or np.nan), trial.joint_floor_mm() or np.nan
            ratio = final / (rigid or np.nan)
            out[f"{person} {trial.name}: over rigid floor"] = float(ratio)
            residual = ""
            if trial.loads is not None and trial.loads.residuals:
                last = trial.loads.residuals[-1]
                residual = f"{last.rms_force:8.0f} N{last.rms_moment:6.1f} N·m"
                out[f"{person} {trial.name}: residual N"] = last.rms_force
                out[f"{person} {trial.name}: residual N·m"] = last.rms_moment
            yield (
                f"{person + ' ' + trial.name:32}{nominal or np.nan:8.1f}{final:7.2f}{rigid or np.nan:7.2f}{ratio:7.2f}"
                f"{final / floor:16.2f}{residual:>20}   {calibration.verdict.judgement.value}"
            )


def moment_lines(people: Sequence[str], settings: Settings, out: dict[str, float]) -> Iterator[str]:
    """RMS difference of moments (N·m/kg) to the vendor's, with the models of each stage: in stance; in swing too."""
    for lab, of_lab in LABS.items():
        members = [person for person in of_lab if person in people]
        walks = {words: list(_walks(members, settings, stage)) for words, stage in STAGES.items()}
        if not all(walks.values()):
            continue
        unit = unit_of_walks(walks["nominal"])
        yield f"{lab}: moments less the vendor's, N·m/kg RMS: {', '.join(STAGES)} in stance; the same, swing too"
        for quantity in (q for q in QUANTITIES if q.kind == "moment"):
            found = {words: agreement(quantity, of, unit) for words, of in walks.items()}
            columns = ["".join(f"{a.rms[f]:8.3f}" for a in found.values()) for f in ("leg", "swing too")]
            yield f"  {quantity.words:24}{'   '.join(columns)}"
            out |= {f"{lab} {quantity.words}, {words}": a.rms["leg"] for words, a in found.items()}


def _walks(people: Sequence[str], settings: Settings, stage: Stage) -> Iterator[Walk]:
    for person in people:
        calibration = calibrated(person, settings)
        for trial in calibration.trials:
            walk = calibrated_walk(calibration, trial.name, stage)
            if walk is not None:
                yield walk


LEG = tuple(name.replace("_r", "", 1) for name in leg_parameters("r"))
"""The 27 joint parameters of a leg without its side: `hip.pelvis.ant`."""
OUTWARD = {s: np.array([-1.0 if s == "l" and p.mirrored else 1.0 for p in JOINT_PARAMETERS]) for s in SIDES}
"""Side -> (98,): left values times these are those of a right leg, so that lateral is outward."""

UNTOLD = 1e-7
"""m, rad: what no trial tells of moves by rounding alone."""


@dataclass(frozen=True, kw_only=True)
class Fit:
    """Joint parameters of a person by some trials."""

    name: str
    nominal: SubjectModel
    parameters: Parameters
    errors: Array
    """(98,) m, rad: standard errors; NaN of what is not fitted."""
    influence: ErrorSources

    def leg(self, side: str, values: Array) -> Array:
        """(27,) of a (98,) array, as of a right leg, in the order of `LEG`."""
        index = [JP_INDEX[name] for name in leg_parameters(side)]
        return np.asarray((OUTWARD[side] * values)[index])

    def moved(self, side: str) -> Array:
        """(27,) m, rad: from the nominal place, as of a right leg; NaN of what no trial tells."""
        move = self.leg(side, self.parameters.joint - self.nominal.parameters.joint)
        return np.where(np.abs(move) > UNTOLD, move, np.nan)

    def leg_errors(self, side: str) -> Array:
        """(27,) m, rad: standard errors."""
        return np.abs(self.leg(side, self.errors))

    @property
    def asis_m(self) -> float:
        """M between the spines: as measured by hand, else between their markers."""
        points = [self.nominal.landmarks[f"asis_{side}"][1] for side in SIDES]
        return self.nominal.subject.asis_distance or float(np.linalg.norm(points[0] - points[1]))

    def hips_apart(self) -> tuple[float, float, float]:
        """M between the hips in the pelvis: nominal, fitted, standard error (sides taken as independent)."""
        at = [[JP_INDEX[f"hip_{side}.pelvis.{d}"] for d in ("ant", "sup", "lat")] for side in SIDES]
        gaps = [p.joint[at[0]] - p.joint[at[1]] for p in (self.nominal.parameters, self.parameters)]
        nominal, fitted = (float(np.linalg.norm(gap)) for gap in gaps)
        return nominal, fitted, float(np.hypot(self.errors[at[0][2]], self.errors[at[1][2]]))


def wide_hips(study: Study, deviation_mm: float) -> Study:
    """The study with a prior so wide on the place of hips, one coordinate as independent of the others as any."""
    names = tuple(name for name in JP_NAMES if name.startswith("hip_"))
    covariance = np.eye(len(names)) * (1e-3 * deviation_mm) ** 2
    prior = JointPrior(
        names=names, mean=np.zeros(len(names)), covariance=covariance, file="", people=0, left_out=0, notes=()
    )
    return replace(study, joint_prior=prior)


def fitted(name: str, study: Study) -> Fit:
    """The joint stage of a calibration."""
    nominal = nominal_of(study)
    stage = fit_joints(session_of(study, nominal))
    if stage.joint is None:
        raise RuntimeError(f"{name}: no joint parameters were fitted")
    known = stage.joint.errors.standard_errors
    errors = np.array([known.get(jp, np.nan) for jp in JP_NAMES])
    return Fit(
        name=name,
        nominal=nominal,
        parameters=stage.parameters,
        errors=np.where(errors > 0, errors, np.nan),
        influence=stage.joint.errors,
    )


TRIALS = {"gait": ("gait",), "isolated": ("joint",), "gait and isolated": ("gait", "joint")}
"""Words -> roles of the trials that are calibrated."""
WAVES_MM = 10.0
"""Of the published waves; other kinds have the size of their table."""


@dataclass(frozen=True, kw_only=True)
class Hips:
    """Both hips of one fit, in pelvis and thigh."""

    kind: Kind
    trials: str
    error: Array
    """(4, 3) mm: fitted less true."""
    nominal: Array
    """(4, 3) mm: nominal less true, which is the prior's error."""
    se: Array
    """(4, 3) mm."""


def hips_of(person: str, kind: Kind, seed: int, settings: Mapping[str, object], data: Path, cache: Path) -> list[Hips]:
    """Disturb a person's markers, and fit each choice of trials."""
    made = isolated_person(person, data, cache, with_gait=True)
    size = WAVES_MM if kind is Kind.SINUSOIDS else TABLE_MM
    study = changed(disturbed(made.study, kind, size, seed), settings)
    out = []
    for words, roles in TRIALS.items():
        fit = fitted(person, only(study, *roles))
        frames = static_frames(fit.nominal, study.static.recording)
        truth = {n: v for s in SIDES for n, v in hip_parameters(frames, s, made.centres[f"hip_{s}"]).items()}
        at, true = [JP_INDEX[name] for name in truth], np.array(list(truth.values()))
        values = (fit.parameters.joint[at] - true, fit.nominal.parameters.joint[at] - true, fit.errors[at])
        error, nominal, se = (v.reshape(-1, 3) / TO_UNIT["mm"] for v in values)
        out.append(Hips(kind=kind, trials=words, error=error, nominal=nominal, se=se))
    return out


def lines(found: Sequence[Hips], out: dict[str, float]) -> Iterator[str]:
    """RMS distance and coverage of each kind and choice of trials; figures into `out`."""
    yield f"{'hips, mm: RMS distance':32}{'fits':>6}{'nominal':>9}{'fitted':>9}{'SE':>7}{'in 68 %':>9}{'in 95 %':>9}"
    for kind, trials in dict.fromkeys((h.kind, h.trials) for h in found):
        of = [h for h in found if (h.kind, h.trials) == (kind, trials)]
        nominal, error = (rms([np.linalg.norm(getattr(h, w), axis=1) for h in of]) for w in ("nominal", "error"))
        held = sum((bars(h.error, h.se) for h in of), Bars())
        name = f"{kind.value}, {trials}"
        yield (
            f"{name:32}{len(of):6}{nominal:9.1f}{error:9.2f}{np.sqrt(3) * held.rms:7.1f}"
            f"{held.shares[0]:9.0f}{held.shares[1]:9.0f}"
        )
        out |= {f"{name}: nominal": nominal, f"{name}: RMS": error, f"{name}: in 95 %": held.shares[1]}
