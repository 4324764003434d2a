"""Load the moving trials of a result for a comparison with the motions of another model."""

from pathlib import Path

import numpy as np

from gaitcal.arrays import compute_rms
from gaitcal.export.opensim.motion_comparison import OurMotion
from gaitcal.export.opensim.osim_writer import encode_name
from gaitcal.io.result_folder import read_json_object
from gaitcal.results.saved_result import list_moving_trials, load_trial
from gaitcal.results.summary import SUMMARY, get_table
from gaitcal.study.study_trial import Role
from gaitcal.synthetic.synthetic_motion import compute_synthetic_markers


def load_compared_trials(folder: Path) -> list[OurMotion]:
    """Load the moving trials for a comparison with another model.

    Parameters
    ----------
    folder
        A result folder.

    Returns
    -------
    list of OurMotion
        Functional (single-joint) trials are included only if there are no others.
    """
    out = []
    entries = get_table(read_json_object(folder / SUMMARY), "trials")
    names = list_moving_trials(folder)
    isolated = {name for name in names if get_table(entries, name).get("role") == Role.JOINT.value}
    for k, name in enumerate(names):
        # Functional trials count only where there is no walk.
        if name in isolated and isolated != {*names}:
            continue
        cutoff = get_table(entries, name).get("bandwidth_hz")
        saved = load_trial(folder, k, name)
        q = saved.motion.basis.evaluate(saved.motion.coefficients)
        placed, labels = saved.model.markers, saved.markers.labels
        compared = [
            m for m, label in enumerate(placed.labels) if label in labels and placed.weight[m] > 0
        ]
        # Both positions are in the axes of the result, m.
        modelled = compute_synthetic_markers(saved.model.parameters, placed, q)[:, compared]
        differences = (
            saved.markers.markers[:, [labels.index(placed.labels[m]) for m in compared]] - modelled
        )
        rms = compute_rms(np.linalg.norm(differences, axis=2), axis=0)
        trial = OurMotion(
            name=name,
            motion=saved.motion,
            markers=saved.markers,
            torques=saved.torques,
            valid=saved.valid,
            cutoff=float(cutoff) if isinstance(cutoff, int | float) else None,
            loads=folder / "forces" / f"{encode_name(name)}.xml",
            marker_errors={placed.labels[m]: float(e) for m, e in zip(compared, rms, strict=True)},
        )
        out.append(trial)
    return out
