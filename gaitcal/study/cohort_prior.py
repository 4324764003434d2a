"""Predict a person's joint parameters before any recording: study file and `priors.json` of a
cohort.

The table of anatomy is in `calibration/joint_prior.py`, which combines all three sources; the prior
itself is in `study/normal_prior.py`.

`priors.json` is written by `gaitcal cohort --learn-priors`, and read by `gaitcal calibrate
--priors` or if a study file names it (`[calibration] priors`). It holds what was learnt from all
people, and from all people except each fold. A person of the cohort gets the prior without their
fold. Persons are recognised by their recordings or name; the file holds hashes of both, no name.

The deviations d of a person's joint parameters from their nominal values are normalised by the
prior of any person (mean m0, covariance F F^T). They are the sum of the mean of people of that
size and sex and an individual part:

    y = F^-1 (d - m0) = X w + u,    u ~ N(0, Sigma),    X = [D B, z D B, x D B],

D: positions by body height over `REFERENCE_HEIGHT_M`; z: the height in steps of `HEIGHT_STEP_M`
(within that of the people it was learnt from); x: half a sex; B: the directions in which both
sides deviate alike. Without z and x, X = D B. F keeps a mirror image a mirror image, and does
not mix positions with orientations.
"""

import hashlib
import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pydantic import Field
from scipy.linalg import block_diag

from gaitcal.arrays import Array
from gaitcal.errors import Code, InputError, suggest_name
from gaitcal.io.toml import Table, format_value, get_package_version, validate_table
from gaitcal.model.parameters import JOINT_PARAMETERS, JP_INDEX, JP_NAMES, ParameterKind
from gaitcal.study.normal_prior import JointPrior
from gaitcal.study.settings import CalibrationSettings


def _map_sides() -> dict[str, tuple[str, ...]]:
    out: dict[str, tuple[str, ...]] = {name: (name,) for name in JP_NAMES}
    for name in JP_NAMES:
        joint, _, rest = name.partition(".")
        if joint[-2:] in ("_r", "_l"):
            plain = f"{joint[:-2]}.{rest}"
            out[plain] = (*out.get(plain, ()), name)
    return out


SIDES_OF = _map_sides()
"""Name of a joint parameter, with or without its side -> the one, or both of them."""


def require_joint_prior(settings: CalibrationSettings, source: Path | str) -> None:
    """Require that `joint_prior` names joint parameters, and that the settings use priors.

    Parameters
    ----------
    settings
        Settings of the calibration.
    source
        The study file, for the message.

    Raises
    ------
    InputError
        A name is no joint parameter, or the protocol uses no priors.
    """
    field = "calibration.joint_prior"
    for name in settings.joint_prior:
        if name not in SIDES_OF:
            allowed = (
                suggest_name(name, SIDES_OF)
                or "; allowed: those of parameters.csv, with or without their side"
            )
            message = f"found {format_value(name)}, which is no joint parameter{allowed}"
            raise InputError(message, source=source, field=field, code=Code.UNKNOWN_FIELD)
    if settings.joint_prior and not settings.takes_priors:
        message = "allowed only with protocol = 'evidence' and jp = true"
        raise InputError(message, source=source, field=field, code=Code.PRIORS)


REFERENCE_HEIGHT_M, HEIGHT_STEP_M = 1.70, 0.10
"""m."""
SEXES = {"female": -0.5, "male": 0.5}


@dataclass(frozen=True, kw_only=True)
class Person:
    """Body height and sex, on which deviations may depend."""

    height: float
    """m."""
    sex: str


def build_mirror(names: Sequence[str]) -> Array:
    """Build the matrix M for which M y are the deviations of a mirrored person.

    Parameters
    ----------
    names
        n joint parameters; with each also that of the other side.

    Returns
    -------
    Array
        (n, n)
    """
    place = {name: k for k, name in enumerate(names)}
    out = np.zeros((len(names), len(names)))
    for name, k in place.items():
        parameter = JOINT_PARAMETERS[JP_INDEX[name]]
        out[place[name_other_side(name)], k] = -1.0 if parameter.mirrored else 1.0
    return out


def name_other_side(name: str) -> str:
    """Name the same parameter of the other leg or arm; itself for the back."""
    parameter = JOINT_PARAMETERS[JP_INDEX[name]]
    if parameter.joint[-2:] not in ("_r", "_l"):
        return name
    swapped = parameter.joint[:-1] + ("l" if parameter.joint[-1] == "r" else "r")
    return name.replace(parameter.joint, swapped, 1)


def build_sided_directions(names: Sequence[str]) -> tuple[Array, Array]:
    """Build the directions in which both sides deviate alike, and oppositely.

    Parameters
    ----------
    names
        n joint parameters.

    Returns
    -------
    alike, opposite
        (n, a) and (n, b), orthonormal.
    """
    reflected = build_mirror(names)
    alike, opposite = list[Array](), list[Array]()
    for k in range(len(names)):
        other = int(np.flatnonzero(reflected[:, k])[0])
        # Each pair of mirrored parameters is visited once.
        if other < k:
            continue
        for sign, found in ((1.0, alike), (-1.0, opposite)):
            direction = np.eye(len(names))[k] + sign * reflected[:, k]
            length = np.linalg.norm(direction)
            # A parameter of the median plane has one direction only: the other one is zero.
            if length > 0.0:
                found.append(direction / length)
    return np.array(alike).reshape(-1, len(names)).T, np.array(opposite).reshape(-1, len(names)).T


def build_design(
    names: Sequence[str], person: Person, heights: tuple[float, float], *, by_size: bool
) -> Array:
    """Build the design matrix X of a person.

    Parameters
    ----------
    names
        n joint parameters.
    person
        Height and sex.
    heights
        Range of heights of the people it was learnt from, m; the height is clipped to it.
    by_size
        Whether deviations depend on height and sex.

    Returns
    -------
    Array
        (n, k)
    """
    alike, _ = build_sided_directions(names)
    position = np.array(
        [JOINT_PARAMETERS[JP_INDEX[name]].kind is ParameterKind.POSITION for name in names]
    )
    # Positions grow with the person, tilts of axes do not.
    sized = np.where(position, person.height / REFERENCE_HEIGHT_M, 1.0)[:, None] * alike
    if not by_size:
        return sized
    # The effect of height is not extrapolated beyond the people of the cohort.
    height = float(np.clip(person.height, *heights))
    return np.hstack(
        [
            sized,
            (height - REFERENCE_HEIGHT_M) / HEIGHT_STEP_M * sized,
            SEXES.get(person.sex, 0.0) * sized,
        ]
    )


FORMAT = 2
KIND = "joint parameters of a cohort"
NOT_LEARNT = "nothing"
"""`learning` of a part from which nothing was learnt."""
MOST_PRIOR_BYTES = 100_000_000


class StoredPopulation(Table):
    """What one set of people shows; matrices by rows of their lower triangles."""

    effects: list[float]
    effect_covariance: list[float]
    spread: list[float]


class StoredPart(Table):
    """One part of the body: deviations `origin` + `unit` y from nominal values."""

    part: str
    parameters: list[str] = Field(min_length=1)
    origin: list[float]
    unit: list[float]
    learning: str
    by_size: bool
    wider: float = Field(gt=0)
    gain: list[float]
    populations: list[StoredPopulation] = Field(min_length=1)


class StoredPerson(Table):
    """Person from whom the prior was learnt."""

    name_sha256: str
    recordings_sha256: list[str]
    fold: int = Field(ge=0)


class CohortPriors(Table):
    """Content of `priors.json`."""

    format: int
    kind: str
    gaitcal: str
    cohort: str
    marker_set: str
    hip_centre: str
    ankle_zero: str
    heights_m: list[float] = Field(min_length=2, max_length=2)
    left_out: list[str]
    people: list[StoredPerson] = Field(min_length=1)
    parts: list[StoredPart] = Field(min_length=1)


def hash_name(cohort: str, name: str) -> str:
    """Hash the name of a person of a cohort, by which the person is recognised."""
    return hashlib.sha256(f"{cohort}/{name}".encode()).hexdigest()


def read_cohort_priors(path: Path) -> CohortPriors:
    """Read and check a file of priors.

    Parameters
    ----------
    path
        The file `priors.json`.

    Returns
    -------
    CohortPriors
        Its content.

    Raises
    ------
    InputError
        It is no such file, has another format, or its matrices are no covariances.
    """

    def fault(message: str, field: str | None = None) -> InputError:
        return InputError(message, source=path, field=field, code=Code.PRIORS)

    allowed = "allowed: priors.json of 'gaitcal cohort --learn-priors'"
    try:
        # Before reading: a wrong file may be a recording of gigabytes.
        if path.stat().st_size > MOST_PRIOR_BYTES:
            raise fault(f"over {MOST_PRIOR_BYTES // 1_000_000} MB: no file of priors is that long")
        content = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(
            f"cannot be read: {error.strerror}", source=path, code=Code.UNREADABLE
        ) from None
    except (ValueError, RecursionError):
        raise fault(f"is no JSON; {allowed}") from None
    if not isinstance(content, dict) or content.get("kind") != KIND:
        raise fault(f"contains no priors; {allowed}")
    if content.get("format") != FORMAT:
        raise fault(f"found format {format_value(content.get('format'))}; allowed: {FORMAT}")
    priors = validate_table(CohortPriors, content, path)
    for part in priors.parts:
        _check_part(part, priors, path)
    return priors


def _check_part(part: StoredPart, priors: CohortPriors, path: Path) -> None:
    """Raise InputError for unknown parameters, missing folds, or no covariances."""

    def fault(message: str) -> InputError:
        return InputError(message, source=path, field=part.part, code=Code.PRIORS)

    # Validation has checked types and shapes; what follows depends on other parts of the file.
    if unknown := [name for name in part.parameters if name not in JP_INDEX]:
        raise fault(f"found {format_value(unknown[0])}, which is no joint parameter")
    if not {p.fold for p in priors.people} <= set(range(len(part.populations) - 1)):
        raise fault("found a fold of people without its priors")
    person = Person(height=0.5 * sum(priors.heights_m), sex="female")
    heights = priors.heights_m[0], priors.heights_m[1]
    try:
        # Every population must give a covariance for a person of middle height.
        for number in range(len(part.populations)):
            compute_expected_deviations(part, number, person, heights)
    except (ValueError, np.linalg.LinAlgError):
        raise fault("found matrices that are no covariances of its parameters") from None


def predict_prior(
    priors: CohortPriors, person: Person, path: Path, fold: int | None = None
) -> JointPrior:
    """Predict the joint parameters of a person from a cohort.

    Parameters
    ----------
    priors
        Priors of the cohort.
    person
        Height and sex.
    path
        Their file, for notes.
    fold
        Fold of people to leave out; None for nobody.

    Returns
    -------
    JointPrior
        Prior of the parameters that were learnt.
    """
    low, high = priors.heights_m
    # Parts that the cohort did not show keep the prior of anatomy or study file.
    parts = [part for part in priors.parts if part.learning != NOT_LEARNT]
    found = [
        compute_expected_deviations(part, 0 if fold is None else fold + 1, person, (low, high))
        for part in parts
    ]
    names = tuple(name for part in parts for name in part.parameters)
    left_out = sum(p.fold == fold for p in priors.people)
    return JointPrior(
        names=names,
        mean=np.concatenate([np.zeros(0), *(mean for mean, _ in found)]),
        covariance=block_diag(np.zeros((0, 0)), *(covariance for _, covariance in found)),
        file=path.name,
        people=len(priors.people) - left_out,
        left_out=left_out,
        notes=tuple(_describe_prior(priors, person, left_out, path)),
    )


def compute_expected_deviations(
    part: StoredPart, number: int, person: Person, heights: tuple[float, float]
) -> tuple[Array, Array]:
    """Compute mean and covariance of a person's deviations by one population.

    Parameters
    ----------
    part
        Part of the body with n parameters.
    number
        Index of the population: 0 for all people, k + 1 without fold k.
    person
        Height and sex.
    heights
        Range of heights of the cohort, m.

    Returns
    -------
    mean, covariance
        (n,) m, rad and (n, n).

    Raises
    ------
    ValueError, LinAlgError
        The stored numbers give no mean and covariance.
    """
    stored = part.populations[number]
    matrix = build_design(part.parameters, person, heights, by_size=part.by_size)
    count, effects = matrix.shape
    # The file stores lower triangles; `unit`, the root of the anatomical prior, gives m and rad.
    uncertainty, spread = (
        build_symmetric(values, n)
        for values, n in ((stored.effect_covariance, effects), (stored.spread, count))
    )
    unit = np.tril(build_symmetric(part.unit, count))
    # Predictive covariance: people about their mean, plus the error of that mean.
    covariance = part.wider * (unit @ (spread + matrix @ uncertainty @ matrix.T) @ unit.T)
    # Fails unless the matrix is positive definite.
    np.linalg.cholesky(covariance)
    mean = np.array(part.origin) + unit @ matrix @ np.array(stored.effects)
    if not (np.isfinite(mean).all() and np.isfinite(covariance).all()):
        raise ValueError("not finite")
    return mean, covariance


def build_symmetric(lower: Sequence[float], count: int) -> Array:
    """Build the (n, n) symmetric matrix from the rows of its lower triangle."""
    rows, columns = np.tril_indices(count)
    out = np.zeros((count, count))
    out[rows, columns] = np.array(lower, dtype=float)
    return out + np.tril(out, -1).T


def _describe_prior(
    priors: CohortPriors, person: Person, left_out: int, path: Path
) -> Iterable[str]:
    learnt = "; ".join(f"{part.part}: {part.learning}" for part in priors.parts)
    people = len(priors.people) - left_out
    without = ""
    if left_out:
        without = (
            f"; this person is one of the cohort: {left_out} people, this one among them, were "
            "left out of it"
        )
    yield (
        f"joint parameters lean on {people} people of the cohort '{priors.cohort}' ({path.name}; "
        f"{learnt}){without}"
    )
    low, high = priors.heights_m
    if not low <= person.height <= high:
        yield (
            f"{person.height:.2f} m is outside the {low:.2f} to {high:.2f} m of the people of "
            f"{path.name}"
        )
    if priors.gaitcal != get_package_version("gaitcal"):
        yield (
            f"{path.name} was learnt with gaitcal {priors.gaitcal}, not "
            f"{get_package_version('gaitcal')}"
        )
