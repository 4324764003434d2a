"""Bones that stand on a person's palpated landmarks, so that they show where a fitted axis passes."""

from gaitcal.page.bones.bone_files import BONES, EXTRA, PACKAGE, BoneMeshes, bones_of_folder, installed_bones
from gaitcal.page.bones.bone_landmarks import KneeEvidence, PersonLandmarks, person_landmarks
from gaitcal.page.bones.knee_axis import AxisInCondyle, AxisInKnee, KneeAxis, knee_axes
from gaitcal.page.bones.placement import Landmarked, fitted_bones, landmarked

__all__ = [
    "BONES",
    "EXTRA",
    "PACKAGE",
    "BoneMeshes",
    "installed_bones",
    "bones_of_folder",
    "Landmarked",
    "landmarked",
    "PersonLandmarks",
    "KneeEvidence",
    "person_landmarks",
    "fitted_bones",
    "AxisInCondyle",
    "AxisInKnee",
    "KneeAxis",
    "knee_axes",
]
