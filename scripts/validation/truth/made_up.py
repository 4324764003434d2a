"""Parts `synthetic` and `recovery`: people of our own linkage, through files, with a user's
settings.

Wrong in every joint and inertial parameter by up to 10 mm, 10 deg and 10 %, with the published
marker noise, written as C3D files (`gaitcal synthesize --noise --perturb`), read and calibrated as
any other study.

Part `recovery`: how near the truth the main job comes, joint by joint, and whether its error bars
hold, with gaitcal's defaults, every one (`default`), these with the gait trial alone (`gait-only`):
what a user has; or, as in part `synthetic`, told that plates and axes are exact (`exact`), which no
user knows. Printed: RMS error of joint parameters before (nominal) and after, median over people,
of all that a trial may move. Those that the result declares undetermined stay nominal, and count:
how many is told, and the error without them. And how often 68 % and 95 % intervals cover the truth:
joint parameters by joint (those with an interval), inertial parameters by kind, joint torques,
powers and moment vectors in valid frames. A person takes half a minute, with `gait-only` less.

Part `published`: how often 68 % and 95 % intervals cover the truth, over many draws of the
published noise.

The published subject walks (34 joint parameters free) and moves its knee alone (9 free); every draw
adds marker noise as published (one sinusoid a marker coordinate, amplitude up to 10 mm), fits the
joint parameters, and compares them, and the coordinates, torques, powers and moment vectors that
follow in the gait trial, with the truth. Wanted: 60 to 76 %, and 91 to 98 %; of the knee trial the
latter alone. It moves with one frequency and hears only waves near that, in most draws none: its
error bars are right in the mean square (errors are 0.91 of them over 40 draws), not draw by draw.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from enum import Enum
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

import gaitcal
from gaitcal import COORDINATES, Calibration, Study
from gaitcal.arrays import Array
from gaitcal.calibration.error_sources import (
    ErrorSources,
    compute_coordinate_errors,
    compute_motion_sensitivity,
)
from gaitcal.calibration.joint_estimate import JointEstimate, JointSettings, estimate_joints
from gaitcal.calibration.torque_errors import ForceErrors
from gaitcal.dynamics.inverse_dynamics import Dynamics
from gaitcal.dynamics.joint_kinetics import (
    COMPONENTS,
    POWER_JOINTS,
    POWERS,
    VECTOR_FRAMES,
    compute_kinetic_values,
)
from gaitcal.io.recording import Recording
from gaitcal.model.linkage import REACTIONS, SEGMENTS, list_joint_segments
from gaitcal.model.nominal import published_model
from gaitcal.model.parameters import (
    JP_INDEX,
    Parameters,
    list_gait_parameters,
    list_isolated_parameters,
)
from gaitcal.study.study_trial import Role
from gaitcal.synthetic.subject import make_true_gait, synthesize
from gaitcal.synthetic.synthetic_motion import (
    NODES,
    compute_residual_free_wrench,
    compute_synthetic_markers,
    draw_marker_noise,
    simulate_gait,
    simulate_isolated_trial,
)
from gaitcal.tracking.spline import ControlPointRule
from gaitcal.tracking.trial_problem import MotionProblem, build_trial_problem
from scripts.validation.harness import bars, rms, shares, side_by_side
from scripts.validation.truth.people import with_settings
from scripts.validation.truth.report import Figure, Outcome, TimedFit, timed_fit

WANTED = {"68 %": (60.0, 76.0), "95 %": (91.0, 98.0)}
"""Interval -> what is wanted of its coverage, %."""
ENDS = 20
"""Frames at either end of the gait trial whose torques are not valid: ends of the splines."""
HEARS_FEW_WAVES = "knee trial, 9 joint parameters"
EVERY = 8
"""Torques are looked at in every eighth frame; neighbours say the same."""
Draw = dict[str, Array]
"""Quantity -> errors in units of their standard errors."""


def gait_draw(seed: int, noise_m: float) -> Draw:
    """One walk with 34 joint parameters free: these, and in frames (nf,) the 23 joint torques and
    knee reactions, 28 joint powers, 63 components of moment vectors and 27 coordinates.
    """
    motion, truth = simulate_gait(), published_model().parameters
    problem = noisy_problem(motion.q, motion.basis.time, seed, noise_m)
    fit, influence = estimated(
        problem, truth, tuple(name for side in "rl" for name in list_gait_parameters(side))
    )
    wrench = compute_residual_free_wrench(truth, motion)
    moves = compute_motion_sensitivity(problem, fit.coefficients[0], fit.parameters, influence)
    spread = ForceErrors(
        problem, fit.coefficients[0], fit.parameters, wrench, influence, None, moves
    ).compute_errors()
    if spread.kinetics is None:
        raise RuntimeError("no standard errors of powers")
    found = [problem.basis.evaluate(fit.coefficients[0], k) for k in range(3)]
    moved = [motion.basis.evaluate(motion.coefficients, k) for k in range(3)]
    fitted, true = (
        (Dynamics(p).compute_forces(*q, wrench), *compute_kinetic_values(p, *q, wrench))
        for p, q in ((fit.parameters, found), (truth, moved))
    )
    errors = (spread.all_forces, spread.kinetics.power, spread.kinetics.moment)
    inner = slice(ENDS, -ENDS, EVERY)
    torques, powers, vectors = (
        ((f - t) / e)[inner] for f, t, e in zip(fitted, true, errors, strict=True)
    )
    return {
        "gait, 34 joint parameters": _standardised(fit, truth, influence),
        "gait, joint torques": torques[:, 6:],
        "gait, joint powers": powers,
        "gait, moment vectors": vectors.reshape(len(vectors), -1),
        "gait, coordinates": ((found[0] - motion.q) / compute_coordinate_errors(problem, moves))[
            inner
        ],
    }


def knee_draw(seed: int, noise_m: float) -> Draw:
    truth, motion = published_model().parameters, simulate_isolated_trial("knee_r")
    problem = noisy_problem(
        motion.q, motion.basis.time, seed, noise_m, list_joint_segments("knee_r")
    )
    fit, influence = estimated(problem, truth, list_isolated_parameters("knee_r"))
    return {HEARS_FEW_WAVES: _standardised(fit, truth, influence)}


def noisy_problem(
    q: Array, time: Array, seed: int, noise_m: float, segments: tuple[str, ...] = SEGMENTS
) -> MotionProblem:
    """Markers of a motion with noise, as a least-squares problem of 20 nodes."""
    model = published_model()
    markers = compute_synthetic_markers(model.parameters, model.markers, q)
    markers += draw_marker_noise(time, markers.shape[1], np.random.default_rng(seed), noise_m)
    recording = Recording(source="made up", time=time, labels=model.markers.labels, markers=markers)
    return build_trial_problem(
        "trial",
        model,
        recording,
        ControlPointRule(fixed=NODES),
        root=segments[0],
        segments=segments,
    )


def estimated(
    problem: MotionProblem, truth: Parameters, free: tuple[str, ...]
) -> tuple[JointEstimate, ErrorSources]:
    """As the published protocol has it: nothing is expected, markers stay in their places."""
    return estimate_joints({"trial": (problem,)}, truth, free, JointSettings())


def _standardised(fit: JointEstimate, truth: Parameters, influence: ErrorSources) -> Array:
    errors, pairs = influence.standard_errors, zip(fit.free, fit.values, strict=True)
    return np.array([(v - truth.joint[JP_INDEX[n]]) / errors[n] for n, v in pairs])


def draws(count: int, noise_m: float, seed: int, processes: int) -> Draw:
    """Quantity -> errors in standard errors, draws first."""
    seeds = [int(s.generate_state(1)[0]) for s in np.random.SeedSequence(seed).spawn(count)]
    out: Draw = {}
    for draw in (gait_draw, knee_draw):
        found = list(side_by_side([partial(draw, s, noise_m) for s in seeds], processes))
        out |= {name: np.stack([d[name] for d in found]) for name in found[0]}
    return out


def published_lines(found: Draw) -> Iterator[str]:
    """One line a quantity, and whether as many intervals hold as is wanted."""
    yield f"{'quantity':34}" + "".join(f"{level:>8}" for level in WANTED) + "   wanted"
    for name, values in found.items():
        covered = dict(zip(WANTED, shares(values), strict=True))
        levels = ["95 %"] if name == HEARS_FEW_WAVES else list(WANTED)
        inside = all(WANTED[level][0] <= covered[level] <= WANTED[level][1] for level in levels)
        yield (
            f"{name:34}"
            + "".join(f"{c:8.1f}" for c in covered.values())
            + ("   yes" if inside else "   no")
        )


JOINTS = ("hip", "knee", "talocrural", "subtalar")
JOINT_KINDS = {"joint position": "mm", "joint orientation": "deg"}
INERTIAL_KINDS = {"mass": "kg", "mass centre": "mm", "moment of inertia": "kg*mm^2"}
TORQUES = (*COORDINATES[6:], *REACTIONS)
UNDETERMINED = "unidentifiable"
"""Status of a parameter that the trials do not show."""
LEG = ("hip", "knee", "ankle", "subtalar")
"""How the names of a leg's torques begin; the knee's adduction is one of them."""


class Settings(Enum):
    DEFAULT = "default"
    """gaitcal's own, every one: what a user has who declares nothing."""
    GAIT_ONLY = "gait-only"
    """The same, and no isolated trials."""
    EXACT = "exact"
    """gaitcal's own, but told what is true of these data: plates are exact, and so are the
    segments' axes, as the truth is told in those that the static trial makes. The fitted joints are
    those of `default`, the error bars narrower."""


@dataclass(frozen=True)
class SyntheticPerson:
    parameters: pd.DataFrame
    """By name: kind, joint, status, errors of the nominal and fitted values, `z` in standard
    errors. Those that the fit kept, as its trials do not show them, are among them: their error is
    the nominal one's, and they have no `z`."""
    gaps: Array
    """(n, 23) N·m, errors of joint torques and knee reactions, valid frames."""
    before: Array
    """(n, 23) N·m, the same with the nominal model."""
    errors: Array
    """(n, 23) N·m, standard errors of the torques."""
    powers: tuple[Array, Array]
    """(n, 28) W each: errors of joint powers, valid frames, and their standard errors."""
    vectors: tuple[Array, Array]
    """(n, 63) N·m each: the same of the components of moment vectors."""
    fit: TimedFit

    @property
    def torques(self) -> Array:
        return self.gaps / self.errors


def synthetic_person(
    seed: int, settings: Settings, changes: Mapping[str, object] | None = None
) -> SyntheticPerson:
    with tempfile.TemporaryDirectory() as folder:
        file = synthesize(Path(folder) / "study", seed=seed, noise=True, perturb=True)
        study = Study.load(file)
        if settings is Settings.EXACT:
            study = with_settings(study, {"segment_axes": "exact"} | dict(changes or {}))
        else:
            study = replace(
                study, settings=type(study.settings).model_validate(dict(changes or {}))
            )
        if settings is Settings.GAIT_ONLY:
            study = replace(
                study, trials=tuple(t for t in study.trials if t.role is not Role.JOINT)
            )
        fit = timed_fit(study)
    if fit.calibration.truth is None:
        raise SystemExit(f"--set: {fit.calibration.notes[-1]}")
    truth = pd.Series({p.name: p.truth for p in fit.calibration.truth.parameters})
    table = gaitcal.parameter_table(fit.calibration).set_index("name")
    inertial = ~table["kind"].str.startswith(
        "joint"
    )  # nominal ones count, too: their error bar is people's spread
    known = (table["status"] == "fitted") | (inertial & (table["standard_error"] > 0))
    table = table[known | (table["status"] == UNDETERMINED)]
    true = truth.loc[table.index]
    table = table.assign(before=table["nominal"] - true, after=table["fitted"] - true)
    z = (table["after"] / table["standard_error"]).where(known.loc[table.index])
    table = table.assign(z=z, joint=table.index.str.split("_").str[0])
    return SyntheticPerson(parameters=table, fit=fit, **gait_errors(fit.calibration, seed))


def gait_errors(calibration: Calibration, seed: int) -> dict[str, Any]:
    """What a `SyntheticPerson` holds of the gait trial's torques, powers and moment vectors."""
    parameters, motion = make_true_gait(seed)
    loads = calibration.trial("gait").loads
    if (
        loads is None
        or loads.kinetics is None
        or loads.errors is None
        or loads.errors.kinetics is None
    ):
        raise RuntimeError("the gait trial has no torques and powers with standard errors")
    state, wrench = (
        [motion.basis.evaluate(motion.coefficients, k) for k in range(3)],
        compute_residual_free_wrench(parameters, motion),
    )
    true = Dynamics(parameters).compute_forces(*state, wrench)
    power, moment = compute_kinetic_values(parameters, *state, wrench)
    valid, spread = loads.reactions.valid, loads.errors.kinetics
    final, nominal = (
        np.hstack([m.tau, m.knee_adduction]) - true for m in (loads.final, loads.nominal)
    )
    vectors = [
        of[valid].reshape(int(valid.sum()), -1)
        for of in (loads.kinetics.moment - moment, spread.moment)
    ]
    return {
        "gaps": final[valid][:, 6:],
        "before": nominal[valid][:, 6:],
        "errors": loads.errors.all_forces[valid][:, 6:],
        "powers": ((loads.kinetics.power - power)[valid], spread.power[valid]),
        "vectors": (vectors[0], vectors[1]),
    }


def outcome(seed: int, changes: Mapping[str, object]) -> Outcome:
    """Part `synthetic`: one person with gaitcal's defaults, but for these, plates and axes, which
    are exact here.
    """
    person = synthetic_person(seed, Settings.EXACT, changes)
    figures = torque_figures(person) | parameter_figures(person.parameters.dropna(subset="z"))
    return person.fit.outcome("synthetic", "waves", f"synthetic {seed}", seed, figures)


def torque_figures(person: SyntheticPerson) -> dict[str, Figure]:
    """The legs' torques together, all of them, and each joint's, both sides."""
    groups: dict[str, list[int]] = {}
    for k, name in enumerate(TORQUES):
        groups.setdefault(name.removesuffix("_r").removesuffix("_l"), []).append(k)

    def figure(columns: list[int]) -> Figure:
        gaps, errors = person.gaps[:, columns], person.errors[:, columns]
        return Figure(
            error=rms(gaps), before=rms(person.before[:, columns]), bars=bars(gaps, errors)
        )

    legs = [k for name, columns in groups.items() if name.startswith(LEG) for k in columns]
    out = {
        "torques of legs, N·m": figure(legs),
        "torques of all, N·m": figure(list(range(len(TORQUES)))),
    }
    return out | {f"torque {name}, N·m": figure(columns) for name, columns in groups.items()}


def parameter_figures(table: pd.DataFrame) -> dict[str, Figure]:
    out = {}
    groups = [
        (f"{j} {kind.split()[1]}, {u}", kind, j) for j in JOINTS for kind, u in JOINT_KINDS.items()
    ]
    groups += [(f"{kind}, {unit}", kind, "") for kind, unit in INERTIAL_KINDS.items()]
    for name, kind, joint in groups:
        rows = table[(table["kind"] == kind) & ((table["joint"] == joint) if joint else True)]
        if len(rows):
            after, error = rows["after"].to_numpy(float), rows["standard_error"].to_numpy(float)
            out[name] = Figure(
                error=rms(after), before=rms(rows["before"]), bars=bars(after, error)
            )
    return out


def coverage(z: np.ndarray) -> str:
    """Share of errors within each interval, %."""
    return "  ".join(
        f"{share:5.1f} in {name}" for share, name in zip(shares(z), ("68 %", "95 %"), strict=True)
    )


def median_errors(rows: list[pd.DataFrame]) -> tuple[float, float]:
    """RMS error of the nominal and of the fitted values of each person, and its median
    over them.
    """
    before, after = np.median(
        [[rms(r[when]) for when in ("before", "after")] for r in rows], axis=0
    )
    return float(before), float(after)


def undetermined(rows: list[pd.DataFrame]) -> str:
    """How many of these parameters are declared undetermined, and the errors without them."""
    count = sum(int((r["status"] == UNDETERMINED).sum()) for r in rows)
    others = [r for r in (r[r["status"] != UNDETERMINED] for r in rows) if len(r)]
    if not count or not others:
        return f", {count} undetermined" if count else ""
    before, after = median_errors(others)
    return f", and {count} undetermined; without them {before:.2f} -> {after:.2f}"


def lines(people: list[SyntheticPerson]) -> Iterator[str]:
    yield "joint parameters: RMS error, nominal -> calibrated (median over people), and coverage"
    for joint in JOINTS:
        for kind, unit in JOINT_KINDS.items():
            rows = [
                p.parameters[(p.parameters["kind"] == kind) & (p.parameters["joint"] == joint)]
                for p in people
            ]
            rows = [r for r in rows if len(r)]
            if not rows:
                continue
            before, after = median_errors(rows)
            z = pd.concat([r["z"] for r in rows]).dropna().to_numpy()
            told = f"({len(z)} values{undetermined(rows)})"
            yield (
                f"{joint:11}{kind.split()[1]:13}{before:6.2f} ->{after:6.2f} {unit:4}{coverage(z)} "
                f" {told}"
            )
    yield "inertial parameters: coverage"
    for kind in INERTIAL_KINDS:
        z = pd.concat([p.parameters[p.parameters["kind"] == kind]["z"] for p in people]).to_numpy()
        yield f"{kind:39}{coverage(z)}  ({len(z)} values)"
    yield "joint torques of valid frames: coverage"
    z = np.concatenate([p.torques for p in people])
    yield f"{'all':39}{coverage(z)}"
    for name, column in zip(TORQUES, z.T, strict=True):
        yield f"{name:39}{coverage(column)}"
    joints = dict.fromkeys(name.removesuffix("_r").removesuffix("_l") for name in POWER_JOINTS)
    powers = {
        j: [k for k, name in enumerate(POWERS) if name in (j, f"{j}_r", f"{j}_l")] for j in joints
    }
    width = len(COMPONENTS)
    vectors = {
        frame.key: list(range(k * width, (k + 1) * width)) for k, frame in enumerate(VECTOR_FRAMES)
    }
    for words, of, groups in (
        ("joint powers of valid frames: RMS error, W, and coverage", "powers", powers),
        ("moments as vectors, legs and back: RMS error, N·m, and coverage", "vectors", vectors),
    ):
        yield words
        gaps, errors = (np.concatenate([getattr(p, of)[k] for p in people]) for k in range(2))
        for name, own in groups.items():
            yield f"{name:31}{rms(gaps[:, own]):6.2f}  {coverage(gaps[:, own] / errors[:, own])}"
