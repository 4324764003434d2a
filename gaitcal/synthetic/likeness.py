"""A person in the posture of another: the motion in which the markers of one come nearest to those of the other.

The same angles about other axes make another body: bow-legged, or standing on the edge of a foot. A person whose axes
lie elsewhere in the same body looks, standing and walking, as the nominal one does.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gaitcal.arrays import Array
from gaitcal.io.recording import Recording
from gaitcal.model.nominal import published_model
from gaitcal.model.parameters import Parameters
from gaitcal.motion.motion import tracked_motion
from gaitcal.motion.spline import NodeRule, SplineBasis, spline_basis
from gaitcal.motion.trial_problem import trial_problem
from gaitcal.synthetic.measurements import synthetic_markers

ON_THE_FLOOR = 4.0
"""Weight of the feet's markers: legs of unequal length stand on one floor all the same."""


def is_nominal(parameters: Parameters) -> bool:
    """Whether all joint parameters are those of the nominal person."""
    return bool(np.array_equal(parameters.joint, published_model().parameters.joint))


def looking_like_nominal(parameters: Parameters, basis: SplineBasis, q: Array) -> Array:
    """(nn, nq) nodes of the motion in which a person's markers are nearest to the nominal person's at q (nf, nq)."""
    nominal = published_model(static_only=True)
    seen = synthetic_markers(nominal.parameters, nominal.markers, q)
    recording = Recording(source="nominal", time=basis.time, labels=nominal.markers.labels, markers=seen)
    weight = np.where([s.startswith("foot") for s in nominal.markers.segments], ON_THE_FLOOR, 1.0)
    person = replace(nominal, parameters=parameters, markers=replace(nominal.markers, weight=weight))
    problem = trial_problem("nominal", person, recording, NodeRule(fixed=basis.nodes))
    nodes: Array = tracked_motion(problem, parameters).nodes
    return nodes


def posture_like_nominal(parameters: Parameters, q: Array) -> Array:
    """(nq,) the posture in which a person's markers are nearest to the nominal person's at q (nq,)."""
    if is_nominal(parameters):
        return q
    basis = spline_basis(np.arange(12) / 200.0, 6)
    still = np.tile(q, (len(basis.time), 1))
    mean: Array = basis.evaluate(looking_like_nominal(parameters, basis, still)).mean(axis=0)
    return mean
