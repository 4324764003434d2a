"""What every file of a result folder is, for the documentation; tests hold it against folders that were written.

A pattern is a path below the folder, with `*` for the name of a trial, a side or a person. Columns of the tables among
them are in `described_columns`.

What every column of every table is, for the documentation; tests hold it against tables that were written.

A column's name may have `*` for a coordinate, a joint, a torque or a marker.
"""

from __future__ import annotations

from dataclasses import dataclass
from fnmatch import fnmatchcase
from typing import Final

from gaitcal.gait.spatiotemporal import MEASURES


@dataclass(frozen=True, kw_only=True)
class ResultFile:
    """One file, or those of one name in each trial."""

    pattern: str
    """As `motion/*.csv`."""
    text: str
    table: str = ""
    """Key of `described_columns.TABLES`; empty for what is no table."""


def _file(pattern: str, text: str, table: str = "") -> ResultFile:
    return ResultFile(pattern=pattern, text=text, table=table)


_MANIFEST: Final = _file(
    "manifest.json",
    "kind of result, versions, settings, SHA-256 of every input as it was read, the files and the SHA-256 of each",
)
_TRIALS: Final = (
    _file("motion/*.mot", "coordinates for OpenSim, degrees and m"),
    _file("motion/*.csv", "coordinates with velocities, accelerations and standard errors", "motion"),
    _file("moments/*.sto", "generalised forces for OpenSim"),
    _file("moments/*.csv", "joint torques with standard errors, and where they count", "moments"),
    _file("powers/*.csv", "powers of joints and of single coordinates, with standard errors", "powers"),
    _file("moment_vectors/*.csv", "joint torques as vectors along the axes of segments", "moment_vectors"),
    _file("marker_errors/*.csv", "distance of every marker in every frame, mm", "marker_errors"),
    _file("markers/*.trc", "the markers that were followed, for OpenSim's tools"),
    _file("forces/*.mot", "the ground reactions that were used, for OpenSim's tools"),
    _file("forces/*.xml", "ExternalLoads beside it: which force acts on which foot"),
    _file("cycles.csv", "every stride of each foot, 0 to 100 %: angles, torques, powers, ground reaction", "cycles"),
    _file("ensemble.csv", "mean curves over straight strides and trials", "ensemble"),
    _file("spatiotemporal.csv", "speed, lengths, times of every stride, also of cut ones", "spatiotemporal"),
    _file("result.html", "the page: body in motion, curves and tables in one offline file"),
    _file("page.json", "the page's curves and tables; `gaitcal view` and `gaitcal figures` read it"),
    _file("scene.npz", "the page's body; `gaitcal view` reads it"),
    _MANIFEST,
)
_MODELS: Final = (
    _file("model.osim", "the same mechanical system for OpenSim 4"),
    _file("model.urdf", "the same for ROS and Pinocchio"),
    _file("model.xml", "the same for MuJoCo"),
)

FILES: Final[dict[str, tuple[ResultFile, ...]]] = {
    "calibration": (
        _file("summary.json", "verdict and reasons, fit of every trial and segment, residuals, phases", "summary"),
        _file("parameters.csv", "every joint and inertial parameter: nominal, fitted, error, status", "parameters"),
        *_TRIALS,
        _file("model.toml", "the model, loaded by `gaitcal.load_model`"),
        _file("marker_set.toml", "the marker set with the study's weights; further trials are read with it"),
        *_MODELS,
        _file("study.toml", "of a calibrated folder: the study that was drafted, to be changed and run again"),
        _file("splines.npz", "the motions themselves; Monte Carlo studies start there"),
        _file("uncertainty.npz", "covariances, for error bars of further trials"),
        _file("report.html", "leads to `result.html`, for one release"),
        _file("view.html", "leads to `result.html`, for one release"),
        _file("truth/parameters.csv", "of a made-up person: true parameters beside fitted ones", "truth_parameters"),
        _file("truth/*_motion.csv", "of a made-up person: true coordinates and the errors", "truth_curves"),
        _file("truth/*_moments.csv", "of a made-up person: true torques and the errors", "truth_curves"),
    ),
    "dynamics": (_file("summary.json", "verdict, fit and residuals of the further trials", "summary"), *_TRIALS),
    "montecarlo": (
        _file("montecarlo.csv", "distributions of torque and marker errors", "montecarlo"),
        _file("contributions.csv", "which parameter makes how much of them", "contributions"),
        _file("draws/*.parquet", "every draw, in chunks that a later run goes on from"),
        _file("figures/*", "boxplots and ranked contributions"),
        _file("settings.json", "what the draws depend on; a run with others begins anew"),
    ),
    "export": (
        *_MODELS,
        _file("cycles.csv", "the strides in the convention that was asked for", "export_cycles"),
        _file("dynamics_cycles.csv", "the same of further trials", "export_cycles"),
        _file("*.c3d", "each walk's recording with angles, moments, powers, joint centres and events added"),
        _MANIFEST,
    ),
    "figures": (
        _file("*.svg", "a drawing, text as text"),
        _file("*.pdf", "the same for LaTeX and printers"),
        _file("*.png", "the same as pixels, 300 dpi"),
    ),
    "synthetic": (
        _file("study.toml", "the study, ready to be calibrated; its `[truth]` names the files below"),
        _file("*.c3d", "recordings: standing, each joint by itself, a walk over force plates"),
        _file("truth.csv", "the true joint and inertial parameters", "truth_values"),
        _file("truth/static_landmarks.csv", "true landmarks of the static trial", "landmarks"),
        _file("truth/*_motion.csv", "true coordinates", "truth_curves"),
        _file("truth/*_moments.csv", "true torques", "truth_curves"),
        _MANIFEST,
    ),
    "example": (
        _file("SOURCE.txt", "whose the recordings are: addresses, licence, how to cite, SHA-256"),
        _file("study.toml", "a study of them, ready to be calibrated"),
        _MANIFEST,
        _file("*.*", "the recordings, as they were published"),
    ),
    "cohort": (
        _file("cohort.html", "the page of all: triage, table, distributions, mean curves by group"),
        _file("people.csv", "one row for each session of each person", "people"),
        _file("people.parquet", "the same, with types"),
        _file("cycles.parquet", "every stride of everyone, columns as in `cycles.csv`"),
        _file("columns.csv", "name, unit and meaning of each column of `people.csv`", "column_meanings"),
        _file("failures.csv", "who failed, why, and what to do", "failures"),
        _file("times.csv", "seconds and memory of each session", "times"),
        _file("priors.json", "with `--learn-priors`: what joint parameters to expect, for `--priors`"),
        _file("priors.csv", "the same as a table", "priors"),
        _file("people/*", "each session's result folder, as `gaitcal calibrate` writes it"),
        _file("state/*", "what is done already; the next run reads it"),
        _MANIFEST,
    ),
    "comparison": (
        _file("comparison.txt", "what differs, in words"),
        _file("differences.csv", "every figure of both sessions, largest difference first", "differences"),
        _file("curve_differences.csv", "mean curves of both sessions, at every per cent", "curve_differences"),
        _file("shared_parameters.csv", "with `--shared-model`: joint parameters alone and shared", "shared_parameters"),
        _MANIFEST,
    ),
    "reproduction": (
        _file("tables.csv", "every printed figure with ours beside it", "reproduced_tables"),
        _file("claims.csv", "claims put to the test", "claims"),
        _file("draws.csv", "the figures behind the medians"),
        _file("times.csv", "seconds of each problem beside the published ones"),
        _file("montecarlo.csv", "with `--draws`: distributions of torque errors of disturbed models"),
        _file("iterations.csv", "errors after 0 to 30 iterations of the re-fit"),
        _file("trial_length.csv", "what the length of the isolated trials changes"),
        _file("*.csv", "what the paper leaves open, tried out"),
        _file("README.txt", "how to read these tables"),
        _file("montecarlo/*", "the draws, as a Monte Carlo study keeps them"),
        _MANIFEST,
    ),
}
"""Kind of folder -> its files."""

SUMMARY: Final = {
    "status": "`converged`, or which phase was not",
    "verdict": "`trustworthy`, `doubtful` or `refused`",
    "reasons": "why: cause, evidence, action, trials, leg, topic, severity; the worst first",
    "warnings": "what else should be looked at",
    "notes": "what was assumed and found out, each in a line",
    "trials": "each trial: role, verdict of each leg, fit, bandwidth, events, valid frames, residuals, error sources",
    "spatiotemporal": "mean, SD and symmetry of speed, lengths and times over valid straight strides",
    "static_angles_deg": "joint angles of the static trial",
    "phases": "each phase: trials, number of parameters, iterations, seconds, status, noise that it found",
    "truth": "of a made-up person: RMS errors, and how often ±1.96 standard errors hold the truth",
    "hold_out": "with `--hold-out`: marker error on blocks of time that were left out",
}
"""Keys of `summary.json`."""


def file_of(kind: str, name: str) -> ResultFile | None:
    """What is said of a file (`motion/walk.csv`) of a kind of folder; None where nothing is."""
    return next((file for file in FILES[kind] if fnmatchcase(name, file.pattern)), None)


@dataclass(frozen=True)
class Described:
    """One column, or those of one pattern."""

    name: str
    unit: str
    text: str


def _columns(*rows: tuple[str, str, str]) -> tuple[Described, ...]:
    return tuple(Described(*row) for row in rows)


_TIME: Final = ("time", "s", "of the recording")
_VALID: Final = (
    ("valid", "0 or 1", "both legs count and a plate carries the body: pelvis, trunk and arms may be used"),
    ("valid_r", "0 or 1", "the right leg's values may be used"),
    ("valid_l", "0 or 1", "the left leg's values may be used"),
)
_WHO: Final = (
    ("person", "", "name in the study file"),
    ("session", "", "day or label in the study file; empty where there is none"),
)
_STRIDE: Final = (
    *_WHO,
    ("trial", "", "name of the walk"),
    ("side", "r or l", "foot whose stride it is"),
    ("stride", "", "number within trial and side; empty where the recording holds a part of the stride alone"),
)
_CYCLE: Final = (
    *_STRIDE,
    ("percent", "%", "0 at the strike of that foot, 100 at its next one"),
    ("variable", "", "what the value is; below"),
    ("value", "by variable", ""),
    ("se", "as the value", "standard error; empty where unknown"),
    ("valid", "0 or 1", "the value may be used"),
    ("se_stride", "as the value", "the part of `se` that differs from stride to stride"),
    ("turn", "deg", "how far the pelvis turns over the stride, to the left"),
)
_DIFFERENCE: Final = (
    ("difference", "unit", "b - a"),
    ("se", "unit", "standard error of the difference"),
    ("mdc95", "unit", "minimal detectable change, 1.96 standard errors"),
    ("exceeds", "0 or 1", "the difference is more than that"),
    ("strides_a", "", "strides of the first session"),
    ("strides_b", "", "strides of the second session"),
)

TABLES: Final[dict[str, tuple[Described, ...]]] = {
    "parameters": _columns(
        ("name", "", "as `hip_r.pelvis.ant` or `thigh_r.mass`"),
        ("kind", "", "joint position, joint orientation, mass, mass centre, moment of inertia"),
        ("segment", "", "segment that it lies in"),
        ("joint", "", "joint that it belongs to; empty for inertial parameters"),
        ("unit", "", "unit of the next three"),
        ("nominal", "unit", "from landmarks and anthropometric tables"),
        ("fitted", "unit", "after calibration"),
        ("standard_error", "unit", "empty where it was not fitted"),
        ("status", "", "`fitted`, `fixed` or `unidentifiable`"),
    ),
    "motion": _columns(
        _TIME,
        ("*_velocity", "deg/s, m/s", "exact derivative of the spline"),
        ("*_acceleration", "deg/s², m/s²", "exact second derivative"),
        ("*_se", "deg, m", "standard error, in gait trials"),
        ("*", "deg; pelvis_tx, _ty, _tz: m", "a coordinate"),
    ),
    "moments": _columns(
        _TIME,
        *_VALID,
        ("*_se", "N·m", "standard error; empty where unknown or not valid"),
        ("*_bwh", "%", "of body weight times height"),
        ("*", "N·m; pelvis_tx, _ty, _tz: N", "internal net torque about a coordinate; of the pelvis: the residual"),
    ),
    "powers": _columns(
        _TIME,
        *_VALID,
        ("*_se", "W", "standard error, of torque and velocity together"),
        ("*_per_kg", "W/kg", "by body mass"),
        ("*", "W", "power of a joint (`hip_power_r`) or of a coordinate (`hip_flexion_power_r`); generated: positive"),
    ),
    "moment_vectors": _columns(
        _TIME,
        *_VALID,
        ("*_se_stride", "N·m", "the part of the standard error that differs from stride to stride"),
        ("*_se", "N·m", "standard error"),
        ("*_proximal", "N·m", "along an axis of the proximal segment (ISB)"),
        ("*_distal", "N·m", "along an axis of the distal segment (ISB)"),
        ("*_jcs", "N·m", "projected on an axis of the joint coordinate system (Grood and Suntay 1983)"),
    ),
    "marker_errors": _columns(_TIME, ("*", "mm", "distance between measured and model marker; empty: not seen")),
    "cycles": _columns(*_CYCLE),
    "export_cycles": _columns(
        *_CYCLE, ("unit", "", "of the value"), ("positive", "", "what a positive value of this variable means")
    ),
    "ensemble": _columns(
        *_WHO,
        ("side", "r or l", "foot whose strides they are"),
        ("variable", "", "as in `cycles.csv`"),
        ("percent", "%", "of the stride"),
        ("n", "", "strides"),
        ("trials", "", "trials that they come from"),
        ("mean", "by variable", ""),
        ("sd", "by variable", "standard deviation over strides"),
        ("sd_within", "by variable", "between strides of a trial; empty where no trial has two"),
        ("sd_between", "by variable", "between trials"),
        ("sd_error", "by variable", "what of `sd` is measurement error, at most"),
        ("se", "by variable", "standard error of the mean, with the errors that all strides share"),
    ),
    "spatiotemporal": _columns(
        *_STRIDE,
        ("start", "s", "strike that begins it"),
        ("stop", "s", "strike that ends it"),
        ("source", "", "what told the events: file, plates or motion"),
        ("variable", "", ", ".join(f"`{name}`" for name in MEASURES)),
        ("unit", "", "of the value"),
        ("value", "unit", ""),
        ("valid", "0 or 1", "0 of a leg that is refused, and of steps and supports beside one"),
        ("turn", "deg", "how far the pelvis turns over the stride, to the left"),
    ),
    "montecarlo": _columns(
        ("set", "", "what was disturbed: `jp`, `ip`, `both`, `noise`"),
        ("level", "%", "of the bounds"),
        ("quantity", "", "torque, or markers"),
        ("grf", "", "ground reactions fixed in the laboratory (`lab`) or on the foot (`foot`)"),
        ("measure", "", "`rms`, `max` and others of the error over the frames"),
        ("unit", "", "of the distribution"),
        ("draws", "", "that count"),
        ("failed", "", "that did not converge, and are left out"),
        ("average", "unit", "mean over draws"),
        ("sd", "unit", "standard deviation over draws"),
        ("p*", "unit", "percentiles 10, 25, 50, 75, 90"),
        ("mean_settles", "%", "how much the mean still changes over the last draws"),
        ("cv_settles", "%", "the same of the coefficient of variation"),
    ),
    "contributions": _columns(
        ("torque", "", "which"),
        ("grf", "", "as in `montecarlo.csv`"),
        ("parameter", "", "as in `parameters.csv`"),
        ("kind", "", "joint position, joint orientation, mass, ..."),
        ("rms", "%BW·H", "torque error that this parameter alone makes, linearised"),
        ("share", "%", "of the variance"),
    ),
    "truth_parameters": _columns(
        ("name", "", "as in `parameters.csv`"),
        ("kind", "", "as there"),
        ("unit", "", "of the figures"),
        ("truth", "unit", "what the made-up person has"),
        ("nominal", "unit", "before calibration"),
        ("fitted", "unit", "after it"),
        ("standard_error", "unit", ""),
        ("error", "unit", "fitted minus truth"),
        ("z", "", "error in standard errors"),
        ("status", "", "as in `parameters.csv`"),
    ),
    "truth_curves": _columns(
        _TIME,
        ("*_error", "as the value", "calibrated minus true"),
        ("*_velocity", "deg/s, m/s", "true velocity"),
        ("*_acceleration", "deg/s², m/s²", "true acceleration"),
        ("*_bwh", "%", "of body weight times height"),
        ("*", "deg, m; torques N·m", "true value of a coordinate or torque"),
    ),
    "truth_values": _columns(
        ("name", "", "as in `parameters.csv`"), ("unit", "", "mm, deg, kg, ..."), ("value", "unit", "the truth")
    ),
    "landmarks": _columns(("name", "", "landmark"), ("[xyz]", "m", "in the laboratory, y up")),
    "column_meanings": _columns(("column", "", "its name"), ("unit", "", ""), ("meaning", "", "")),
    "failures": _columns(
        *_WHO,
        ("group", "", "as told in `people.csv` or `cohort.toml`"),
        ("folder", "", "with the recordings"),
        ("code", "", "code of the fault; `gaitcal explain CODE` tells more"),
        ("cause", "", "what is wrong"),
        ("what_to_do", "", "about it"),
    ),
    "times": _columns(
        *_WHO, ("seconds", "s", "of the calibration"), ("worker_mebibytes", "MiB", "most memory of the process so far")
    ),
    "priors": _columns(
        ("name", "", "joint parameter, as in `parameters.csv`"),
        ("unit", "", "mm or deg"),
        ("mean", "unit", "expected difference from the nominal value"),
        ("sd", "unit", "standard deviation of people about it"),
        ("default_sd", "unit", "standard deviation without a cohort"),
        ("learnt", "", "what of them was learnt, and what was not"),
    ),
    "differences": _columns(
        ("kind", "", "angle, moment, power, step, joint position, ..."),
        ("side", "r or l", ""),
        ("name", "", "variable, measure or joint parameter"),
        ("measure", "", "largest, smallest, range or mean, and in which phase"),
        ("unit", "", "of the figures"),
        ("a", "unit", "first session"),
        ("b", "unit", "second session"),
        *_DIFFERENCE,
        ("times", "", "absolute difference over `mdc95`"),
        ("se_strides", "unit", "by how strides vary"),
        ("se_shared", "unit", "by errors that all strides of a session share"),
    ),
    "curve_differences": _columns(
        ("kind", "", "angle, moment, power or force"),
        ("side", "r or l", "foot whose strides they are"),
        ("variable", "", "as in `cycles.csv`"),
        ("percent", "%", "of the stride"),
        ("unit", "", "of the figures"),
        ("a", "unit", "mean of the first session"),
        ("b", "unit", "mean of the second session"),
        *_DIFFERENCE,
    ),
    "shared_parameters": _columns(
        ("name", "", "joint parameter, as in `parameters.csv`"),
        ("unit", "", "mm or deg"),
        ("[ab]_alone", "unit", "of each session, by its own trials alone"),
        ("[ab]_shared", "unit", "of each session, by the trials of both"),
        ("*_se", "unit", "standard error"),
    ),
    "reproduced_tables": _columns(
        ("table", "", "of the paper"),
        ("row", "", ""),
        ("column", "", ""),
        ("published", "unit", "as printed"),
        ("ours", "unit", "in this run"),
        ("unit", "", ""),
        ("note", "", "range over draws, and where the printed figure lies"),
    ),
    "claims": _columns(
        ("kind", "", "`paper`, or `sensitivity`: ours, on what the paper does not say"),
        ("claim", "", "in words"),
        ("published", "", "the figure it stands on"),
        ("ours", "", "in this run"),
        ("verdict", "", "holds, does not hold, undecided, not run or not testable"),
    ),
}
"""Key of a table -> its columns, in order; the first pattern that fits a name is its own."""


def column_of(table: str, name: str) -> Described | None:
    """What is said of a column; None where nothing is."""
    return next((column for column in TABLES[table] if fnmatchcase(name, column.name)), None)
