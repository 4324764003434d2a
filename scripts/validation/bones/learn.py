"""What tracked bones show of skin: the numbers of `models/soft_tissue.json`, derived anew.

    bones --learn FILE [--folder DIR]

Per recording the displacement of the markers against the bone is taken apart into the shift of
their middle, the turn of the cluster and what is left in axes that turn with it; put together as
for small turns, these are d(t), and are fitted by the knee's flexion from the static posture,
phi(t) in rad: b = sum phi d / sum phi^2. What is left, r, moves with hips, ankles and contacts,
which here go with the knee as they like: so b is off by up to rms(r) / rms(phi), counted as one
sample, for the cluster's shift, its turn, and each marker by itself. The slopes of all markers are

    b = s (Phi beta + B (u_person + u_recording) + e_own) + noise,        beta ~ N(0, ridge^2),

Phi the functions of a marker's place (`calibration/soft_tissue_table.py`), B shifts and turns of
the cluster. Half of the variance of u belongs to the person, half to the recording: two tasks of
one person differ about as much as two people do. s, how soft a recording is (ln s ~ N(0, 0.7^2)),
is the likeliest by how the markers deform, in turn with the others: a calibration observes no more
of it, and a thigh that sags on a chair without deforming adds to the scatter among people. The
standard deviations of shift, turn, own and ridge are at the maximum of the marginal likelihood,
with priors that know them to a factor of two; beta is then Gaussian. What is written are roots of
E[size^2] by the curvature there, as few people tell these sizes. A person is who shares sex, height
and reference with another file: one person may have several names. With another person the skin
does Phi beta, with errors of beta, and of shift, turn and own in full.

Printed beside it: for each recording with its person left out, how far its cluster shifts and turns
from what is expected, in its standard deviations; the same for an artefact without a mean, as large
as it is likeliest; and what the knee's angle does not explain, beside the sizes in use for the
others.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.linalg import cho_factor, cho_solve, null_space
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from gaitcal.arrays import Array
from gaitcal.calibration.soft_tissue_artefact import GAIT, SIZES
from gaitcal.calibration.soft_tissue_table import THIGH_M, SkinField, evaluate_place_functions
from gaitcal.model.segment_frames import fit_rigid_motions
from gaitcal.tracking.soft_tissue import RANK_TOLERANCE, WIDTH, build_rigid_pattern
from scripts.validation.bones.fits import kind_of, nominal_joint
from scripts.validation.bones.recordings import BoneRecording

SEGMENTS = ("thigh", "shank")
PERSON_SHARE = 0.5
"""Part of the variance of a cluster's shift and turn that all recordings of a person share."""
BEFORE = np.log([8e-3, np.deg2rad(4.0), 4e-3, 10e-3])
"""ln of shift (m), turn (rad), own (m) and ridge (m) per radian before bones are looked at: the
sizes of a walk over the 0.4 rad RMS by which its knees bend."""
FACTOR_OF_TWO = 0.7
"""Standard deviation of these logarithms, and of ln s."""
SOFTNESS = np.geomspace(0.2, 5.0, 41)
"""Values of s that are looked at."""
ROUNDS = 6
STEP = 0.02
"""Of logarithms, over which second derivatives are taken."""


@dataclass(frozen=True, kw_only=True)
class Slopes:
    """How one cluster moves with the knee, for a thigh of `THIGH_M`."""

    name: str
    person: str
    slopes: Array
    """(3 nm,) m per rad."""
    functions: Array
    """(3 nm, 21) Phi, marker by marker."""
    pattern: Array
    """(3 nm, 6) B."""
    noise: Array
    """(3 nm, 3 nm) m^2."""
    rest: Array
    """(7,) RMS of what the knee does not explain: shift (3) m, turn (3) rad, own m."""

    def softened(self, softness: float) -> Slopes:
        """The same for a person of softness 1."""
        return replace(self, slopes=self.slopes / softness, noise=self.noise / softness**2)

    def about(self, field: SkinField) -> Array:
        """(3 nm, 3 nm) m^2 about the mean of a person of softness 1."""
        size = np.repeat([field.shift, field.turn], 3) ** 2
        own = field.per_marker**2 * np.eye(len(self.slopes))
        return np.asarray(
            (self.pattern * size) @ self.pattern.T
            + own
            + self.functions @ field.covariance @ self.functions.T
        )


def person_of(recording: BoneRecording) -> str:
    """Who it is: files of one sex, height and reference show one person."""
    height = "" if np.isnan(recording.height) else f"{recording.height:.3f} m"
    return f"{recording.sex}, {height}, {recording.reference}" if height else recording.person


def slopes_of(recording: BoneRecording, segment: str) -> Slopes:
    """Fit the displacements of the markers of a segment by the knee's flexion."""
    nominal = nominal_joint(recording)
    frame, knee = nominal.frames[segment], "knee_r"
    length = float(np.linalg.norm(nominal.model.nominal.centre(knee, "thigh_r")))
    local = (recording.segments[segment].markers - frame.origin) @ frame.rotation
    still = recording.standing("thigh", "shank")
    rest = local[still].mean(axis=0)
    flexion = recording.knee_flexion
    flexion = flexion - flexion[still].mean()
    moved = _displacements(local * (THIGH_M / length), rest * (THIGH_M / length))
    power = float(flexion @ flexion)
    slopes = flexion @ moved / power
    left = moved - flexion[:, None] * slopes
    pattern = build_rigid_pattern((rest - rest.mean(axis=0)) * (THIGH_M / length)).reshape(
        -1, WIDTH
    )
    rigid = left @ np.linalg.pinv(pattern, rcond=1e-3).T
    own = left - rigid @ pattern.T
    sizes = np.append(np.sqrt((rigid**2).mean(axis=0)), np.sqrt((own**2).mean()))
    in_step = len(flexion) / power
    noise = in_step * (
        (pattern * sizes[:WIDTH] ** 2) @ pattern.T + sizes[-1] ** 2 * np.eye(len(pattern))
    )
    place = (rest - nominal.model.nominal.centre(knee, f"{segment}_r")) / length
    return Slopes(
        name=recording.name,
        person=person_of(recording),
        slopes=slopes,
        functions=np.kron(
            evaluate_place_functions(place, gait=kind_of(recording) == GAIT), np.eye(3)
        ),
        pattern=pattern,
        noise=noise,
        rest=sizes,
    )


def _displacements(path: Array, rest: Array) -> Array:
    """(nf, 3 nm) m: the shift, the turn and the deformation of a cluster, put together as for small
    turns.
    """
    middle, arms = path.mean(axis=1), rest - rest.mean(axis=0)
    rotation, _ = fit_rigid_motions(rest, path)
    turned = np.einsum("fji,fmj->fmi", rotation, path - middle[:, None])
    rigid = np.hstack([middle - rest.mean(axis=0), Rotation.from_matrix(rotation).as_rotvec()])
    return np.asarray(
        rigid @ build_rigid_pattern(arms).reshape(-1, WIDTH).T
        + (turned - arms).reshape(len(path), -1)
    )


def all_slopes(recordings: Sequence[BoneRecording], segment: str) -> list[Slopes]:
    """Of every recording that shows the knee and has skin markers on the segment."""
    chosen = [r for r in recordings if r.has("thigh", "shank") and not r.has("pelvis")]
    return [slopes_of(r, segment) for r in chosen if r.segments[segment].markers.shape[1]]


def learn_field(data: Sequence[Slopes]) -> SkinField:
    """Estimate the skin of one kind of segment, and how soft each recording is beside it."""
    softness = np.ones(len(data))
    for _ in range(ROUNDS):
        field = _field_of([d.softened(s) for d, s in zip(data, softness, strict=True)])
        softness = np.array([_likeliest_softness(d, field) for d in data])
    return field


def _likeliest_softness(data: Slopes, field: SkinField) -> float:
    """S of one recording by how its markers deform, with a log-normal prior; a calibration observes
    no more.
    """
    deforming = null_space(data.pattern.T, rcond=RANK_TOLERANCE)
    mean = deforming.T @ (data.functions @ field.coefficients.ravel())
    about, noise = (
        deforming.T @ covariance @ deforming for covariance in (data.about(field), data.noise)
    )
    known = -0.5 * (np.log(SOFTNESS) / FACTOR_OF_TWO) ** 2
    observed = deforming.T @ data.slopes
    found = [_log_density(observed - s * mean, s**2 * about + noise) for s in SOFTNESS]
    return float(SOFTNESS[np.argmax(known + found)])


def _field_of(data: Sequence[Slopes]) -> SkinField:
    """The field of recordings that are all as soft."""
    functions, slopes = (
        np.vstack([d.functions for d in data]),
        np.concatenate([d.slopes for d in data]),
    )

    def cost(logs: Array) -> float:
        whole = _covariance(data, logs) + np.exp(2 * logs[3]) * functions @ functions.T
        known = (((logs - BEFORE) / FACTOR_OF_TWO) ** 2).sum()
        return 0.5 * float(known) - _log_density(slopes, whole)

    logs = minimize(cost, BEFORE, method="L-BFGS-B").x
    doubt = np.diag(np.linalg.inv(_curvature(cost, logs)))
    factor = cho_factor(_covariance(data, logs))
    information = functions.T @ cho_solve(factor, functions) + np.exp(-2 * logs[3]) * np.eye(
        functions.shape[1]
    )
    covariance = np.linalg.inv(information)
    beta = covariance @ functions.T @ cho_solve(factor, slopes)
    # E[size^2], as the sizes themselves are known from few people
    shift, turn, own = np.exp(logs + doubt)[:3].tolist()
    return SkinField(
        coefficients=beta.reshape(-1, 3),
        covariance=covariance,
        shift=shift,
        turn=turn,
        per_marker=own,
    )


def _curvature(function: Callable[[Array], float], at: Array) -> Array:
    """(n, n) second derivatives of a function, by central differences."""
    steps = STEP * np.eye(len(at))
    out = np.empty((len(at), len(at)))
    for i, one in enumerate(steps):
        for j, other in enumerate(steps):
            pairs = ((1, 1), (1, -1), (-1, 1), (-1, -1))
            out[i, j] = sum(a * b * function(at + a * one + b * other) for a, b in pairs) / (
                4 * STEP**2
            )
    return out


def _covariance(data: Sequence[Slopes], logs: Array) -> Array:
    """Of all slopes about their mean: of the same person correlated, of others not."""
    shift, turn, own = np.exp(logs[:3])
    together_size = np.repeat([shift, turn], 3) ** 2
    ends = np.cumsum([0, *(len(d.slopes) for d in data)])
    out = np.zeros((ends[-1], ends[-1]))
    for i, one in enumerate(data):
        for j, other in enumerate(data):
            here = slice(ends[i], ends[i + 1]), slice(ends[j], ends[j + 1])
            if i == j:
                out[here] = (one.pattern * together_size) @ one.pattern.T + one.noise
                out[here] += own**2 * np.eye(len(one.slopes))
            elif one.person == other.person:
                out[here] = PERSON_SHARE * (one.pattern * together_size) @ other.pattern.T
    return out


def learn_table(recordings: Sequence[BoneRecording], without: str = "") -> dict[str, SkinField]:
    """The skin of thigh and shank, from all but one person."""
    out = {}
    for segment in SEGMENTS:
        data = [d for d in all_slopes(recordings, segment) if d.person != without]
        if data:
            out[segment] = learn_field(data)
    return out


def write_table(
    fields: Mapping[str, SkinField], recordings: Sequence[BoneRecording], file: Path
) -> None:
    """Write the data file."""
    people = len(
        {person_of(r) for r in recordings if r.has("thigh", "shank") and not r.has("pelvis")}
    )
    rows = {
        name: {
            "coefficients_mm": (1e3 * field.coefficients).round(3).tolist(),
            "covariance_mm2": (1e6 * field.covariance).round(4).tolist(),
            "shift_mm": round(1e3 * field.shift, 3),
            "turn_deg": round(float(np.rad2deg(field.turn)), 3),
            "own_mm": round(1e3 * field.per_marker, 3),
        }
        for name, field in fields.items()
    }
    whole = {
        "description": "How skin markers move against the bone per radian of knee flexion from the "
        "static posture "
        "(gaitcal/calibration/soft_tissue_table.py), for a thigh of 0.42 m",
        "derived_by": "python -m scripts.validation bones --learn models/soft_tissue.json",
        "source": f"{people} people whose bones pins or fluoroscopy tracked under skin markers; "
        "Cereatti et al., "
        "J Biomech 62:5-13, 2017",
        "functions": ["1", "x/W", "z/W", "k", "k x/W", "k z/W", "g"],
        "segments": rows,
    }
    text = re.sub(r"\[\s+([^\[\]]+?)\s+\]", _on_one_line, json.dumps(whole, indent=1))
    file.write_text(text + "\n", encoding="utf-8")


def _on_one_line(found: re.Match[str]) -> str:
    """A list of numbers or words without its line breaks."""
    return "[" + " ".join(found[1].split()) + "]"


def learn_lines(recordings: Sequence[BoneRecording]) -> Iterator[str]:
    """What was learnt, and how well it is expected of people who were left out."""
    for segment in SEGMENTS:
        data = all_slopes(recordings, segment)
        if not data:
            continue
        field = learn_field(data)
        yield (
            f"{segment}, per rad of knee flexion: shift {1e3 * field.shift:.1f} mm, turn "
            f"{np.rad2deg(field.turn):.1f} "
            f"deg, own {1e3 * field.per_marker:.1f} mm (SD among people)"
        )
        heads = (
            f"{'shift, mm/rad':>22}{'expected':>22}{'(SD)':>7}{'z RMS':>7}{'ln p':>8}{'no mean':>9}"
        )
        yield f"  {'person left out':20}{heads}"
        sums = np.zeros(2)
        for d in data:
            others = learn_field([o for o in data if o.person != d.person])
            mean = d.functions @ others.coefficients.ravel()
            about = d.about(others)
            spread = about + d.noise
            rigid = np.linalg.pinv(d.pattern, rcond=1e-3)
            found, expected = rigid @ d.slopes, rigid @ mean
            deviation = np.sqrt(np.diag(rigid @ spread @ rigid.T))
            z = (found - expected) / deviation
            with_mean = _log_density(d.slopes - mean, spread)
            alone = max(
                _log_density(d.slopes, f**2 * about + d.noise) for f in np.geomspace(0.5, 8.0, 20)
            )
            sums += with_mean, alone
            cells = "".join(
                f"{' '.join(f'{x:6.1f}' for x in 1e3 * of[:3]):>22}" for of in (found, expected)
            )
            yield (
                "  "
                f"{d.name:20}{cells}{1e3 * deviation[:3].mean():7.1f}"
                f"{np.sqrt((z**2).mean()):7.2f}{with_mean:8.1f}"
                f"{alone:9.1f}"
            )
        yield f"  {'sum':78}{sums[0]:8.1f}{sums[1]:9.1f}"
        left, size = np.sqrt(np.mean([d.rest**2 for d in data], axis=0)), SIZES[segment]
        shift, turn = (np.sqrt(np.mean(part**2)) for part in (left[:3], left[3:6]))
        yield (
            f"  not explained by the knee, RMS a component: shift {1e3 * shift:.1f} mm, turn "
            f"{np.rad2deg(turn):.1f} deg, own {1e3 * left[6]:.1f} mm; in use for each other "
            f"angle: {1e3 * size.shift:.1f} mm, {np.rad2deg(size.turn):.1f} deg, "
            f"{1e3 * size.per_marker:.1f} mm"
        )


def _log_density(values: Array, covariance: Array) -> float:
    """Of a normal distribution about zero, but for its constant."""
    root = np.linalg.cholesky(covariance)
    scaled = np.linalg.solve(root, values)
    return float(-0.5 * scaled @ scaled - np.log(np.diag(root)).sum())
