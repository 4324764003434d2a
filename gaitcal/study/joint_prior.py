"""What is known of a person's joint parameters before any recording is looked at: anatomy, study file, cohort.

The type that all three share, and what a study file may say of it (`[calibration] joint_prior`); anatomy's own table is
`calibration/joint_prior.py`, where the three are put together.

What a cohort says of a person's joint parameters before any of their recordings is looked at: `priors.json`.

Written by `gaitcal cohort --learn-priors` (`gaitcal/cohort`), read by `gaitcal calibrate --priors`, or where a
study file names it (`[calibration] priors`). The file holds what was learnt of everybody, and of everybody but each
fold of people: whoever is among the people of the file leans on what was learnt without their fold. Persons are
recognised by their recordings, or by their name; the file holds hashes of both, no name.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from pydantic import Field
from scipy.linalg import block_diag

from gaitcal.arrays import Array
from gaitcal.codes import Code
from gaitcal.errors import InputError, nearest
from gaitcal.io.result_folder import sha256_of
from gaitcal.io.toml import Table, package_version, shown, validated
from gaitcal.model.parameters import JP_INDEX, JP_NAMES
from gaitcal.study.people_design import Person, design
from gaitcal.study.settings import CalibrationSettings

if TYPE_CHECKING:
    from gaitcal.study.study import Study


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
    """People whose fold is left out because this person is among them; 0 where this person is not."""
    notes: tuple[str, ...] = ()
    """Where it is from, in words."""
    sha256: str = ""
    """Of the file, hexadecimal."""

    def updated(self, other: JointPrior) -> JointPrior:
        """With what another one says of some of these parameters in its place, independent of the rest."""
        at = [self.names.index(name) for name in other.names]
        mean, covariance = self.mean.copy(), self.covariance.copy()
        covariance[at], covariance[:, at] = 0.0, 0.0
        mean[at], covariance[np.ix_(at, at)] = other.mean, other.covariance
        return replace(self, mean=mean, covariance=covariance)

    def held_near(self, names: Sequence[str]) -> str:
        """What those of some joint parameters that no trial shows stay near, in words; empty: their nominal values."""
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
    """InputError where `joint_prior` names what is no joint parameter, or the settings take no priors."""
    field = "calibration.joint_prior"
    for name in settings.joint_prior:
        if name not in SIDES_OF:
            allowed = nearest(name, SIDES_OF) or "; allowed: those of parameters.csv, with or without their side"
            message = f"found {shown(name)}, which is no joint parameter{allowed}"
            raise InputError(message, source=source, field=field, code=Code.UNKNOWN_FIELD)
    if settings.joint_prior and not settings.takes_priors:
        message = "allowed only with protocol = 'evidence' and jp = true"
        raise InputError(message, source=source, field=field, code=Code.PRIORS)


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
    """One part of the body: deviations `origin` + `unit` y from nominal values, the populations being of y."""

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

    Raises
    ------
    InputError
        It is none, of another format, or its matrices are no covariances.
    """
    try:
        if path.stat().st_size > MOST_BYTES:
            raise InputError(
                f"over {MOST_BYTES // 1_000_000} MB: no file of priors is that long", source=path, code=Code.PRIORS
            )
        content = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}", source=path, code=Code.UNREADABLE) from None
    except (ValueError, RecursionError):
        raise InputError(
            "is no JSON; allowed: priors.json of 'gaitcal cohort --learn-priors'", source=path, code=Code.PRIORS
        ) from None
    if not isinstance(content, dict) or content.get("kind") != KIND:
        raise InputError(
            "holds no priors; allowed: priors.json of 'gaitcal cohort --learn-priors'", source=path, code=Code.PRIORS
        )
    if content.get("format") != FORMAT:
        raise InputError(
            f"found format {shown(content.get('format'))}; allowed: {FORMAT}", source=path, code=Code.PRIORS
        )
    priors = validated(CohortPriors, content, path)
    low, high = priors.heights_m
    for part in priors.parts:
        if unknown := [name for name in part.parameters if name not in JP_INDEX]:
            raise InputError(
                f"found {shown(unknown[0])}, which is no joint parameter",
                source=path,
                field=part.part,
                code=Code.PRIORS,
            )
        if not {p.fold for p in priors.people} <= set(range(len(part.populations) - 1)):
            raise InputError(
                "found a fold of people without its priors", source=path, field=part.part, code=Code.PRIORS
            )
        person = Person(height=0.5 * (low + high), sex="female")
        try:
            for number in range(len(part.populations)):
                expected(part, number, person, (low, high))
        except (ValueError, np.linalg.LinAlgError):
            message = "found matrices that are no covariances of its parameters"
            raise InputError(message, source=path, field=part.part, code=Code.PRIORS) from None
    return priors


def with_cohort_priors(study: Study, path: Path, priors: CohortPriors | None = None) -> Study:
    """A study whose joint parameters lean on a cohort; the file counts among its inputs.

    `priors`: the content of the file, where it has been read already.

    Raises
    ------
    InputError
        The file is no such file, or was learnt with another marker set, other nominal joints, or for another protocol.
    """
    priors = priors or read_cohort_priors(path)
    sha256 = sha256_of(path) or ""
    prior = replace(joint_prior(priors, study, path), sha256=sha256)
    settings = study.settings.model_copy(update={"priors": Path(path.name)})
    return replace(study.with_input(path, sha256), settings=settings, joint_prior=prior)


def joint_prior(priors: CohortPriors, study: Study, path: Path) -> JointPrior:
    """What the cohort says of the person of a study."""
    _require_same_rules(priors, study.settings, study.marker_set.name, path)
    person = Person(height=study.subject.height, sex=study.subject.sex)
    fold = _fold(priors, study.subject.name, study.inputs.values())
    return prior_of_person(priors, person, path, fold)


def prior_of_person(priors: CohortPriors, person: Person, path: Path, fold: int | None = None) -> JointPrior:
    """What the cohort, without the people of a fold, says of anybody of that size and sex: of what it has learnt."""
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


def _require_same_rules(priors: CohortPriors, settings: CalibrationSettings, marker_set: str, path: Path) -> None:
    if not settings.takes_priors:
        raise InputError(
            "priors of a cohort need joint parameters fitted with protocol = 'evidence'", source=path, code=Code.PRIORS
        )
    used = {"marker_set": marker_set, "hip_centre": settings.hip_rule, "ankle_zero": settings.ankle_rule}
    for rule, value in used.items():
        if (told := getattr(priors, rule)) != value:
            message = f"learnt with '{told}', and the study uses '{value}', whose nominal joints are others"
            raise InputError(message, source=path, field=rule, code=Code.PRIORS)


def _fold(priors: CohortPriors, name: str, inputs: Iterable[str]) -> int | None:
    """The fold of a person who is among those that the file was learnt of."""
    known, own = name_hash(priors.cohort, name), set(inputs)
    return next((p.fold for p in priors.people if p.name_sha256 == known or own & set(p.recordings_sha256)), None)


def expected(part: StoredPart, number: int, person: Person, heights: tuple[float, float]) -> tuple[Array, Array]:
    """(n,) m, rad and (n, n) mean and covariance of a person's deviations by the population of that number.

    Raises
    ------
    ValueError, LinAlgError
        They are no mean and covariance.
    """
    stored = part.populations[number]
    matrix = design(part.parameters, person, heights, by_size=part.by_size)
    count, effects = matrix.shape
    own, spread = (symmetric(values, n) for values, n in ((stored.effect_covariance, effects), (stored.spread, count)))
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
        without = f"; this person is one of the cohort: {left_out} people, this one among them, were left out of it"
    yield f"joint parameters lean on {people} people of the cohort '{priors.cohort}' ({path.name}; {learnt}){without}"
    low, high = priors.heights_m
    if not low <= person.height <= high:
        yield f"{person.height:.2f} m is outside the {low:.2f} to {high:.2f} m of the people of {path.name}"
    if priors.gaitcal != package_version("gaitcal"):
        yield f"{path.name} was learnt with gaitcal {priors.gaitcal}, not {package_version('gaitcal')}"
