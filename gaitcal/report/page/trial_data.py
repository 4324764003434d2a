"""Page data of one trial: curves, events, strides, verdict, sections.

As in the files of a result: angles in degrees, internal moments in N·m with OpenSim's signs, powers
in W, forces in N. The page converts them to the convention that its reader chooses.
"""

from collections.abc import Mapping
from pathlib import PureWindowsPath
from typing import Any

import numpy as np

from gaitcal.analysis import result, truth_errors
from gaitcal.arrays import Array, BoolArray
from gaitcal.gait import moments, spatiotemporal
from gaitcal.gait.cycles import describe_sources, find_valid_percents, normalise
from gaitcal.model.coordinates import FOOT_PROGRESSION
from gaitcal.model.linkage import PELVIS_ANGLES
from gaitcal.model.subject_model import SubjectModel
from gaitcal.quality.verdict import WalkVerdict
from gaitcal.report.page import key_figures, scene, trust_sections
from gaitcal.report.page.plain_data import (
    Sections,
    encode_base64,
    pack_floats,
    pack_lengths,
    round_number,
)
from gaitcal.results import trial_tables
from gaitcal.results.stride_tables import StrideTables
from gaitcal.results.trial_curves import Curve, collect_pelvis_parts, compute_line, find_joint


def pack_curves(curves: tuple[Curve, ...], every: int) -> dict[str, Any]:
    """Pack one frame in `every` of the curves; `valid` is a number of the shared `masks`."""
    kept = slice(None, None, every)
    masks = list_masks(curves)
    # Many curves are valid in the same frames: each mask is stored once.
    numbers = {mask.tobytes(): number for number, mask in enumerate(masks)}

    def pack(values: Array | None) -> dict[str, Any] | None:
        return (
            None if values is None or not np.isfinite(values).any() else pack_lengths(values[kept])
        )

    of_curves = [
        {
            "base": c.base,
            "side": c.side,
            "joint": find_joint(c.base),
            "kind": c.kind,
            "unit": c.unit,
            "valid": numbers[c.valid.tobytes()],
            "value": pack_lengths(c.value[kept]),
            "se": pack(c.error),
            "own": pack(c.stride_error),
            "nominal": pack(c.nominal),
            "truth": pack(c.truth),
        }
        for c in curves
    ]
    return {
        "curves": of_curves,
        "masks": [encode_base64(mask[kept].astype("<u1")) for mask in masks],
    }


def list_masks(curves: tuple[Curve, ...]) -> list[BoolArray]:
    """List the different `valid` of the curves, in the order of `masks` of `pack_curves`."""
    return list({c.valid.tobytes(): c.valid for c in curves}.values())


def build_trial_page_data(
    model: SubjectModel,
    trial: result.TrialResult,
    tables: StrideTables,
    *,
    verdict: WalkVerdict | None,
    relative: bool = False,
    truth: truth_errors.CurveTruths | None = None,
) -> dict[str, Any]:
    """Build the page data of a trial; numbers are packed as in `plain_data.py`.

    Parameters
    ----------
    model
        The calibrated subject.
    trial
        One trial.
    tables
        Curves and strides of this trial, among others.
    verdict
        None for a trial without a verdict.
    relative
        Whether joint angles are relative to the static posture.
    truth
        Declared true curves; None if unknown.

    Returns
    -------
    dict
        Its entry in `trials` of `page.json`.
    """
    time, start = trial.body.time, float(trial.body.time[0])
    every = max(1, -(-len(time) // scene.MOST_FRAMES))
    curves = tables.curves[trial.name]
    return {
        "name": trial.name,
        "file": PureWindowsPath(trial.recording.source).name,
        "role": moments.describe_role(trial.role, trial.joint),
        "joint": trial.joint,
        "activity": trial.activity,
        "repeats": bool(trial.events.repeats),
        "verdict": None
        if verdict is None
        else {
            "judgement": verdict.judgement.value,
            **{side: judgement.value for side, judgement in verdict.legs.items()},
        },
        "start": start,
        "duration": float(time[-1] - time[0]),
        "frames": len(time),
        "every": every,
        "time": pack_floats((time - time[0])[::every]),
        **pack_curves(curves, every),
        "events": [
            {
                "side": e.side,
                "kind": e.moment.value,
                "time": e.time - start,
                "source": describe_sources([e.source]),
            }
            for e in trial.events.events
        ],
        "strides": _build_strides(trial, collect_pelvis_parts(trial, truth), tables),
        "measures": _list_measures(trial),
        "line": compute_line(trial),
        "relative": relative,
        "sections": build_trial_sections(model, trial),
    }


def _list_measures(trial: result.TrialResult) -> list[dict[str, Any]]:
    """List valid measures of strides, also of those that are only partly recorded."""
    out = []
    for stride in spatiotemporal.select_straight_strides(trial.strides, trial.refused_legs):
        values = {name: float(value) for name, value in stride.measures.items()}
        out.append({"side": stride.side, "number": stride.number, "values": values})
    return out


def build_trial_sections(model: SubjectModel, trial: result.TrialResult) -> Sections:
    """Build the sections of one trial without empty presets."""
    sections = {"fit": trust_sections.build_trial_fit_blocks(trial)}
    if (walk := key_figures.compute_gait_numbers(model, trial)) is not None:
        sections |= {
            "clinician": key_figures.build_trial_clinician_blocks(walk),
            "trust": trust_sections.build_trial_trust_blocks(model, walk),
        }
    return {preset: blocks for preset, blocks in sections.items() if blocks}


def _build_strides(
    trial: result.TrialResult, pelvis: Mapping[str, Array], tables: StrideTables
) -> list[dict[str, Any]]:
    """Build the complete strides of both feet, s from the begin of the trial.

    Each has its number, pelvis angles (`pelvis`: of `collect_pelvis_parts`, along the line of that
    stride), valid percents of each mask of the curves as in `cycles.csv`, and peaks.
    """
    time, start = trial.body.time, float(trial.body.time[0])
    measured = {(s.side, s.number): s for s in trial.strides}
    masks = list_masks(tables.curves[trial.name])
    out = []
    for use in tables.get_uses(trial.name):
        side, cycle, stride = use.side, use.cycle, measured.get((use.side, use.number))
        foot = trial_tables.express_foot_in_stride(trial, side, cycle, stride)
        # Pelvis and foot angles depend on the stride's line of progression: curves for each stride.
        along_line: dict[str, dict[str, Any]] = {name: {} for name in PELVIS_ANGLES}
        for part, angles in pelvis.items():
            in_stride = trial_tables.express_pelvis_in_stride(trial, angles, cycle, stride)
            for name, values in zip(
                PELVIS_ANGLES, normalise(time, in_stride, cycle).T, strict=True
            ):
                along_line[name][part] = pack_lengths(values)
        if foot is not None:
            along_line[FOOT_PROGRESSION] = {"value": pack_lengths(normalise(time, foot, cycle))}
        found = tables.peaks_of_strides[trial.name, side, use.number]
        out.append(
            {
                "side": side,
                "number": use.number,
                "start": cycle.start - start,
                "stop": cycle.stop - start,
                "off": None if cycle.toe_off is None else cycle.toe_off - start,
                "turns": use.turns,
                "plate": use.plate,
                "reason": use.reason,
                "pelvis": along_line,
                "valid": [
                    encode_base64(find_valid_percents(time, m, cycle).astype("<u1")) for m in masks
                ],
                "peaks": {name: list(map(round_number, peak)) for name, peak in found.items()},
            }
        )
    return out
