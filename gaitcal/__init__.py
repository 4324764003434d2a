"""gaitcal: fits a full-body linkage model to one person's motion capture and says how far to trust the result.

    import gaitcal as gc

    study = gc.Study.load("study.toml")
    calibration = gc.calibrate(study)           # models, motions, torques, errors
    print(gc.parameter_table(calibration))      # where the joints lie, and how sure
    gc.write_results(calibration, "result")     # report, view, tables, models
    walk = calibration.trial("walk")            # a trial, before and after
    motion = gc.track(calibration.model, gc.read_recording("walk2.c3d"))

Units are m, kg, s, N, N·m and rad throughout; axes x forward, y up, z to the right, in every segment and in the
laboratory. Arrays over frames have the frame first. `COORDINATES` names the 27 columns of every array of coordinates,
velocities, accelerations and generalised forces: three pelvis translations (m, N), then rotations (rad, N·m).
Faults of the input are an `InputError` of one line.

Names are loaded when they are first used, so that `import gaitcal` is quick.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from gaitcal.dynamics.ground_contact import GroundReactions
    from gaitcal.dynamics.ground_reactions import ground_reactions
    from gaitcal.dynamics.inverse_dynamics import Moments, inverse_dynamics
    from gaitcal.errors import ConvergenceError, GaitcalError, InputError
    from gaitcal.model.build import build_model
    from gaitcal.model.linkage import COORDINATES
    from gaitcal.model.marker_set import MarkerSet, load_marker_set
    from gaitcal.model.model_file import load_model, save_model
    from gaitcal.model.nominal import nominal_model, published_model
    from gaitcal.model.parameters import Parameters
    from gaitcal.model.subject_model import Subject, SubjectModel
    from gaitcal.montecarlo.study import monte_carlo
    from gaitcal.motion.motion import Motion, track
    from gaitcal.person.calibrate import calibrate
    from gaitcal.person.result import Calibration
    from gaitcal.person.tables import parameter_table
    from gaitcal.recording import Recording, read_recording
    from gaitcal.results.calibration import write_results
    from gaitcal.study.study import Study
    from gaitcal.synthetic.subject import synthesize

_HOME = {
    "COORDINATES": "gaitcal.model.linkage",
    "Calibration": "gaitcal.person.result",
    "ConvergenceError": "gaitcal.errors",
    "GaitcalError": "gaitcal.errors",
    "GroundReactions": "gaitcal.dynamics.ground_contact",
    "InputError": "gaitcal.errors",
    "MarkerSet": "gaitcal.model.marker_set",
    "Moments": "gaitcal.dynamics.inverse_dynamics",
    "Motion": "gaitcal.motion.motion",
    "Parameters": "gaitcal.model.parameters",
    "Recording": "gaitcal.recording",
    "Study": "gaitcal.study.study",
    "Subject": "gaitcal.model.subject_model",
    "SubjectModel": "gaitcal.model.subject_model",
    "build_model": "gaitcal.model.build",
    "calibrate": "gaitcal.person.calibrate",
    "ground_reactions": "gaitcal.dynamics.ground_reactions",
    "inverse_dynamics": "gaitcal.dynamics.inverse_dynamics",
    "load_marker_set": "gaitcal.model.marker_set",
    "load_model": "gaitcal.model.model_file",
    "monte_carlo": "gaitcal.montecarlo.study",
    "nominal_model": "gaitcal.model.nominal",
    "parameter_table": "gaitcal.person.tables",
    "published_model": "gaitcal.model.nominal",
    "read_recording": "gaitcal.recording",
    "save_model": "gaitcal.model.model_file",
    "synthesize": "gaitcal.synthetic.subject",
    "track": "gaitcal.motion.motion",
    "write_results": "gaitcal.results.calibration",
}

__all__ = [
    "Study",
    "calibrate",
    "Calibration",
    "parameter_table",
    "write_results",
    "synthesize",
    "read_recording",
    "Recording",
    "track",
    "Motion",
    "ground_reactions",
    "GroundReactions",
    "inverse_dynamics",
    "Moments",
    "COORDINATES",
    "Subject",
    "SubjectModel",
    "Parameters",
    "nominal_model",
    "published_model",
    "load_model",
    "save_model",
    "build_model",
    "MarkerSet",
    "load_marker_set",
    "monte_carlo",
    "GaitcalError",
    "InputError",
    "ConvergenceError",
]


def __getattr__(name: str) -> object:
    if name not in _HOME:
        raise AttributeError(f"module 'gaitcal' has no attribute '{name}'")
    value: object = getattr(importlib.import_module(_HOME[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *_HOME})
