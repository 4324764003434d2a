"""What every file of a result folder is, for the documentation; tests hold it against folders that were written.

A pattern is a path below the folder, with `*` for the name of a trial, a side or a person. Columns of the tables among
them are in `described_columns`.
"""

from __future__ import annotations

from dataclasses import dataclass
from fnmatch import fnmatchcase
from typing import Final


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
