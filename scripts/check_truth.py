"""How near the truth, and do the error bars hold? One table over people, kinds of error and seeds.

    python scripts/check_truth.py [--parts gait,isolated,synthetic] [--people p01,p18] [--seeds 6] [--processes 2]
        [--kinds none,linear,...] [--set key=value ...] [--cache DIR] [--json FILE]

gait        people of `opensim_truth`, walk and static trial: joint centres, torques against OpenSim's own
isolated    the same people's six isolated trials, made by OpenSim once (extra `peers`): joint centres and axes, beside
            SCoRE and SARA
synthetic   people of our own linkage through C3D files, as `gaitcal synthesize --noise --perturb` writes them

Markers are moved as `truth/skin.py` tells: not at all (`none`; one fit a person), by the published waves, by skin that
follows the joints or its own time. `before` is the nominal model, `peer` SCoRE or SARA (RMS), `SE` the RMS of the
standard errors, then how many intervals of 68 and 95 % held the truth (a fixed parameter has none, which holds nothing)
of how many. At the end stand the limits that were set, and whether they are met. Settings are gaitcal's defaults but
for `--set`, as `[calibration]` has them.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path

for _name in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ[_name] = "1"  # read when NumPy is loaded, which the next imports do
sys.path.insert(0, str(Path(__file__).resolve().parent))

from joblib import Parallel, delayed  # noqa: E402
from truth import gait, isolated, report, synthetic, wanted  # noqa: E402
from truth.outcome import Outcome  # noqa: E402
from truth.people import made  # noqa: E402
from truth.settings import changed_settings  # noqa: E402
from truth.skin import FIVE, OF_PEOPLE, Kind  # noqa: E402

PARTS = ("gait", "isolated", "synthetic")
KINDS = {
    "gait": (Kind.NONE, Kind.SINUSOIDS, Kind.MIXTURE, Kind.PEOPLE),
    "isolated": (Kind.NONE, *FIVE, Kind.MIXTURE, Kind.PEOPLE),
}
"""What is tried unless `--kinds` says otherwise."""
WAVES_MM, GAIT_SKIN_MM, SKIN_MM = 10.0, 10.0, 15.0
"""Sizes of the published waves, and of skin movement in the parts `gait` and `isolated`."""
SYNTHETIC_PEOPLE = 9


def tasks(chosen: argparse.Namespace, data: Path | None) -> list[Callable[[], Outcome]]:
    """Every fit that is asked for, as a function that makes it."""
    out: list[Callable[[], Outcome]] = []
    for part in chosen.parts:
        if part == "synthetic":
            count = chosen.synthetic_people
            out += [partial(synthetic.run, seed, chosen.changes) for seed in range(chosen.seed, chosen.seed + count)]
            continue
        if data is None:
            raise SystemExit(f"part {part} needs the environment variable GAITCAL_DATA with opensim_truth in it")
        for person in chosen.people:
            if part == "isolated":
                made(person, data, chosen.cache)
            for kind in chosen.kinds or KINDS[part]:
                skin = SKIN_MM if part == "isolated" or kind in OF_PEOPLE else GAIT_SKIN_MM
                size = chosen.size or (WAVES_MM if kind is Kind.SINUSOIDS else skin)
                for seed in range(chosen.seed, chosen.seed + (1 if kind is Kind.NONE else chosen.seeds)):
                    common = (person, kind, seed, size, chosen.changes, data)
                    if part == "gait":
                        out.append(partial(gait.run, *common))
                    else:
                        out.append(partial(isolated.run, *common, chosen.cache, chosen.with_gait))
    return out


def words(allowed: tuple[str, ...] | None) -> Callable[[str], list[str]]:
    """A list with commas, of allowed words."""

    def parse(text: str) -> list[str]:
        found = text.split(",")
        for word in found:
            if allowed and word not in allowed:
                raise argparse.ArgumentTypeError(f"found '{word}'; allowed: {', '.join(allowed)}")
        return found

    return parse


def main(arguments: list[str] | None = None) -> list[Outcome]:
    """Make all fits and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    kinds = tuple(kind.value for kind in Kind)
    parser.add_argument("--parts", type=words(PARTS), default=list(PARTS))
    parser.add_argument("--people", type=words(None), default=["p01", "p18"], help="folders of opensim_truth")
    parser.add_argument("--kinds", type=words(kinds), default=[], help=f"of {', '.join(kinds)}")
    parser.add_argument("--seeds", type=int, default=6, help="of each kind of movement and person (default 6)")
    parser.add_argument("--seed", type=int, default=0, help="the first")
    parser.add_argument("--synthetic-people", type=int, default=SYNTHETIC_PEOPLE, metavar="N")
    parser.add_argument("--size", type=float, metavar="MM", help="of the movement, instead of each part's own")
    parser.add_argument("--with-gait", action="store_true", help="part isolated: the walk, without plates, as well")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="a setting of [calibration]")
    parser.add_argument("--cache", type=Path, default=Path("truth-cache"), help="folder of the trials OpenSim makes")
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--details", action="store_true", help="hips direction by direction, too")
    parser.add_argument("--against", type=Path, metavar="FILE", help="an earlier --json: its RMS as `then`")
    parser.add_argument("--json", type=Path, help="write every figure of every fit to this file")
    chosen = parser.parse_args(arguments)
    chosen.kinds = [Kind(kind) for kind in chosen.kinds]
    chosen.changes = changed_settings(chosen.set)
    named = os.environ.get("GAITCAL_DATA")
    jobs = tasks(chosen, Path(named).resolve() / "opensim_truth" if named else None)
    outcomes: list[Outcome] = []
    for outcome in Parallel(n_jobs=chosen.processes, return_as="generator")(delayed(job)() for job in jobs):
        outcomes.append(outcome)
        if sys.stderr.isatty():
            print(f"\r{len(outcomes)} of {len(jobs)} fits ", end="", file=sys.stderr, flush=True)
    if chosen.set:
        print(f"settings: {', '.join(chosen.set)}")
    earlier = report.read(chosen.against) if chosen.against else None
    print("\n".join([*report.lines(outcomes, earlier, details=chosen.details), *wanted.lines(outcomes)]))
    if chosen.json:
        report.write(outcomes, chosen.json)
    return outcomes


if __name__ == "__main__":
    main()
