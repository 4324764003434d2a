"""How much of the body's mass moves in a way that markers do not determine, and what that does to the pelvis residual.

A segment without the markers it needs moves as a prior has it (`motion/undetermined.py`). What its mass does otherwise
appears at the pelvis as force and moment that nothing explains: so long as the trunk is such a segment, the pelvis
residual says how it moves, and nothing of masses. Torques of the legs are summed from the feet upwards and do not
depend on it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from gaitcal.codes import Code
from gaitcal.findings import STUDY, Finding, Severity
from gaitcal.model.inertial_parameters import MASSIVE_SEGMENTS, table
from gaitcal.model.linkage import JOINT_OF_CHILD, LOWER_BODY
from gaitcal.model.parameters import Parameters
from gaitcal.motion.motion import Motion
from gaitcal.session.result import TrialResult

TRUNK = "head_trunk"
_WORDS = {TRUNK: "head and trunk", "upper_arm": "upper arms", "forearm_hand": "forearms and hands"}


def is_trunk_unmeasured(motion: Motion) -> bool:
    """Whether the markers of a whole-body motion leave open how the trunk turns."""
    return TRUNK in _unmeasured(motion)


def unmeasured_share(motion: Motion, parameters: Parameters) -> float:
    """Share (0 to 1) of the body's mass in segments of the upper body that markers do not determine."""
    mass = dict(zip(MASSIVE_SEGMENTS, table(parameters.inertial)[:, 0], strict=True))
    return float(sum(mass[segment] for segment in _unmeasured(motion)) / sum(mass.values()))


def unmeasured_words(motion: Motion, parameters: Parameters) -> str:
    """The same in words ("head and trunk, upper arms: 44 % of the body's mass"); nothing where none is."""
    parts = dict.fromkeys(_WORDS.get(s, _WORDS.get(s[:-2], s)) for s in _unmeasured(motion))
    return f"{', '.join(parts)}: {100 * unmeasured_share(motion, parameters):.0f} % of the body's mass" if parts else ""


def _unmeasured(motion: Motion) -> tuple[str, ...]:
    turns = {s: {e.name for e in JOINT_OF_CHILD[s].elements} for s in MASSIVE_SEGMENTS if s not in LOWER_BODY}
    return tuple(s for s, names in turns.items() if names & set(motion.guessed))


def unmeasured_mass(results: Sequence[TrialResult], parameters: Parameters) -> Iterator[Finding]:
    """Mass whose motion no marker determines, and the pelvis residual that it makes: no doubt of leg torques."""
    walks = [t for t in results if t.joint is None and t.loads is not None and t.loads.residuals]
    blind = [t for t in walks if is_trunk_unmeasured(t.body)]
    if not blind:
        return
    residuals = [t.loads.residuals[-1] for t in blind if t.loads is not None]
    force, moment = max(r.rms_force for r in residuals), max(r.rms_moment for r in residuals)
    where = "" if len(blind) == len(walks) else f" in {', '.join(t.name for t in blind)}"
    yield Finding(
        severity=Severity.INFO,
        topic="pelvis residual",
        where=blind[0].name if len(walks) > len(blind) == 1 else STUDY,
        cause=f"markers do not determine {unmeasured_words(blind[0].body, parameters)}",
        found="a trunk is taken to stay upright, arms to hang along it, unless markers say otherwise; how they really "
        f"move is the first cause of the pelvis residual (up to {force:.0f} N and {moment:.0f} N·m RMS){where} and in "
        "the error bars of pelvis and trunk, and inertial parameters are not fitted against it; torques of the legs "
        "are summed from the feet upwards and do not depend on it",
        cure="three markers on the thorax that do not lie on one line (C7, T10, jugular notch, xiphoid) in all trials",
        code=Code.UNMEASURED_MASS,
    )
