"""Define codes, exceptions and findings.

Every kind of error and finding has one code; `gaitcal explain GC-020` prints its page. GC-0..:
checks of recordings. GC-1..: checks of a result. GC-2..: errors that stop a command. A code is
never used for another kind, as papers, notes and scripts refer to it.
"""

import difflib
import re
from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum


class Code(Enum):
    """The kind of a finding or of an error; its page is `gaitcal/explanations/pages/GC-nnn.md`."""

    MISSING_MARKERS = "GC-001"
    FEW_MARKERS = "GC-002"
    NEVER_SEEN = "GC-003"
    ONE_POSTERIOR_SPINE = "GC-004"
    UNKNOWN_LABELS = "GC-005"
    LABEL_TWICE = "GC-006"
    ONE_TRAJECTORY = "GC-007"
    BARE_SEGMENT = "GC-008"
    STRAY_MARKER = "GC-009"
    REBUILT_MARKER = "GC-010"
    MARKER_LEFT_OUT = "GC-011"
    ONE_MARKER_SEGMENT = "GC-012"
    GAPS = "GC-013"
    PELVIS_LOST = "GC-014"
    PELVIS_CARRIED = "GC-015"
    FROZEN_MARKER = "GC-016"
    CONSTANT_COORDINATE = "GC-017"
    SPIKES = "GC-018"
    SEAM = "GC-019"
    EXCHANGED_LABELS = "GC-020"
    MARKER_LEFT_PLACE = "GC-021"
    MARKER_ELSEWHERE = "GC-022"
    NOT_UPRIGHT = "GC-023"
    HEADING = "GC-024"
    ON_THE_SPOT = "GC-025"
    SIDES_EXCHANGED = "GC-026"
    UNIT_OF_LENGTH = "GC-027"
    OTHER_SCALE = "GC-028"
    LANDMARKS_EXCHANGED = "GC-029"
    LANDMARK_DISPLACED = "GC-030"
    BODY_HEIGHT = "GC-031"
    IMPOSSIBLE_LENGTHS = "GC-032"
    KNEE_MARKERS = "GC-033"
    GIVEN_HIPS = "GC-034"
    SITTING = "GC-035"
    UNEVEN_STANCE = "GC-036"
    BENT_KNEES = "GC-037"
    FEET_NOT_FLAT = "GC-038"
    SHORT_STATIC = "GC-039"
    STILLNESS = "GC-040"
    STATICS_DISAGREE = "GC-041"
    MARKER_OFF_STATIC = "GC-042"
    CLUSTER_MIRRORED = "GC-043"
    CLUSTER_SLID = "GC-044"
    SEGMENTS_APART = "GC-045"
    KNEE_BENDS_ELSEWHERE = "GC-046"
    ODD_WALK = "GC-047"
    OTHER_JOINT = "GC-048"
    LOOKS_LIKE_WALK = "GC-049"
    SHORT_TRIAL = "GC-050"
    TIME_UNIT = "GC-051"
    SLOW_FRAMES = "GC-052"
    UNEVEN_TIME = "GC-053"
    HEADER_RATE = "GC-054"
    RATES_DIFFER = "GC-055"
    TOO_FAST = "GC-056"
    SMOOTHED_TOO_MUCH = "GC-057"
    MANY_NODES = "GC-058"
    FORCE_FILTER = "GC-059"
    SAME_RECORDING = "GC-060"
    BODY_MASS = "GC-061"
    STEP_LOAD = "GC-062"
    NO_STEP_ON_PLATE = "GC-063"
    WRONG_FOOT = "GC-064"
    UNDER_NO_FOOT = "GC-065"
    FOOT_OF_PLATE = "GC-066"
    PLATE_HEIGHT = "GC-067"
    FOOT_BESIDE_PLATE = "GC-068"
    CLOCKS_DIFFER = "GC-069"
    OTHER_TIMES = "GC-070"
    LOADED_IN_AIR = "GC-071"
    PLATES_ELSEWHERE = "GC-072"
    PRESSURE_LEAVES_FOOT = "GC-073"
    DIVIDED_FORCE = "GC-074"
    PLATE_DESCRIPTION = "GC-075"
    PLATE_PULLS = "GC-076"
    PLATE_OFFSET = "GC-077"
    PLATE_AXES = "GC-078"
    DEAD_CHANNEL = "GC-079"
    SATURATED_PLATE = "GC-080"
    PLATE_CORNERS = "GC-081"
    FORCE_SIGN = "GC-082"
    FORCES_NOT_USED = "GC-083"
    BOTH_FEET = "GC-084"
    BODY_SIZE = "GC-085"

    SMALL_MOVEMENT = "GC-101"
    UNDETERMINED = "GC-102"
    JOINT_AT_BOUND = "GC-103"
    OTHER_BODY = "GC-104"
    FORCES_CONTRADICT = "GC-105"
    UNSEEN_SEGMENT = "GC-106"
    FILE_EVENTS = "GC-107"
    MISSING_EVENTS = "GC-108"
    TURNING_STRIDES = "GC-109"
    NO_STANCE = "GC-110"
    EXCHANGED_BACK = "GC-111"
    ROBUST_UNSETTLED = "GC-112"
    OUTLIERS = "GC-113"
    UNMEASURED_MASS = "GC-114"
    IMPOSSIBLE_BODY = "GC-115"
    TRIALS_DISAGREE = "GC-116"
    NOT_CONVERGED = "GC-117"
    MODEL_IN_DOUBT = "GC-118"
    IMPOSSIBLE_LEG = "GC-119"
    FORCES_OF_ANOTHER = "GC-120"
    ANGLES_MOVED = "GC-121"
    FORCE_GAIN = "GC-122"
    FORCE_UNIT = "GC-123"
    FREE_MOMENT = "GC-124"
    TILTED = "GC-125"
    PLATES_EXCHANGED = "GC-126"
    TRUNK_WEIGHT = "GC-127"
    UNEXPLAINED_RESIDUAL = "GC-128"
    KNEE_AXIS = "GC-129"
    MARKER_AWAY = "GC-130"
    RESULT_EDITED = "GC-131"
    JOINT_PLACE = "GC-132"
    SEATED = "GC-133"
    NOT_ALL_STEPS = "GC-134"

    INPUT = "GC-200"
    NO_FILE = "GC-201"
    UNREADABLE = "GC-202"
    NOT_TEXT = "GC-203"
    DAMAGED_RECORDING = "GC-204"
    FILE_FORMAT = "GC-205"
    BAD_NUMBER = "GC-206"
    TOML = "GC-207"
    UNKNOWN_FIELD = "GC-208"
    MISSING_FIELD = "GC-209"
    BAD_VALUE = "GC-210"
    WHO_IT_IS = "GC-211"
    UNKNOWN_LABEL = "GC-212"
    MARKER_SET = "GC-213"
    LANDMARKS = "GC-214"
    NO_STILL_WINDOW = "GC-215"
    TOO_LITTLE_SEEN = "GC-216"
    PART_OF_TRIAL = "GC-217"
    FOLDER_TAKEN = "GC-218"
    LOCKED = "GC-219"
    CHANGED_FILE = "GC-220"
    DAMAGED_RESULT = "GC-221"
    NO_RESULT = "GC-222"
    FOLDER = "GC-223"
    COHORT = "GC-224"
    NOT_COMPARABLE = "GC-225"
    NORMAL_BANDS = "GC-226"
    TRUTH = "GC-227"
    OTHER_MODEL = "GC-228"
    BONES = "GC-229"
    NOT_WRITABLE = "GC-230"
    MONTE_CARLO = "GC-231"
    OPTION = "GC-232"
    INSTALLATION = "GC-233"
    CLUSTER = "GC-234"
    GIVEN_BY_FILE = "GC-235"
    STRIDE_TABLE = "GC-236"
    ARGUMENT = "GC-237"
    NOTHING_TO_SHOW = "GC-238"
    WORKER = "GC-239"
    INTERNAL = "GC-240"
    DOWNLOAD = "GC-241"
    PRIORS = "GC-242"
    COMMENTS = "GC-243"


class GaitcalError(Exception):
    """Base class of the errors that gaitcal raises on purpose."""

    exit_code = 1
    """Exit code of the command line; 1: the input is at fault."""
    code: Code = Code.INSTALLATION
    """Kind of error, explained by `gaitcal explain`."""


class InputError(GaitcalError):
    """Faulty input. The message is one line: file, field, value found, allowed values."""

    code = Code.INPUT
    """Default; raise with a more specific code."""

    def __init__(
        self,
        message: str,
        *,
        source: object = None,
        field: str | None = None,
        code: Code | None = None,
    ) -> None:
        self.code = code or type(self).code
        where = ": ".join(str(part) for part in (source, field) if part is not None)
        text = " ".join(str(message).split())
        super().__init__(f"{where}: {text}" if where else text)


class UsageError(InputError):
    """An option of the command line is at fault. The message is one line: option, what was found,
    what is allowed.
    """

    code = Code.OPTION
    exit_code = 2  # 2: usage, as for options that the parser of the command line refuses


class ConvergenceError(GaitcalError):
    """An iteration ended without reaching its tolerance and without a usable result."""

    code = Code.NOT_CONVERGED
    """Of every fit."""
    exit_code = 3
    """3: did not converge."""


_SIDE = re.compile(
    r"(?i:(?<![a-z])(right|left)(?![a-z]))|(?i:(?:^|(?<=[._ :-]))([rl])(?=[._ -]|$))|"
    r"^([RL])(?=[A-Z])|"
    r"(?<=[a-z0-9])([RL])$|"
    r"^([rl])(?=[A-Z])|^(Right|Left)(?=[A-Z_.])"
)
"""Side in a label: right or left as a word; R or L alone between separators, before a capital, or
last after a small letter or digit."""


def find_side(label: str) -> str:
    """Find the side in a label: `r`, `l`, or empty."""
    found = _SIDE.search(label)
    return found.group(0)[0].lower() if found else ""


def find_similar_names(name: str, allowed: Iterable[str]) -> list[str]:
    """Find the allowed name that `name` may be a misspelling of; never one of the other side.

    A name that differs only by capitals, blanks, dots, dashes and underscores is preferred:
    `L.ASIS` for `l_asis`.

    Parameters
    ----------
    name : str
        Name as it was given.
    allowed : iterable of str
        Allowed names.

    Returns
    -------
    list of str
        One name, or none.
    """
    side = find_side(name)
    there = [other for other in allowed if not side or find_side(other) in ("", side)]
    there = [other for other in there if not differ_by_side(name, other)]
    same = [other for other in there if other != name and _plain(other) == _plain(name)]
    return [
        *same,
        *(m for m in difflib.get_close_matches(name, there, n=1, cutoff=0.6) if m not in same),
    ][:1]


def _plain(name: str) -> str:
    """Remove capitals and separators from a name."""
    return re.sub(r"[\s._-]+", "", name).casefold() or name


def differ_by_side(name: str, other: str) -> bool:
    """Return whether two names differ only by r and l in one position, or by right and left."""
    a, b = name.lower(), other.lower()
    if len(a) == len(b):
        different = [{x, y} for x, y in zip(a, b, strict=True) if x != y]
        return different == [{"r", "l"}]
    return a.replace("right", "left") == b.replace("right", "left")


def suggest_name(name: str, allowed: Iterable[str]) -> str:
    """Suggest a similar name, for the end of a message: `; did you mean 'X'?`, or empty."""
    return "".join(f"; did you mean '{close}'?" for close in find_similar_names(name, allowed))


STUDY = "study"  # `Finding.where` of a finding that belongs to no single trial


class Severity(Enum):
    """Severity of a finding."""

    ERROR = "error"
    """A result of this would be wrong, or impossible: it is refused."""
    WARNING = "warning"
    """It may be right and should be checked: the result is doubtful."""
    INFO = "info"
    """A note; nothing needs to be done."""

    @property
    def rank(self) -> int:
        """Rank of the severity: 0 for the worst."""
        return list(Severity).index(self)


@dataclass(frozen=True, kw_only=True)
class Finding:
    """One finding of a check."""

    code: Code
    """Kind of finding, explained by `gaitcal explain`."""
    severity: Severity
    topic: str
    """Subject in a word or two: `units`, `labels`, `gaps`, ..."""
    where: str = ""
    """Name of the trial, or `study`; empty if the caller knows the trial."""
    found: str
    """Evidence, with numbers."""
    cure: str = ""
    """Remedy; empty if nothing needs to be done."""
    source: str = ""
    """The file at fault."""
    cause: str = ""
    """The fault, as a clause ("the heel marker R_Heel is displaced"); empty if topic and
    evidence suffice. Findings with one cause are reported once."""
    leg: str = ""
    """`r` or `l` if it concerns one leg alone."""
    weight: float = 1.0
    """Possible error of a torque in units of its error bar, roughly: the largest is reported first.
    """

    @property
    def evidence(self) -> str:
        """The cause, if any, and the evidence."""
        return f"{self.cause}: {self.found}" if self.cause else self.found

    @property
    def line(self) -> str:
        """The finding in one line: file, trial, evidence, remedy."""
        place = self.where if self.where == STUDY else f"trial '{self.where}'"
        parts = [part for part in (self.source, place, self.topic) if part]
        return f"{': '.join(parts)}: {self.evidence}" + (f"; {self.cure}" if self.cure else "")

    @classmethod
    def from_error(cls, fault: InputError, where: str, source: str, topic: str) -> "Finding":
        """Make a finding of an InputError, with a text that already contains the allowed values."""
        text = str(fault).removeprefix(f"{source}: ")
        return cls(
            code=fault.code,
            severity=Severity.ERROR,
            topic=topic,
            where=where,
            found=text,
            source=source,
        )


def join_names(names: list[str], most: int = 6) -> str:
    """Join the first names of a list, with the number of those left out."""
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more


def format_note(finding: Finding) -> str:
    """Format a finding as a note of a result, which begins with the name of its trial."""
    place = "" if finding.where in (STUDY, "") else f"{finding.where}: "
    return f"{place}{finding.evidence}" + (f"; {finding.cure}" if finding.cure else "")
