"""gaitcal: fits a full-body linkage model to one person's motion capture and says how far to trust
the result.

    import gaitcal as gc

    # a folder of recordings
    calibration = gc.run_study("session", "result", mass=72.6, height=1.80, sex="male")
    print(calibration)                              # verdict, parameters, trials
    print(gc.parameter_table(calibration))          # where the joints are, with standard errors
    angles = calibration.trial("walk").body.to_dataframe()
    further = gc.analyse_trial("result", "walk2.c3d")       # torques with error bars, verdict

    study = gc.Study.load("study.toml")             # the same step by step
    print(gc.check_study(study))
    calibration = gc.calibrate(study)
    gc.write_results(calibration, "result")
    motion = gc.track(calibration.model, gc.read_recording("walk2.c3d"))

Units are m, kg, s, N, N·m and rad throughout; axes x forward, y up, z to the right, in every
segment and in the laboratory. Arrays over frames have the frame first. `COORDINATES` names the 27
columns of every array of coordinates, velocities, accelerations and generalised forces: three
pelvis translations (m, N), then rotations (rad, N·m). Faults of the input are an `InputError` of
one line.

Names are loaded when they are first used, so that `import gaitcal` is quick; `__init__.pyi` beside
this file says where each of them lives.
"""

import lazy_loader

__getattr__, __dir__, _ = lazy_loader.attach_stub(__name__, __file__)

__all__ = [
    "run_study",
    "Study",
    "check_study",
    "calibrate",
    "Calibration",
    "parameter_table",
    "write_results",
    "analyse_trial",
    "FurtherTrials",
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
