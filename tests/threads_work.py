"""What the package computes, as a program whose BLAS may use some threads: prints hashes of every
result's bits.

    python -m tests.threads_work THREADS[,THREADS...] FOLDER

All is computed once for each number of threads, which is set as a user's own program would have it,
after the libraries are loaded: OPENBLAS_NUM_THREADS would be cut to the cores of the machine.
FOLDER holds a study.
"""

import hashlib
import json
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import scipy.linalg  # noqa: F401  # brings a BLAS of its own, whose threads are set below, too
from threadpoolctl import threadpool_limits

import gaitcal as gc
from gaitcal.montecarlo.case import make_nominal_case
from gaitcal.montecarlo.draw import COLUMNS, MonteCarloContext, draw
from gaitcal.montecarlo.protocol import MonteCarloSettings, Plan, Varied
from gaitcal.montecarlo.workers import LocalProcesses, Workers
from gaitcal.reproduction.recovery import recover_noisy_draw
from gaitcal.synthetic.synthetic_motion import compute_residual_free_wrench, simulate_gait
from tests.synthetic_studies import made_recording

PLAN = Plan(levels=(50,), draws=1)


def results(study: Path) -> Iterator[tuple[str, bytes]]:
    """Names of entry points, and the bits of what they return. `A: B` and `A: C` must have the
    same.
    """
    model, walk = gc.published_model(), simulate_gait()
    motion = gc.track(model, made_recording(walk))
    yield "track", motion.q.tobytes()
    wrench = compute_residual_free_wrench(model.parameters, walk)
    yield "inverse_dynamics", gc.inverse_dynamics(model, motion, wrench).tau.tobytes()
    yield "joint_kinetics", np.array(gc.joint_kinetics(model, motion, wrench).power).tobytes()

    case = make_nominal_case()
    for name, workers in (("here", Workers()), ("processes", LocalProcesses(2))):
        draws = gc.monte_carlo(case, plan=PLAN, workers=workers, chunk_draws=1).draws
        yield f"monte_carlo: {name}", draws[list(COLUMNS)].to_numpy().tobytes()
    settings = MonteCarloSettings()
    noise = draws[draws["set"] == Varied.NOISE.value]
    yield (
        "a draw: of the study",
        np.ascontiguousarray(noise[list(COLUMNS)].iloc[0], float).tobytes(),
    )
    yield (
        "a draw: alone",
        draw(MonteCarloContext(case, settings), Varied.NOISE, 50, 0).values.tobytes(),
    )
    joints = recover_noisy_draw(0, 0, random_seeds=1).joints
    yield (
        "noisy_draw",
        np.concatenate([joint.coefficients.ravel() for joint in joints.values()]).tobytes(),
    )

    found = gc.calibrate(gc.Study.load(study))
    yield (
        "calibrate",
        found.model.parameters.joint.tobytes() + found.model.parameters.inertial.tobytes(),
    )
    yield "cycles", gc.cycles(found).to_csv().encode()


if __name__ == "__main__":
    told = {}
    for count in map(int, sys.argv[1].split(",")):
        with threadpool_limits(count, user_api="blas"):
            told[count] = {
                name: hashlib.sha256(bits).hexdigest() for name, bits in results(Path(sys.argv[2]))
            }
    sys.stdout.write(json.dumps(told))
