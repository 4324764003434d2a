"""The joints of a person by some of the recordings."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from gaitcal import Study, SubjectModel
from gaitcal.analysis.fit_joints import fit_joints
from gaitcal.analysis.prepared_trials import prepare_calibration
from gaitcal.arrays import Array
from gaitcal.calibration.error_sources import ErrorSources
from gaitcal.model.linkage import SIDES
from gaitcal.model.parameters import (
    JOINT_PARAMETERS,
    JP_INDEX,
    JP_NAMES,
    Parameters,
    list_leg_parameters,
)
from gaitcal.preprocess.preprocessed_study import preprocess_study
from gaitcal.study.normal_prior import JointPrior

LEG = tuple(name.replace("_r", "", 1) for name in list_leg_parameters("r"))
"""The 27 joint parameters of a leg without its side: `hip.pelvis.ant`."""
OUTWARD = {
    s: np.array([-1.0 if s == "l" and p.mirrored else 1.0 for p in JOINT_PARAMETERS]) for s in SIDES
}
"""Side -> (98,): left values times these are those of a right leg, so that lateral is outward."""

UNTOLD = 1e-7
"""m, rad: what no trial tells of moves by rounding alone."""


@dataclass(frozen=True, kw_only=True)
class Fit:
    name: str
    nominal: SubjectModel
    parameters: Parameters
    errors: Array
    """(98,) m, rad: standard errors; NaN of what is not fitted."""
    influence: ErrorSources

    def leg(self, side: str, values: Array) -> Array:
        """(27,) of a (98,) array, as of a right leg, in the order of `LEG`."""
        index = [JP_INDEX[name] for name in list_leg_parameters(side)]
        return np.asarray((OUTWARD[side] * values)[index])

    def moved(self, side: str) -> Array:
        """(27,) m, rad: from the nominal place, as of a right leg; NaN of what no trial tells."""
        move = self.leg(side, self.parameters.joint - self.nominal.parameters.joint)
        return np.where(np.abs(move) > UNTOLD, move, np.nan)

    def leg_errors(self, side: str) -> Array:
        return np.abs(self.leg(side, self.errors))

    @property
    def asis_m(self) -> float:
        """M between the spines: as measured by hand, else between their markers."""
        points = [self.nominal.landmarks[f"asis_{side}"][1] for side in SIDES]
        return self.nominal.subject.asis_distance or float(np.linalg.norm(points[0] - points[1]))

    def hips_apart(self) -> tuple[float, float, float]:
        """M between the hips in the pelvis: nominal, fitted, standard error (sides taken as
        independent).
        """
        at = [[JP_INDEX[f"hip_{side}.pelvis.{d}"] for d in ("ant", "sup", "lat")] for side in SIDES]
        gaps = [p.joint[at[0]] - p.joint[at[1]] for p in (self.nominal.parameters, self.parameters)]
        nominal, fitted = (float(np.linalg.norm(gap)) for gap in gaps)
        return nominal, fitted, float(np.hypot(self.errors[at[0][2]], self.errors[at[1][2]]))


def wide_hips(study: Study, deviation_mm: float) -> Study:
    """The study with a prior so wide on the place of hips, one coordinate as independent of the
    others as any.
    """
    names = tuple(name for name in JP_NAMES if name.startswith("hip_"))
    mean, covariance = np.zeros(len(names)), np.eye(len(names)) * (1e-3 * deviation_mm) ** 2
    prior = JointPrior(
        names=names, mean=mean, covariance=covariance, file="", people=0, left_out=0, notes=()
    )
    return replace(study, joint_prior=prior)


def fitted(name: str, study: Study) -> Fit:
    stage = fit_joints(prepare_calibration(preprocess_study(study)))
    if stage.joint is None:
        raise RuntimeError(f"{name}: no joint parameters were fitted")
    known = stage.joint.errors.standard_errors
    errors = np.array([known.get(jp, np.nan) for jp in JP_NAMES])
    return Fit(
        name=name,
        nominal=stage.model,
        parameters=stage.parameters,
        errors=np.where(errors > 0, errors, np.nan),
        influence=stage.joint.errors,
    )
