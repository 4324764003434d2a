"""How much of the body's mass follows no marker in a trial, and what that does to the pelvis residual.

A segment without the markers it needs is carried along by the one before it. What its mass does beyond that appears at
the pelvis as force and moment that nothing explains: so long as the trunk is such a segment, the pelvis residual says
how it moves, and nothing of masses. Torques of the legs are summed from the feet upwards and do not depend on it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from gaitcal.codes import Code
from gaitcal.findings import STUDY, Finding, Severity
from gaitcal.model.inertial_parameters import MASSIVE_SEGMENTS, table
from gaitcal.model.linkage import LOWER_BODY
from gaitcal.model.parameters import Parameters
from gaitcal.motion.motion import MarkerErrors
from gaitcal.motion.trunk_support import TRUNK
from gaitcal.person.result import TrialResult

_WORDS = {TRUNK: "head and trunk", "upper_arm": "upper arms", "forearm_hand": "forearms and hands"}


def is_trunk_unmeasured(errors: MarkerErrors) -> bool:
    """Whether no marker of a whole-body motion shows the trunk."""
    return not errors.kept(TRUNK).any()


def unmeasured_share(errors: MarkerErrors, parameters: Parameters) -> float:
    """Share (0 to 1) of the body's mass in segments of the upper body that no marker shows."""
    mass = dict(zip(MASSIVE_SEGMENTS, table(parameters.inertial)[:, 0], strict=True))
    return float(sum(mass[segment] for segment in _unmeasured(errors)) / sum(mass.values()))


def unmeasured_words(errors: MarkerErrors, parameters: Parameters) -> str:
    """The same in words ("head and trunk, upper arms: 44 % of the body's mass"); nothing where none is."""
    parts = dict.fromkeys(_WORDS.get(s, _WORDS.get(s[:-2], s)) for s in _unmeasured(errors))
    return f"{', '.join(parts)}: {100 * unmeasured_share(errors, parameters):.0f} % of the body's mass" if parts else ""


def _unmeasured(errors: MarkerErrors) -> tuple[str, ...]:
    return tuple(s for s in MASSIVE_SEGMENTS if s not in LOWER_BODY and not errors.kept(s).any())


def unmeasured_mass(results: Sequence[TrialResult], parameters: Parameters) -> Iterator[Finding]:
    """Mass that follows no marker, and the pelvis residual that it makes: no doubt of leg torques."""
    walks = [t for t in results if t.joint is None and t.loads is not None and t.loads.residuals]
    blind = [t for t in walks if is_trunk_unmeasured(t.body.errors)]
    if not blind:
        return
    residuals = [t.loads.residuals[-1] for t in blind if t.loads is not None]
    force, moment = max(r.rms_force for r in residuals), max(r.rms_moment for r in residuals)
    where = "" if len(blind) == len(walks) else f" in {', '.join(t.name for t in blind)}"
    yield Finding(
        severity=Severity.INFO,
        topic="pelvis residual",
        where=blind[0].name if len(walks) > len(blind) == 1 else STUDY,
        cause=f"no marker shows {unmeasured_words(blind[0].body.errors, parameters)}",
        found=f"how it moves is the first cause of the pelvis residual (up to {force:.0f} N and {moment:.0f} N·m RMS)"
        f"{where}, and inertial parameters are not fitted against that; torques of the legs are summed from the feet "
        "upwards and do not depend on it",
        cure="three markers on the thorax that do not lie on one line (C7, T10, jugular notch, xiphoid) in all trials",
        code=Code.UNMEASURED_MASS,
    )
