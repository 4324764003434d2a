"""One harness of all members: each makes or spoils recordings, runs gaitcal, classifies what comes,
and reports.

    python -m scripts.validation MEMBER [options]       from a checkout; `MEMBER --help` tells what
                                                        it measures

A member is a module. Its docstring is its help, and it has

    SHARED      which of the options of `OPTIONS` it takes
    OWN         its own options, each told by `option` (optional)
    PARTS       name -> what runs it, for the option `--parts` (optional); all of them unless told
                otherwise
    run         does all of it, prints its tables, returns its results; without it the parts run one
                after the other
    passed      whether these keep their limits; exit code 1 where not (optional)

`--json` writes what `run` returns. Real recordings are those of the folder that the environment
variable GAITCAL_DATA names (`recordings.py`).
"""

from __future__ import annotations

import argparse
import json
import re
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, is_dataclass
from enum import Enum
from functools import partial
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any, TypeVar

import numpy as np
from joblib import Parallel, delayed

from gaitcal import InputError
from gaitcal.arrays import Array
from gaitcal.io.toml import tomllib

T = TypeVar("T")
MEMBERS = {
    "attacks": "attacks.check",
    "clinics": "clinics.check",
    "bones": "bones.check",
    "people": "people.check",
    "truth": "truth.check",
    "vendors": "vendors",
    "force_faults": "force_faults.check",
    "sessions": "sessions",
    "priors": "priors",
    "markerless": "markerless",
    "cohorts": "cohorts",
    "muscles": "muscles",
    "events": "events",
    "readers": "readers",
}


def option(default: Any, words: str, **more: Any) -> dict[str, Any]:
    """An option with its default, or with the type of its value where it has none: a switch if that
    is False, one that may be repeated if it is a list.
    """
    if default is False:
        return {"action": "store_true", "help": words, **more}
    if isinstance(default, type):
        return {"type": default, "help": words, **more}
    if isinstance(default, list):
        return {"action": "append", "default": default, "help": words, **more}
    shown = " (default %(default)s)" if default != "" else ""
    return {"type": type(default), "default": default, "help": words + shown, **more}


OPTIONS: dict[str, dict[str, Any]] = {
    "--jobs": option(1, "so many side by side, in processes"),
    "--only": option("", "those whose name matches; a comma in names means 'or'", metavar="REGEX"),
    "--list": option(False, "print the names, run nothing"),
    "--json": option(Path, "write every figure to this file"),
    "--seed": option(0, "the first"),
    "--cache": option(Path("truth-cache"), "folder of the trials that OpenSim makes"),
    "--set": option([], "a setting of [calibration]; may be repeated", metavar="KEY=VALUE"),
}


def words_of(allowed: type[Enum] | Iterable[str], default: Iterable[Any] = ()) -> dict[str, Any]:
    """An option that takes a list with commas, of allowed words, or of members of an
    enumeration.
    """
    known = {word.value if isinstance(word, Enum) else word: word for word in allowed}

    def parse(text: str) -> list[Any]:
        found = text.split(",")
        if unknown := [word for word in found if word not in known]:
            raise argparse.ArgumentTypeError(
                f"found '{', '.join(unknown)}'; allowed: {', '.join(known)}"
            )
        return [known[word] for word in found]

    return {"type": parse, "default": list(default), "help": f"of {', '.join(known)}"}


def matching(pattern: str, names: Iterable[str]) -> list[str]:
    known = list(names)
    found = [name for name in known if re.search(pattern.replace(",", "|"), name, re.IGNORECASE)]
    if not found:
        raise SystemExit(f"--only: found '{pattern}'; allowed: {', '.join(known)}")
    return found


def changed_settings(pairs: Sequence[str]) -> dict[str, object]:
    """`--set key=value`, as a study file has it; a word needs no quotes.

    Raises
    ------
    InputError
        There is no `=`.
    """
    out: dict[str, object] = {}
    for pair in pairs:
        key, equals, value = pair.partition("=")
        if not equals:
            raise InputError(f"found '{pair}'; allowed: key=value", field="--set")
        try:
            out[key.strip()] = tomllib.loads(f"value = {value}")["value"]
        except tomllib.TOMLDecodeError:
            out[key.strip()] = value.strip()
    return out


def side_by_side(tasks: Sequence[Callable[[], T]], jobs: int) -> Iterator[T]:
    """What the tasks return, in their order and as soon as they have it; counted where somebody
    looks on.
    """
    results = Parallel(n_jobs=jobs, return_as="generator")(delayed(task)() for task in tasks)
    for number, result in enumerate(results, start=1):
        if sys.stderr.isatty():
            print(f"\r{number} of {len(tasks)} ", end="", file=sys.stderr, flush=True)
        yield result


def said(tasks: Sequence[Callable[[], T]], jobs: int) -> list[T]:
    """The same, each outcome's `line` printed as soon as it is there."""
    out = []
    for outcome in side_by_side(tasks, jobs):
        say(outcome.line)  # type: ignore[attr-defined]
        out.append(outcome)
    return out


def gaitcal(*words: object, seconds: float | None = None) -> subprocess.CompletedProcess[str]:
    """The program in a process of its own, with what it says; subprocess.TimeoutExpired where it
    takes longer.
    """
    command = [sys.executable, "-m", "gaitcal.cli", *map(str, words)]
    return subprocess.run(
        command, capture_output=True, text=True, timeout=seconds, stdin=subprocess.DEVNULL
    )


def say(*lines: str) -> None:
    print("\n".join(lines), flush=True)


def judged(name: str, figure: str, limit: str, met: bool) -> bool:
    say(f"{'met' if met else 'NOT MET'}: {name} {figure}, limit {limit}")
    return met


def write_json(found: object, file: Path) -> None:
    """Results of any member; dataclasses as their fields."""

    def plain(value: Any) -> object:
        if isinstance(value, Enum):
            return value.value
        return asdict(value) if is_dataclass(value) and not isinstance(value, type) else str(value)

    file.write_text(
        json.dumps(found, default=plain, indent=1, ensure_ascii=False) + "\n", encoding="utf-8"
    )


def parsed(member: ModuleType, name: str, arguments: Sequence[str]) -> argparse.Namespace:
    """The options of a member; `settings` are those of `--set`, `keep` writes what there is to the
    file of `--json`.
    """
    program = f"python -m scripts.validation {name}"
    raw = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(program, description=member.__doc__, formatter_class=raw)
    for option in member.SHARED:
        parser.add_argument(option, **OPTIONS[option])
    for own, told in getattr(member, "OWN", {}).items():
        parser.add_argument(own, **told)
    if parts := getattr(member, "PARTS", None):
        parser.add_argument("--parts", **words_of(parts, getattr(member, "USUAL_PARTS", parts)))
    chosen = parser.parse_args(arguments)
    if "--set" in member.SHARED:
        chosen.settings = changed_settings(chosen.set)
    file = getattr(chosen, "json", None)
    chosen.keep = (lambda found: write_json(found, file)) if file else (lambda found: None)
    return chosen


def results(name: str, *arguments: object) -> Any:
    member = import_module(f"scripts.validation.{MEMBERS[name]}")
    return _run(member, parsed(member, name, [str(word) for word in arguments]))


def _run(member: ModuleType, chosen: argparse.Namespace) -> Any:
    found = getattr(member, "run", partial(each_part, member.__dict__.get("PARTS")))(chosen)
    chosen.keep(found)
    return found


def each_part(
    parts: Mapping[str, Callable[[argparse.Namespace], T]], chosen: argparse.Namespace
) -> dict[str, T]:
    """Run the parts that are asked for, and keep what there is after each."""
    out: dict[str, T] = {}
    for part in chosen.parts:
        start = time.monotonic()
        say("", f"== {part}")
        out[part] = parts[part](chosen)
        say(f"({part}: {time.monotonic() - start:.0f} s)")
        chosen.keep(out)
    return out


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a member; exit code 1 where it is not passed."""
    raw = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(
        "python -m scripts.validation", description=__doc__, formatter_class=raw
    )
    parser.add_argument("member", choices=MEMBERS)
    parser.add_argument("options", nargs=argparse.REMAINDER, help="see: MEMBER --help")
    told = parser.parse_args(arguments)
    member = import_module(f"scripts.validation.{MEMBERS[told.member]}")
    found = _run(member, parsed(member, told.member, told.options))
    return 0 if getattr(member, "passed", lambda _: True)(found) else 1


# ------------------------------------------------------ how many errors lie within their error bars

HALF_WIDTHS = (1.0, 1.96)
"""Of the intervals of 68 and 95 %, in standard errors."""


@dataclass(frozen=True)
class Bars:
    """How many standard errors were tried, and how many intervals of each kind held the truth."""

    count: int = 0
    within: tuple[int, int] = (0, 0)
    """Of 68 and of 95 %."""
    squares: float = 0.0
    """Sum of the squared standard errors, in the unit of the figure; those without count as zero.
    """

    def __add__(self, other: Bars) -> Bars:
        within = (self.within[0] + other.within[0], self.within[1] + other.within[1])
        return Bars(self.count + other.count, within, self.squares + other.squares)

    @property
    def shares(self) -> tuple[float, float]:
        return 100.0 * self.within[0] / self.count, 100.0 * self.within[1] / self.count

    @property
    def rms(self) -> float:
        return float(np.sqrt(self.squares / self.count))


def bars(errors: Array, standard_errors: Array) -> Bars:
    """Count them; an error without a standard error (NaN) is one whose interval has no width, and
    holds nothing.
    """
    errors, widths = np.ravel(errors), np.nan_to_num(np.ravel(standard_errors), nan=0.0)
    first, second = (int((np.abs(errors) < width * widths).sum()) for width in HALF_WIDTHS)
    return Bars(errors.size, (first, second), float((widths**2).sum()))


def shares(z: Array) -> tuple[float, float]:
    """% of errors in standard errors that lie within the intervals of 68 and 95 %."""
    first, second = (100.0 * float(np.mean(np.abs(z) < width)) for width in HALF_WIDTHS)
    return first, second


def coverage(z: Array) -> str:
    first, second = shares(z)
    return (
        f"{first:.0f}% of {len(z)} inside 68 %, {second:.0f}% inside 95 %, RMS {rms(z):.2f} "
        "standard errors"
    )


def rms(values: object) -> float:
    """Of all that is there: NaN does not count."""
    return float(np.sqrt(np.nanmean(np.square(np.asarray(values, dtype=float)))))
