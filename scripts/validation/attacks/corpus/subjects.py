"""Attacks on what is said of the person."""

from __future__ import annotations

from dataclasses import replace

from gaitcal import Study
from scripts.validation.attacks.attack import Kind, StudyChange
from scripts.validation.attacks.corpus.words import Row, rows

POUNDS = 2.2046226


def mass(factor: float) -> StudyChange:
    """Body mass times a factor."""
    return lambda study: replace(study, subject=replace(study.subject, mass=factor * study.subject.mass))


def height(factor: float) -> StudyChange:
    """Height times a factor."""
    return lambda study: replace(study, subject=replace(study.subject, height=factor * study.subject.height))


def other_sex(study: Study) -> Study:
    """The other anthropometric table."""
    sex = "female" if study.subject.sex == "male" else "male"
    return replace(study, subject=replace(study.subject, sex=sex))


def attacks() -> Row:
    """Every attack on the subject."""
    row = rows(Kind.SUBJECT)
    for percent, bases in (
        (5, "subject01 synthetic"),
        (-5, "p01 pig"),
        (10, "subject01 synthetic"),
        (-10, "p18 child"),
        (20, "subject01 pig"),
        (-20, "synthetic p01"),
    ):
        yield from row(f"mass {percent:+d} %", bases, mass(1 + 0.01 * percent), "mass|gain|body weight")
    yield from row("mass in pounds", "subject01 pig uf3", mass(POUNDS), "mass|body weight|pound|kg")
    for percent, bases in ((5, "subject01 synthetic"), (-5, "pig p01"), (15, "subject01 child"), (-20, "uf3")):
        yield from row(f"height {percent:+d} %", bases, height(1 + 0.01 * percent), "height|tall|length")
    yield from row("height in centimetres", "subject01 pig", height(100.0), "height|tall|centimet")
    yield from row("the other sex", "subject01 synthetic child", other_sex, "sex")
