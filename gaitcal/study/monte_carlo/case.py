"""The undisturbed case: a model in motion with its ground reactions, small enough to travel with every task.

The draws disturb it: its own markers, without noise, are what each disturbed model is fitted to, and its own torques
are what each disturbed torque is compared with.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gaitcal.data_files import models_path
from gaitcal.errors import InputError, nearest
from gaitcal.model.nominal import published_model
from gaitcal.model.parameters import Parameters
from gaitcal.model.subject_model import MarkerPlacement, Subject
from gaitcal.study.result import Calibration
from gaitcal.study.synthetic_data import ground_reactions
from gaitcal.study.synthetic_motion import gait_motion

Array = NDArray[np.float64]
BoolArray = NDArray[np.bool_]


@dataclass(frozen=True)
class MonteCarloCase:
    """A model, its motion and the ground reactions on its feet."""

    name: str
    subject: Subject
    parameters: Parameters
    markers: MarkerPlacement
    time: Array
    """(nf,) s."""
    nodes: Array
    """(nn, 27) m, rad: quintic splines on clamped uniform knots over `time`."""
    wrench: Array
    """(nf, 2, 6) N, N·m about the laboratory origin, on the right and left foot."""
    valid: BoolArray
    """(nf,) frames whose torques count."""

    def fingerprint(self) -> Mapping[str, str]:
        """SHA-256 of each part: two cases with the same fingerprint give the same draws."""
        s, p, m = self.subject, self.parameters, self.markers
        return {
            "subject": _hash([repr((s.mass, s.height)).encode()]),
            "joint parameters": _hash([p.joint.tobytes(), p.zero_angles.tobytes()]),
            "inertial parameters": _hash([p.inertial.tobytes()]),
            "markers": _hash([repr((m.labels, m.segments)).encode(), m.local.tobytes(), m.weight.tobytes()]),
            "motion": _hash([self.time.tobytes(), np.ascontiguousarray(self.nodes).tobytes()]),
            "ground reactions": _hash([np.ascontiguousarray(self.wrench).tobytes(), self.valid.tobytes()]),
        }


def _hash(parts: Iterable[bytes]) -> str:
    digest = hashlib.sha256()
    for part in parts:
        digest.update(len(part).to_bytes(8, "little") + part)
    return digest.hexdigest()


def nominal_case() -> MonteCarloCase:
    """The built-in subject of the reproduction: one gait cycle, 208 frames, ground reactions without residual."""
    gait = json.loads((models_path() / "nominal_subject.json").read_text(encoding="utf-8"))["nominal_gait"]
    model, motion = published_model(), gait_motion()
    return MonteCarloCase(
        "nominal subject",
        model.subject,
        model.parameters,
        model.markers,
        motion.basis.time,
        motion.nodes,
        ground_reactions(model.parameters, motion, gait["cycle_s"]),
        np.ones(len(motion.basis.time), dtype=bool),
    )


def case_of(calibration: Calibration, trial: str | None = None) -> MonteCarloCase:
    """A calibrated person in one gait trial: the first with valid ground reactions, or the one named.

    Raises
    ------
    InputError
        No such trial, or none with a frame in which every foot on the ground is on a force plate.
    """
    loaded = {t.name: t for t in calibration.trials if t.loads is not None and t.loads.reactions.valid.any()}
    chosen = loaded[chosen_trial(tuple(loaded), trial, calibration.study.source)]
    reactions = chosen.loads.reactions if chosen.loads is not None else None
    if reactions is None:
        raise InputError("found no ground reactions", source=calibration.study.source)
    model, errors = calibration.model, chosen.body.errors
    return MonteCarloCase(
        chosen.name,
        model.subject,
        model.parameters,
        tracked_markers(model.markers, tuple(np.array(errors.labels)[errors.kept()].tolist())),
        chosen.body.time,
        chosen.body.nodes,
        reactions.wrench,
        reactions.valid,
    )


def chosen_trial(loaded: tuple[str, ...], wanted: str | None, source: object) -> str:
    """The trial to study, among those with valid ground reactions."""
    if not loaded:
        raise InputError(
            "found no gait trial with ground reactions under every foot; a Monte Carlo study of torques needs one",
            source=source,
        )
    if wanted is not None and wanted not in loaded:
        raise InputError(
            f"found '{wanted}'; allowed: {', '.join(loaded)}{nearest(wanted, loaded)}", source=source, field="--trial"
        )
    return wanted or loaded[0]


def tracked_markers(markers: MarkerPlacement, labels: tuple[str, ...]) -> MarkerPlacement:
    """Those markers of a model that a trial really had."""
    kept = [i for i, label in enumerate(markers.labels) if label in labels]
    return MarkerPlacement(
        tuple(markers.labels[i] for i in kept),
        tuple(markers.segments[i] for i in kept),
        markers.local[kept],
        markers.weight[kept],
    )
