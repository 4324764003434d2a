"""Everything that is worked out once for a case and then serves all its draws.

The motion follows the joint parameters by  dN/dp = -H_qq^-1 H_qp,  exact where the markers fit exactly, as they do in
the undisturbed case: it starts every re-fit. Torques are linear in the dynamic parameters phi of the segments
(Pinocchio's regressor Y): inertial parameters alone change them by Y (phi - phi_0), without a re-fit.
"""

from __future__ import annotations

import numpy as np

from gaitcal.arrays import Array
from gaitcal.dynamics.inverse_dynamics import in_segment_frames, joint_regressor
from gaitcal.io.recording import Recording
from gaitcal.model.inertial_parameters import dynamic_parameters, symmetric_set
from gaitcal.model.joint_parameters import JP_INDEX
from gaitcal.model.linkage import SIDES
from gaitcal.model.subject_model import SubjectModel
from gaitcal.motion.banded import BandFactor
from gaitcal.motion.node_rule import NodeRule
from gaitcal.motion.spline import SplineBasis, spline_basis
from gaitcal.motion.trial_problem import TrialProblem, trial_problem
from gaitcal.published.case import MonteCarloCase
from gaitcal.published.leg_torques import LEG_SEGMENTS, LEG_TORQUES, LegTorques
from gaitcal.published.settings import MonteCarloSettings
from gaitcal.runtime import with_one_blas_thread
from gaitcal.synthetic.measurements import synthetic_markers


class MonteCarloContext:
    """A case made ready for draws. One for each thread: draws change the model in `legs`, and nothing else."""

    @with_one_blas_thread
    def __init__(self, case: MonteCarloCase, settings: MonteCarloSettings) -> None:
        self.case, self.settings = case, settings
        self.names = settings.parameters.names
        """Joint parameters that vary."""
        self.joint_values = case.parameters.joint[[JP_INDEX[name] for name in self.names]]
        """(np,) their undisturbed values, m and rad."""
        self.inertial_set = symmetric_set()
        self.problem = _undisturbed_problem(case)
        """The undisturbed motion fits its markers exactly."""
        self.basis, self.data = self.problem.basis, self.problem.data
        q = self.basis.evaluate(case.nodes)
        constants = self.problem.constants(case.parameters)
        band = self.problem.equations(case.nodes, constants).band
        self.undisturbed_factor = BandFactor(band)
        """Of the Gauss-Newton matrix at the undisturbed motion, with the undisturbed linkage."""
        self.undisturbed_diagonal = band[:, 0].reshape(case.nodes.shape).copy()
        """(nn, nq) of the same matrix, m^2 per m^2 or rad^2."""
        self.sensitivity = _sensitivity(self.problem, case, self.names)
        """(nn, nq, np) change of the nodes by the joint parameters that vary; zero where these move no marker."""
        self.regressor = _regressor(case, self.basis)
        """(nf * 14, 120) N·m by the dynamic parameters of the massive segments, in their own frames."""
        self.legs = LegTorques(case.parameters)
        leg_constants = self.legs.disturb(case.parameters)
        self.feet = self.legs.feet(leg_constants, q)
        self.torques, _ = self.legs.torques(leg_constants, self.basis, case.nodes, case.wrench, self.feet)
        """(nf, 14) N·m of the undisturbed case."""
        segments = np.array([self.problem.chain.segments[s] for s in self.data.segment])
        pulling = self.data.weight.any(axis=1)
        self.leg_markers = tuple(
            np.flatnonzero(np.isin(segments, [s for s in LEG_SEGMENTS if s.endswith(f"_{side}")]) & pulling)
            for side in SIDES
        )
        """Markers of the right and of the left leg: indices into the order of `data`."""

    def inertial_change(self, inertial: Array) -> Array:
        """(nf, 14) N·m that other inertial parameters (84,) add to the undisturbed torques."""
        change = dynamic_parameters(inertial) - dynamic_parameters(self.case.parameters.inertial)
        out: Array = (self.regressor @ change.ravel()).reshape(-1, len(LEG_TORQUES))
        return out


def _undisturbed_problem(case: MonteCarloCase) -> TrialProblem:
    """The model's own markers in its own motion, as if they had been measured, in the case's spline space."""
    model = SubjectModel(
        subject=case.subject, parameters=case.parameters, nominal=case.parameters, markers=case.markers
    )
    q = spline_basis(case.time, len(case.nodes)).evaluate(case.nodes)
    markers = synthetic_markers(case.parameters, case.markers, q)
    recording = Recording(source=case.name, time=case.time, labels=case.markers.labels, markers=markers)
    return trial_problem(case.name, model, recording, NodeRule(fixed=len(case.nodes)))


def _sensitivity(problem: TrialProblem, case: MonteCarloCase, names: tuple[str, ...]) -> Array:
    """(nn, nq, np) dN/dp of the equation above."""
    opened = problem.with_free(names)
    equations = opened.equations(case.nodes, opened.constants(case.parameters))
    solved = -BandFactor(equations.band).solve(equations.mixed)
    passed = [names.index(name) for name in opened.chain.free]
    out = np.zeros((*case.nodes.shape, len(names)))
    out[:, :, passed] = solved.reshape(*case.nodes.shape, len(passed))
    return out


def _regressor(case: MonteCarloCase, basis: SplineBasis) -> Array:
    """(nf * 14, 120) Y of the equation above: of Pinocchio's bodies, then told in the frames of our segments."""
    legs = LegTorques(case.parameters)
    states = (basis.evaluate(case.nodes, k) for k in range(3))
    rows = in_segment_frames(legs.linkage, joint_regressor(legs.linkage, legs.rows, *states))
    return rows.reshape(len(case.time) * len(LEG_TORQUES), -1)
