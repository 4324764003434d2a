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

Names are loaded when they are first used, so that `import gaitcal` is quick; `__init__.pyi` beside this file says where
each of them lives.
"""

import lazy_loader

__getattr__, __dir__, _ = lazy_loader.attach_stub(__name__, __file__)

__all__ = [
    "Study",
    "calibrate",
    "Calibration",
    "parameter_table",
    "write_results",
    "cycles",
    "read_cycles",
    "cycles_to_xarray",
    "ensemble",
    "spatiotemporal",
    "compare_results",
    "read_normal_bands",
    "synthesize",
    "read_recording",
    "Recording",
    "track",
    "Motion",
    "ground_reactions",
    "GroundReactions",
    "inverse_dynamics",
    "Moments",
    "joint_kinetics",
    "JointKinetics",
    "power_of",
    "component_of",
    "Convention",
    "Signs",
    "Acting",
    "MomentFrame",
    "MomentUnit",
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
    "view",
    "GaitcalError",
    "InputError",
    "ConvergenceError",
]
