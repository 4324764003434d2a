"""The real people of the data folder: their studies, drafted from their folders, and fits of their joints."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from gaitcal import Study, SubjectModel
from gaitcal.arrays import Array
from gaitcal.calibration.influence import Influence
from gaitcal.commands.console import Talk
from gaitcal.commands.init import options_of, study_or_draft
from gaitcal.intake.draft_text import study_of
from gaitcal.model.joint_parameters import JOINT_PARAMETERS, JP_INDEX, JP_NAMES, leg_parameters
from gaitcal.model.linkage import SIDES
from gaitcal.model.parameters import Parameters
from gaitcal.person.joint_parameters import joint_stage
from gaitcal.runtime import silent
from gaitcal.study.joint_prior import JointPrior
from gaitcal.study.study import nominal_of
from gaitcal.study.study_trial import Role
from scripts.validation.attacks.bases import recorded
from scripts.validation.clinics.folders import CLINICS

_MARKER_SETS = Path(__file__).parent / "marker_sets"
_LABS = "more_labs"
OTHERS = {
    "one_frame": recorded(
        (67.0, 1.655, "male"),
        str(_MARKER_SETS / "one_frame.toml"),
        (f"{_LABS}/one_frame_static/walk.c3d", None),
        f"{_LABS}/one_frame_static/static.c3d",
    ),
    "mt_feet": recorded(
        (68.0, 1.65, "female"),  # nobody tells them: by force plates and markers
        str(_MARKER_SETS / "mt_feet.toml"),
        (f"{_LABS}/mt_feet/walk.trc", f"{_LABS}/mt_feet/walk_grf.mot"),
        f"{_LABS}/mt_feet/static.trc",
    ),
}
"""People whose folders no study follows from."""
PEOPLE = (*(name for name in CLINICS if name != "multi2"), *OTHERS)
"""`multi2` is `multi` again."""
CHILDREN = ("HC002D", "HC030A", "HC031A", "HC032A")
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
    influence: Influence

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


@lru_cache(maxsize=1)
def _folder() -> tempfile.TemporaryDirectory[str]:
    """Where copies of recordings lie as long as the process does: curves are read from them again."""
    return tempfile.TemporaryDirectory()


@lru_cache(maxsize=32)
def study_of_person(name: str) -> Study:
    """All recordings of a person, drafted from the bare folder; or the study file of that path."""
    if name not in PEOPLE:
        return Study.load(name)
    folder = Path(_folder().name) / name
    folder.mkdir()
    if name in OTHERS:
        return Study.load(OTHERS[name](folder))
    person = CLINICS[name]
    words = (*person.options, *person.facts)
    told = dict(zip(words[::2], words[1::2], strict=True))
    person.copy(folder)
    options = options_of(float(told["--mass"]), float(told["--height"]), told.get("--sex"), None)
    draft = study_or_draft(folder, options, Talk(quiet=True, verbose=False))
    return Study.load(draft) if isinstance(draft, Path) else study_of(draft)


def changed(study: Study, settings: Mapping[str, object]) -> Study:
    """The study with these settings of `[calibration]`."""
    told = study.settings.model_dump(exclude_unset=True) | dict(settings)
    return replace(study, settings=type(study.settings).model_validate(told))


def only(study: Study, *names: str) -> Study:
    """The static trial and these, or trials of these roles."""
    chosen = (t for t in study.trials if t.role is Role.STATIC or t.name in names or t.role.value in names)
    return replace(study, trials=tuple(chosen))


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
    stage = joint_stage(study, nominal, silent, leave_out=False)
    if stage.joint is None:
        raise RuntimeError(f"{name}: no joint parameters were fitted")
    known = stage.joint.influence.standard_errors
    errors = np.array([known.get(jp, np.nan) for jp in JP_NAMES])
    return Fit(
        name=name,
        nominal=nominal,
        parameters=stage.parameters,
        errors=np.where(errors > 0, errors, np.nan),
        influence=stage.joint.influence,
    )
