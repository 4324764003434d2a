"""What is known of a person's joint parameters before any recording is looked at: anatomy, study
file, cohort.

The type that all three share, what a study file may say (`[calibration] joint_prior`), and the
`priors.json` of a cohort; anatomy's table is in `calibration/joint_prior.py`, where the three are
put together.

`priors.json` is written by `gaitcal cohort --learn-priors`, read by `gaitcal calibrate --priors`,
or where a study file names it (`[calibration] priors`). It holds what was learnt of everybody, and
of everybody but each fold of people: who is among the people of the file leans on what was learnt
without their fold. Persons are recognised by their recordings, or by their name; the file holds
hashes of both, no name.

The deviations d of a person's joint parameters from their nominal values, in units of what is known
of anybody (mean m0, covariance F F^T), are those of people of that size and sex, and the person's
own:

    y = F^-1 (d - m0) = X w + u,    u ~ N(0, Sigma),    X = [D B, z D B, x D B],

D positions by body height over `HEIGHT`, z the height in steps of `STEP` (within that of the people
it was learnt of), x half a sex, B the directions in which both sides deviate alike. Without z and
x, X = D B. F leaves a mirror image a mirror image, and mixes no positions with orientations.
"""

import hashlib
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from pydantic import Field
from scipy.linalg import block_diag

from gaitcal.arrays import Array
from gaitcal.errors import Code, InputError, nearest
from gaitcal.io.toml import Table, package_version, shown, validated
from gaitcal.model.parameters import JOINT_PARAMETERS, JP_INDEX, JP_NAMES, ParameterKind
from gaitcal.study.settings import CalibrationSettings


@dataclass(frozen=True, kw_only=True)
class JointPrior:
    """Deviations of n joint parameters from their nominal values before any trial: normal."""

    names: tuple[str, ...]
    mean: Array
    """(n,) m, rad."""
    covariance: Array
    """(n, n)."""
    of_study: tuple[str, ...] = ()
    """Parameters of which the study file says what to expect."""
    of_cohort: tuple[str, ...] = ()
    """Parameters of which a cohort does, whatever the study file says."""
    file: str = ""
    """Of the cohort, if there is one."""
    people: int = 0
    left_out: int = 0
    """People whose fold is left out because this person is among them; 0 where this person is not.
    """
    notes: tuple[str, ...] = ()
    """Where it is from, in words."""
    sha256: str = ""
    """Of the file, hexadecimal."""
    doubted: Mapping[str, float] = field(default_factory=dict)
    """Parameter -> m, rad by which it may be wrong beside that, for reasons that no fit reckons
    with.
    """

    def updated(self, other: "JointPrior") -> "JointPrior":
        """With what another one says of some of these parameters in its place, independent of the
        rest.
        """
        at = [self.names.index(name) for name in other.names]
        mean, covariance = self.mean.copy(), self.covariance.copy()
        covariance[at], covariance[:, at] = 0.0, 0.0
        mean[at], covariance[np.ix_(at, at)] = other.mean, other.covariance
        return replace(self, mean=mean, covariance=covariance)

    def loosened(self, more: Mapping[str, float]) -> "JointPrior":
        """With independent errors (m, rad) of some parameters beside what is known."""
        variance = np.array([more.get(name, 0.0) for name in self.names]) ** 2
        return replace(self, covariance=self.covariance + np.diag(variance))

    def held_near(self, names: Sequence[str]) -> str:
        """What those of some joint parameters that no trial shows stay near, in words; empty: their
        nominal values.
        """
        if set(names) & set(self.of_cohort):
            return "what the cohort has"
        return "what the study file expects" if set(names) & set(self.of_study) else ""


def _sides() -> dict[str, tuple[str, ...]]:
    out: dict[str, tuple[str, ...]] = {name: (name,) for name in JP_NAMES}
    for name in JP_NAMES:
        joint, _, rest = name.partition(".")
        if joint[-2:] in ("_r", "_l"):
            plain = f"{joint[:-2]}.{rest}"
            out[plain] = (*out.get(plain, ()), name)
    return out


SIDES_OF = _sides()
"""Name of a joint parameter, with or without its side -> the one, or both of them."""


def require_joint_prior(settings: CalibrationSettings, source: Path | str) -> None:
    """InputError where `joint_prior` names what is no joint parameter, or the settings take no
    priors.
    """
    field = "calibration.joint_prior"
    for name in settings.joint_prior:
        if name not in SIDES_OF:
            allowed = (
                nearest(name, SIDES_OF)
                or "; allowed: those of parameters.csv, with or without their side"
            )
            message = f"found {shown(name)}, which is no joint parameter{allowed}"
            raise InputError(message, source=source, field=field, code=Code.UNKNOWN_FIELD)
    if settings.joint_prior and not settings.takes_priors:
        message = "allowed only with protocol = 'evidence' and jp = true"
        raise InputError(message, source=source, field=field, code=Code.PRIORS)


HEIGHT, STEP = 1.70, 0.10
"""m."""
SEXES = {"female": -0.5, "male": 0.5}


@dataclass(frozen=True, kw_only=True)
class Person:
    """What deviations may depend on."""

    height: float
    """m."""
    sex: str


def mirror(names: Sequence[str]) -> Array:
    """(n, n) M: M y are the deviations of a person seen in a mirror. Every name's other side is
    among the names.
    """
    place = {name: k for k, name in enumerate(names)}
    out = np.zeros((len(names), len(names)))
    for name, k in place.items():
        parameter = JOINT_PARAMETERS[JP_INDEX[name]]
        out[place[other_side(name)], k] = -1.0 if parameter.mirrored else 1.0
    return out


def other_side(name: str) -> str:
    """The same parameter of the other leg or arm; itself of the back."""
    parameter = JOINT_PARAMETERS[JP_INDEX[name]]
    if parameter.joint[-2:] not in ("_r", "_l"):
        return name
    swapped = parameter.joint[:-1] + ("l" if parameter.joint[-1] == "r" else "r")
    return name.replace(parameter.joint, swapped, 1)


def sided_directions(names: Sequence[str]) -> tuple[Array, Array]:
    """(n, a) and (n, b) orthonormal directions in which both sides deviate alike, and by the
    opposite.
    """
    reflected = mirror(names)
    alike, opposite = list[Array](), list[Array]()
    for k in range(len(names)):
        other = int(np.flatnonzero(reflected[:, k])[0])
        if other < k:
            continue
        for sign, found in ((1.0, alike), (-1.0, opposite)):
            direction = np.eye(len(names))[k] + sign * reflected[:, k]
            length = np.linalg.norm(direction)
            if length > 0.0:
                found.append(direction / length)
    return np.array(alike).reshape(-1, len(names)).T, np.array(opposite).reshape(-1, len(names)).T


def design(
    names: Sequence[str], person: Person, heights: tuple[float, float], *, by_size: bool
) -> Array:
    """(n, k) X of a person. `heights`: m, those of the people it is learnt of; beyond them nothing
    changes.
    """
    alike, _ = sided_directions(names)
    position = np.array(
        [JOINT_PARAMETERS[JP_INDEX[name]].kind is ParameterKind.POSITION for name in names]
    )
    sized = np.where(position, person.height / HEIGHT, 1.0)[:, None] * alike
    if not by_size:
        return sized
    height = float(np.clip(person.height, *heights))
    return np.hstack([sized, (height - HEIGHT) / STEP * sized, SEXES.get(person.sex, 0.0) * sized])


FORMAT = 2
KIND = "joint parameters of a cohort"
UNLEARNT = "nothing"
"""How much is learnt of a part on which nobody leans."""
MOST_BYTES = 100_000_000


class StoredPopulation(Table):
    """What one set of people teaches; matrices by rows of their lower triangles."""

    effects: list[float]
    effect_covariance: list[float]
    spread: list[float]


class StoredPart(Table):
    """One part of the body: deviations `origin` + `unit` y from nominal values, the populations
    being of y.
    """

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
    """Somebody whom it was learnt of."""

    name_sha256: str
    recordings_sha256: list[str]
    fold: int = Field(ge=0)


class CohortPriors(Table):
    """The content of `priors.json`."""

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


def name_hash(cohort: str, name: str) -> str:
    """By which a person of a cohort is recognised."""
    return hashlib.sha256(f"{cohort}/{name}".encode()).hexdigest()


def read_cohort_priors(path: Path) -> CohortPriors:
    """Read and check a file of priors.

    Raises InputError: It is none, of another format, or its matrices are no covariances.
    """

    def fault(message: str, field: str | None = None) -> InputError:
        return InputError(message, source=path, field=field, code=Code.PRIORS)

    allowed = "allowed: priors.json of 'gaitcal cohort --learn-priors'"
    try:
        if path.stat().st_size > MOST_BYTES:
            raise fault(f"over {MOST_BYTES // 1_000_000} MB: no file of priors is that long")
        content = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(
            f"cannot be read: {error.strerror}", source=path, code=Code.UNREADABLE
        ) from None
    except (ValueError, RecursionError):
        raise fault(f"is no JSON; {allowed}") from None
    if not isinstance(content, dict) or content.get("kind") != KIND:
        raise fault(f"holds no priors; {allowed}")
    if content.get("format") != FORMAT:
        raise fault(f"found format {shown(content.get('format'))}; allowed: {FORMAT}")
    priors = validated(CohortPriors, content, path)
    person = Person(height=0.5 * sum(priors.heights_m), sex="female")
    for part in priors.parts:
        if unknown := [name for name in part.parameters if name not in JP_INDEX]:
            raise fault(f"found {shown(unknown[0])}, which is no joint parameter", part.part)
        if not {p.fold for p in priors.people} <= set(range(len(part.populations) - 1)):
            raise fault("found a fold of people without its priors", part.part)
        try:
            for number in range(len(part.populations)):
                expected(part, number, person, (priors.heights_m[0], priors.heights_m[1]))
        except (ValueError, np.linalg.LinAlgError):
            raise fault(
                "found matrices that are no covariances of its parameters", part.part
            ) from None
    return priors


def prior_of_person(
    priors: CohortPriors, person: Person, path: Path, fold: int | None = None
) -> JointPrior:
    """What the cohort, without the people of a fold, says of anybody of that size and sex: of what
    it has learnt.
    """
    low, high = priors.heights_m
    parts = [part for part in priors.parts if part.learning != UNLEARNT]
    found = [expected(part, 0 if fold is None else fold + 1, person, (low, high)) for part in parts]
    names = tuple(name for part in parts for name in part.parameters)
    left_out = sum(p.fold == fold for p in priors.people)
    return JointPrior(
        names=names,
        mean=np.concatenate([np.zeros(0), *(mean for mean, _ in found)]),
        covariance=block_diag(np.zeros((0, 0)), *(own for _, own in found)),
        file=path.name,
        people=len(priors.people) - left_out,
        left_out=left_out,
        notes=tuple(_notes(priors, person, left_out, path)),
    )


def expected(
    part: StoredPart, number: int, person: Person, heights: tuple[float, float]
) -> tuple[Array, Array]:
    """(n,) m, rad and (n, n) mean and covariance of a person's deviations by the population of that
    number.

    Raises
    ------
    ValueError, LinAlgError
        They are no mean and covariance.
    """
    stored = part.populations[number]
    matrix = design(part.parameters, person, heights, by_size=part.by_size)
    count, effects = matrix.shape
    own, spread = (
        symmetric(values, n)
        for values, n in ((stored.effect_covariance, effects), (stored.spread, count))
    )
    unit = np.tril(symmetric(part.unit, count))
    covariance = part.wider * (unit @ (spread + matrix @ own @ matrix.T) @ unit.T)
    np.linalg.cholesky(covariance)
    mean = np.array(part.origin) + unit @ matrix @ np.array(stored.effects)
    if not (np.isfinite(mean).all() and np.isfinite(covariance).all()):
        raise ValueError("not finite")
    return mean, covariance


def symmetric(lower: Sequence[float], count: int) -> Array:
    """(n, n) matrix of the rows of its lower triangle."""
    rows, columns = np.tril_indices(count)
    out = np.zeros((count, count))
    out[rows, columns] = np.array(lower, dtype=float)
    return out + np.tril(out, -1).T


def _notes(priors: CohortPriors, person: Person, left_out: int, path: Path) -> Iterable[str]:
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
    if priors.gaitcal != package_version("gaitcal"):
        yield (
            f"{path.name} was learnt with gaitcal {priors.gaitcal}, not "
            f"{package_version('gaitcal')}"
        )
