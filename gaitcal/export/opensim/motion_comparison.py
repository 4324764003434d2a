"""Motion and joint moments of an OpenSim model in the recordings, by OpenSim's tools, next to ours.

Inverse kinematics gets the markers of the trial under the names of the model, with our weights. Its
coordinates are smoothed like our motion, so that moments do not differ by a filter. Inverse
dynamics gets our forces under the feet. A curve of the model differs from ours by

    theirs - ours = offset + residual,

with the offset the mean over the valid frames: coordinates of two models have different zeros. The
sign of a knee that bends by negative angles is reversed first.
"""

import os
import sys
import tempfile
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from gaitcal.arrays import Array, BoolArray
from gaitcal.errors import Code, InputError
from gaitcal.export.opensim.osim_correspondence import LegJoint, find_leg_joints, match_label
from gaitcal.export.opensim.osim_reader import read_osim
from gaitcal.export.opensim.peer_model import PeerModel
from gaitcal.io.opensim_files import StorageTable, read_table, write_trc
from gaitcal.io.recording import Recording
from gaitcal.model.linkage import COORDINATES, is_translation
from gaitcal.model.subject_model import SubjectModel
from gaitcal.tracking.bandwidth import Smoother
from gaitcal.tracking.motion import Motion

ACCURACY = 1e-7
"""Accuracy of inverse kinematics. With the usual 1e-5 markers are half a millimetre from the
optimum, which affects moments.
"""
ROLLS = 1e-3
"""m: a joint that leaves its nearest hinge by more is reported; markers determine it as well."""
LEAST_OFFSET_DEG = 2.0
"""deg: smaller offsets are not reported, as landmarks are not placed more accurately."""


@dataclass(frozen=True, kw_only=True)
class OurMotion:
    """One moving trial with our model."""

    name: str
    motion: Motion
    markers: Recording
    torques: Mapping[str, Array] | None
    """Coordinate -> (nf,) N·m; None without force plates."""
    valid: Mapping[str, BoolArray]
    """Side -> (nf,) frames with valid torques."""
    cutoff: float | None
    """Hz, of the low-pass filter of its motion; None without a further filter."""
    loads: Path
    """Forces under the feet, as `write_external_loads` writes them."""
    marker_errors: Mapping[str, float]
    """Label -> m RMS, distance of the marker from our model."""


@dataclass(frozen=True, kw_only=True)
class BothCurves:
    """One quantity of both models in all trials, in the valid frames."""

    coordinate: str
    unit: str  # deg or N·m
    ours: Array  # (n,)
    theirs: Array

    @property
    def offset(self) -> float:
        """Mean of theirs - ours."""
        return float(np.mean(self.theirs - self.ours))

    @property
    def residual(self) -> float:
        """RMS of theirs - ours - offset."""
        return float(np.std(self.theirs - self.ours))

    @property
    def correlation(self) -> float:
        """Correlation; NaN where a curve is constant."""
        if min(np.std(self.ours), np.std(self.theirs)) == 0.0:
            return float("nan")
        return float(np.corrcoef(self.ours, self.theirs)[0, 1])


@dataclass(frozen=True, kw_only=True)
class MotionComparison:
    """Result of the comparison."""

    curves: tuple[BothCurves, ...]
    marker_errors: tuple[float, float]
    """m RMS over the common markers: ours, theirs."""
    notes: tuple[str, ...]
    """Explanations of differences, a sentence each."""


def compare_motion(
    model: SubjectModel, osim: Path, trials: Sequence[OurMotion]
) -> MotionComparison:
    """Run OpenSim's inverse kinematics and, with forces, inverse dynamics of every trial.

    Parameters
    ----------
    model : SubjectModel
        Our model, with the weights of its markers.
    osim : Path
        OpenSim model file of the same person.
    trials : sequence of OurMotion
        Motions, torques and forces with our model.

    Returns
    -------
    MotionComparison

    Raises
    ------
    InputError
        OpenSim is not installed or cannot use the model, or model and trial share no marker.
    """
    try:
        import opensim  # type: ignore[import-untyped,import-not-found,unused-ignore]
    except ImportError:
        message = "needs OpenSim, which is not installed: pip install opensim"
        raise InputError(message, field="--motion", code=Code.ARGUMENT) from None
    # OpenSim would write opensim.log in the working directory.
    opensim.Logger.removeFileSink()
    opensim.Logger.setLevelString("Off")
    if not trials:
        raise InputError(
            "the result has no motion to compare", field="--motion", code=Code.NOTHING_TO_SHOW
        )
    peer = read_osim(osim)
    legs = find_leg_joints(peer)
    found: dict[tuple[str, str], list[tuple[Array, Array]]] = {}
    missed = []
    for trial in trials:
        with tempfile.TemporaryDirectory() as folder:
            try:
                theirs, moments, error = _run_opensim(
                    opensim, osim, peer, legs, model, trial, Path(folder)
                )
            except RuntimeError as fault:
                message = f"OpenSim cannot use it: {' '.join(str(fault).split())[:300]}"
                raise InputError(
                    message, source=osim, field=trial.name, code=Code.OTHER_MODEL
                ) from None
        # Marker errors of the markers that both models have.
        both = [
            value
            for label, value in trial.marker_errors.items()
            if match_label(label, tuple(peer.markers)) is not None
        ]
        missed.append((float(np.sqrt(np.mean(np.square(both)))), error))
        q = trial.motion.basis.evaluate(trial.motion.coefficients)
        for k, name in enumerate(COORDINATES):
            if name not in theirs or is_translation(name):
                continue
            # Models differ in whether knee flexion is positive.
            sign = _get_knee_sign(peer, name)
            found.setdefault((name, "deg"), []).append(
                (np.degrees(q[:, k]), sign * np.degrees(theirs[name]))
            )
            torques = (trial.torques or {}).get(name)
            if torques is not None and name in moments and name[-2:] in ("_r", "_l"):
                theirs_moment = sign * moments[name]
                valid = trial.valid[name[-1]] & np.isfinite(torques) & np.isfinite(theirs_moment)
                pair = torques[valid], theirs_moment[valid]
                found.setdefault((name, "N·m"), []).append(pair)
    curves = tuple(
        BothCurves(
            coordinate=name,
            unit=unit,
            ours=np.concatenate([a for a, _ in pairs]),
            theirs=np.concatenate([b for _, b in pairs]),
        )
        for (name, unit), pairs in found.items()
        if any(len(a) for a, _ in pairs)
    )
    ours, theirs_missed = (float(np.sqrt(np.mean(np.square(e)))) for e in zip(*missed, strict=True))
    return MotionComparison(
        curves=curves,
        marker_errors=(ours, theirs_missed),
        notes=tuple(_explain_differences(peer, legs, curves)),
    )


def _get_knee_sign(peer: PeerModel, name: str) -> float:
    """Get -1 for a knee that bends by negative angles, else 1."""
    if not name.startswith("knee_angle"):
        return 1.0
    joint = peer.find_joint(name)
    c = next(c for c in joint.coordinates if c.name == name) if joint is not None else None
    return -1.0 if c is not None and c.high < -c.low else 1.0


def _run_opensim(
    opensim: Any,
    osim: Path,
    peer: PeerModel,
    legs: Sequence[LegJoint],
    model: SubjectModel,
    trial: OurMotion,
    folder: Path,
) -> tuple[dict[str, Array], dict[str, Array], float]:
    """Run inverse kinematics and inverse dynamics of one trial.

    Returns coordinate -> (nf,) rad; coordinate -> (nf,) N·m, NaN without forces; and the RMS
    distance (m) of the markers.
    """
    # Labels are matched to those of the other model; other markers take no part.
    known, time = tuple(peer.markers), trial.motion.basis.time
    names = {label: match_label(label, known) for label in trial.markers.labels}
    kept = [k for k, label in enumerate(trial.markers.labels) if names[label] is not None]
    shared = replace(
        trial.markers,
        labels=tuple(str(names[trial.markers.labels[k]]) for k in kept),
        markers=trial.markers.markers[:, kept],
    )
    if not kept:
        raise InputError(
            "has no marker in common with the trial",
            source=peer.source,
            field=trial.name,
            code=Code.OTHER_MODEL,
        )
    write_trc(folder / "markers.trc", shared)
    weights = dict(zip(model.markers.labels, model.markers.weight, strict=True))
    tool, loaded = opensim.InverseKinematicsTool(), opensim.Model(str(osim.resolve()))
    tool.setModel(loaded)
    tool.set_accuracy(ACCURACY)
    tool.setMarkerDataFileName(str(folder / "markers.trc"))
    tool.setStartTime(float(time[0]))
    tool.setEndTime(float(time[-1]))
    tool.setOutputMotionFileName(str(folder / "ik.mot"))
    tool.setResultsDir(str(folder))
    # The tasks must exist until the tool has run: OpenSim copies them late.
    tasks = [opensim.IKMarkerTask() for _ in kept]
    for task, k, label in zip(tasks, kept, shared.labels, strict=True):
        weight = float(weights.get(trial.markers.labels[k], 0.0))
        task.setName(label)
        task.setWeight(weight)
        task.setApply(weight > 0)
        tool.getIKTaskSet().cloneAndAppend(task)
    with _suppress_output():
        done = tool.run()
    if not done:
        raise RuntimeError("inverse kinematics failed")
    table = read_table(folder / "ik.mot")
    error = next(folder.glob("*marker_errors.sto"), None)
    missed = float("nan")
    if error is not None:
        missed = float(np.sqrt(np.mean(read_table(error).get_column("marker_error_RMS") ** 2)))
    frames = np.column_stack([np.interp(time, table.time, column) for column in table.values.T])
    basis = trial.motion.basis
    # Their angles get the bandwidth of ours, so that moments are comparable.
    coefficients = basis.fit(frames)
    if trial.cutoff is not None:
        coefficients = Smoother(basis).smooth(basis.matrices[0].T @ frames, trial.cutoff)
    smooth = replace(table, time=time, values=basis.evaluate(coefficients))
    turning = [name for name in table.names if name in COORDINATES and not is_translation(name)]
    angles = {name: np.radians(smooth.get_column(name)) for name in turning}
    if trial.torques is None or not trial.loads.is_file():
        return angles, {}, missed
    return angles, _run_inverse_dynamics(opensim, loaded, legs, trial, folder, smooth), missed


def _run_inverse_dynamics(
    opensim: Any,
    loaded: Any,
    legs: Sequence[LegJoint],
    trial: OurMotion,
    folder: Path,
    motion: StorageTable,
) -> dict[str, Array]:
    """Run inverse dynamics: coordinate -> (nf,) N·m, NaN where there are no forces."""
    (folder / "motion.mot").write_text(motion.format_text("Coordinates"), encoding="utf-8")
    document = ET.parse(trial.loads)
    feet = {
        leg.ours[-1]: leg.theirs.child
        for leg in legs
        if leg.ours.startswith(("talocrural", "subtalar"))
    }
    for body in document.iter("applied_to_body"):
        body.text = feet.get((body.text or "")[-1], body.text)
    for file in document.iter("datafile"):
        file.text = str(trial.loads.resolve().with_name(file.text or ""))
    document.write(folder / "loads.xml")
    known = read_table(trial.loads.with_suffix(".mot")).time
    tool, excluded = opensim.InverseDynamicsTool(), opensim.ArrayStr()
    excluded.append("ALL")
    tool.setModel(loaded)
    tool.setExcludedForces(excluded)
    tool.setCoordinatesFileName(str(folder / "motion.mot"))
    tool.setExternalLoadsFileName(str(folder / "loads.xml"))
    tool.setStartTime(float(known[0]))
    tool.setEndTime(float(known[-1]))
    # Angles are smoothed already, so OpenSim must not filter them again.
    tool.setLowpassCutoffFrequency(-1.0)
    tool.setResultsDir(str(folder))
    tool.setOutputGenForceFileName("id.sto")
    with _suppress_output():
        done = tool.run()
    if not done:
        raise RuntimeError("inverse dynamics failed")
    table, time = read_table(folder / "id.sto"), motion.time
    columns = {
        name.removesuffix("_moment"): table.get_column(name)
        for name in table.names
        if name.endswith("_moment")
    }
    return {
        name: np.interp(time, table.time, c, left=np.nan, right=np.nan)
        for name, c in columns.items()
    }


@contextmanager
def _suppress_output() -> Iterator[None]:
    """Suppress what OpenSim's tools print whatever the level of their log."""
    sys.stdout.flush()
    kept = os.dup(1)
    with Path(os.devnull).open("wb") as nowhere:
        os.dup2(nowhere.fileno(), 1)
        try:
            yield
        finally:
            os.dup2(kept, 1)
            os.close(kept)


def _explain_differences(
    peer: PeerModel, legs: Sequence[LegJoint], curves: Sequence[BothCurves]
) -> Iterator[str]:
    """Explain differences by rolling knees, different zeros and locked coordinates."""
    known = {(c.coordinate, c.unit): c for c in curves}
    for leg in legs:
        found = known.get((leg.coordinate, "deg"))
        if leg.hinge is None or found is None:
            continue
        values = _get_knee_sign(peer, leg.coordinate) * np.radians(
            np.quantile(found.theirs, np.linspace(0.0, 1.0, 25))
        )
        poses = [peer.compute_joint_pose(leg.theirs, {leg.coordinate: float(v)}) for v in values]
        off = [
            pose.actInv(leg.hinge.compute_pose(leg.hinge.measure_angle(pose))).act(
                leg.theirs.in_child.translation
            )
            for pose in poses
        ]
        far = max(float(np.linalg.norm(x - leg.theirs.in_child.translation)) for x in off)
        if far > ROLLS:
            yield (
                f"{leg.theirs.name} rolls: over these angles its centre is up to {1e3 * far:.1f} "
                f"mm from the nearest hinge; 1 kN through it makes {1e3 * far:.1f} N·m of moment "
                "that a hinge does not have"
            )
    for (name, unit), curve in known.items():
        if unit == "deg" and abs(curve.offset) > max(curve.residual, LEAST_OFFSET_DEG):
            yield (
                f"{name}: mostly a constant, {curve.offset:+.1f} deg: their model has another zero"
            )
        if unit == "deg" and not np.ptp(curve.theirs):
            yield f"{name}: locked in their model, whose other coordinates compensate it"
