"""Words that name a cause: regular expressions over one message; `{key}` stands for labels (`markers.pattern`)."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TypeAlias

from scripts.validation.attacks.attack import Attack, FileChange, Kind, StudyChange

EXCHANGED = r"exchang|swap|each other|mirror|handed|wrong side|carry|left and right|right and left|in the place of"
MOVED = (
    r"moved|displac|\boff\b|out of|place|shift|slid|slip|shape|distance|offset|wide|width|length|sits|turned|jump|lies"
    r"|from where|disagree"
)
STUCK = (
    r"frozen|stuck|same (place|position|value)|stand(s|ing)? still|not mov|repeated|interpolat|filled|straight|smooth"
    r"|jump|out of|shape|\boff\b"
)
PERSON = (
    r"another person|other person|\bsize|scale|differ|lengths?|height|longer|shorter|larger|smaller|same body|one body"
    r"|\btimes\b"
)
POSE = r"bent|bend|flex|straight|pose|posture|upright|knee angle"
STILL = r"still|moves|moving|sway|speed|m/s"
MIRROR = r"mirror|handed|\bsides\b|wrong side|exchang.*(left|right)|(left|right).*exchang|lie to the left"
UNITS = r"unit|millimet|inch|metre|scale"
RATE = r"\bHz\b|\brate|frames a second|faster|slower|\bspeed|forces from"
CLOCK = r"clock|\blate\b|later|sooner|early|earlier|delay|synchron|time shift"
PLACE = r"plate.*(stands|position|shift|corner|lies|elsewhere|displac|moved)"
YAW = r"yaw|turned|rotat|about the vertical|axes|corner|reversed"
TILT = r"tilt|level|lean|turned|rotat|slope|vertical axis"
SIGN = r"\bsigns?\b|turned round|invert|negative|opposite|revers|pulls|points? (down|back)"
GAIN = r"\bgain|body weights?|mass|times too|unit|factor|scale"
FREE = r"free moment|vertical moment|N·?mm|N·m.*unit|torque.*unit|moment.*(unit|sign)"
CROSSED = r"exchang|swap|other plate|cable|each other|crossed"
FOOT = r"\b(foot|feet)\b|plates ="
OFFSET = r"offset|\bempty|unloaded|swing|nobody stands|\btare"
CLIPPED = r"satur|clipp|cut off at|stays at"
SMOOTH = r"filter|smooth|cut-?off|slowly|low-?pass"
POINT = r"centres? of pressure|point of|point column"
NOTHING = r"zero|no force|never|no contact|unloaded|empty|nothing|no plate|not loaded|carries? nothing"
ELSEWHERE = (
    r"another (trial|walk|recording)|other (trial|walk)|not (of|belong)|no foot|under no|never|clock|later|sooner"
    r"|centre of pressure is"
)
UNMEASURED = r"no plate|without a plate|not measured|missing|not covered|misses|no force|interrupt|breaks|contact not"
WALKS = r"static.*(walk|still|moves|moving|stand)|still|walk"

Row: TypeAlias = Iterator[Attack]


def rows(kind: Kind) -> Callable[..., Row]:
    """A function that makes attacks of a kind: name, bases, change, words that name it."""

    def make(
        name: str,
        bases: str,
        change: StudyChange | FileChange,
        *named: str,
        quick: str = "",
        of_files: bool = False,
        other_frames: tuple[str, ...] = (),
    ) -> Row:
        for base in bases.split():
            yield Attack(
                name=name,
                base=base,
                kind=kind,
                change=change,
                named=named,
                quick=base in quick.split(),
                of_files=of_files,
                other_frames=other_frames,
            )

    return make
