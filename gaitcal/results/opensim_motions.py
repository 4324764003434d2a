"""The moving trials of a result as they are set beside the motions of another model."""

from pathlib import Path

import numpy as np

from gaitcal.export.opensim.motion_comparison import OurMotion
from gaitcal.export.opensim.osim_writer import safe_name
from gaitcal.io.result_folder import read_json_object
from gaitcal.results.saved_result import load_trial, moving_trials
from gaitcal.results.summary import SUMMARY, table_of
from gaitcal.study.study_trial import Role
from gaitcal.synthetic.synthetic_motion import synthetic_markers


def our_trials(folder: Path) -> list[OurMotion]:
    """Moving trials, as they are set beside another model's; isolated ones, in which one joint
    moves, only where there are no others.
    """
    out = []
    entries = table_of(read_json_object(folder / SUMMARY), "trials")
    names = moving_trials(folder)
    isolated = {name for name in names if table_of(entries, name).get("role") == Role.JOINT.value}
    for k, name in enumerate(names):
        if name in isolated and isolated != {*names}:
            continue
        cutoff = table_of(entries, name).get("bandwidth_hz")
        saved = load_trial(folder, k, name)
        q = saved.motion.basis.evaluate(saved.motion.coefficients)
        placed, labels = saved.model.markers, saved.markers.labels
        compared = [
            m for m, label in enumerate(placed.labels) if label in labels and placed.weight[m] > 0
        ]
        modelled = synthetic_markers(saved.model.parameters, placed, q)[:, compared]
        apart = (
            saved.markers.markers[:, [labels.index(placed.labels[m]) for m in compared]] - modelled
        )
        missed = np.sqrt(np.nanmean(np.sum(apart**2, axis=2), axis=0))
        trial = OurMotion(
            name=name,
            motion=saved.motion,
            markers=saved.markers,
            torques=saved.torques,
            valid=saved.valid,
            cutoff=float(cutoff) if isinstance(cutoff, int | float) else None,
            loads=folder / "forces" / f"{safe_name(name)}.xml",
            missed={placed.labels[m]: float(e) for m, e in zip(compared, missed, strict=True)},
        )
        out.append(trial)
    return out
