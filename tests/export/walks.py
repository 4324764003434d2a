"""Calibrated people as the result folder holds them: what their files are to say in other programs."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gaitcal.model.subject_model import SubjectModel
from gaitcal.results.calibration import write_results
from gaitcal.session.calibrate import calibrate
from gaitcal.study.study import Study
from gaitcal.synthetic.motion import synthetic_markers
from tests.export.mechanics import State

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Walk:
    """One walk of a calibrated person, and the folder that `gaitcal calibrate` writes."""

    folder: Path
    model: SubjectModel
    """With the markers that the walk has, in the order of `measured`."""
    time: Array
    """(nf,) s."""
    states: tuple[State, ...]
    """Our q, v, a and ground reactions, every frame."""
    tau: Array
    """(nf, 27) N·m, N: our generalised forces, as reported."""
    markers: Array
    """(nf, nm, 3) m: our model's markers."""
    measured: Array
    """(nf, nm, 3) m."""


def calibrated_walk(study: Path, out: Path) -> Walk:
    """Calibrate the study file's person and write the result folder `out`; the trial must be called `walk`."""
    calibration = calibrate(Study.load(study))
    write_results(calibration, out)
    walk = calibration.trial("walk")
    body, wrenches = walk.body, walk.loads.reactions.wrench
    q, v, a = body.q, body.velocity, body.acceleration
    placed, seen = calibration.model.markers, walk.recording.labels
    kept = [k for k, label in enumerate(placed.labels) if label in seen]
    model = replace(
        calibration.model,
        markers=replace(
            placed,
            labels=tuple(placed.labels[k] for k in kept),
            segments=tuple(placed.segments[k] for k in kept),
            local=placed.local[kept],
            weight=placed.weight[kept],
        ),
    )
    return Walk(
        out,
        model,
        body.time,
        tuple(State(*frame) for frame in zip(q, v, a, wrenches, strict=True)),
        walk.loads.final.tau,
        synthetic_markers(model.parameters, model.markers, q),
        walk.recording.markers[:, [seen.index(label) for label in model.markers.labels]],
    )
