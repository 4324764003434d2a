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
from gaitcal.errors import InputError
from gaitcal.model.parameters import Parameters, published_subject
from gaitcal.model.subject_model import MarkerPlacement, Subject
from gaitcal.study.result import Calibration
from gaitcal.study.synthetic_data import ground_reactions
from gaitcal.study.synthetic_motion import gait_motion

Array = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

LEG_SEGMENTS = ("thigh", "shank", "talus", "foot")


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
    data = json.loads((models_path() / "nominal_subject.json").read_text(encoding="utf-8"))
    parameters, motion = published_subject(), gait_motion()
    time = motion.basis.time
    return MonteCarloCase(
        "nominal subject",
        Subject("nominal subject", data["subject"]["mass_kg"], data["subject"]["height_m"], data["subject"]["sex"]),
        parameters,
        _published_markers(data),
        time,
        motion.nodes,
        ground_reactions(parameters, motion, data["nominal_gait"]["cycle_s"]),
        np.ones(len(time), dtype=bool),
    )
