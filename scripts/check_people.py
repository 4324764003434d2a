"""Is calibration right on people? Real ones, whose joints nobody knows, and simulated ones with people's skin.

    python scripts/check_people.py [--parts hips,halves] [--only NAME,...] [--set key=value ...] [--json FILE]

hips      every real person of the data folder (`GAITCAL_DATA`): how far calibration moves the joints from their
          nominal places, and what the population's mean and scatter are
halves    uf3: hips by six isolated trials alone against gait alone, as told and with a wide prior on hips

Settings are gaitcal's defaults but for `--set`, as `[calibration]` has them.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections.abc import Mapping
from pathlib import Path

for _name in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ[_name] = "1"  # read when NumPy is loaded, which the next imports do
sys.path.insert(0, str(Path(__file__).resolve().parent))

from people import hips  # noqa: E402
from people.real import PEOPLE, changed, fitted, study_of_person  # noqa: E402
from truth.settings import changed_settings  # noqa: E402

import gaitcal  # noqa: E402

Figures = dict[str, float]


def say(*lines: str) -> None:
    """Print at once."""
    print("\n".join(lines), flush=True)


def hips_part(names: list[str], settings: Mapping[str, object]) -> Figures:
    """Movement of joints of real people."""
    fits = []
    for name in names:
        try:
            fits.append(fitted(name, changed(study_of_person(name), settings)))
        except gaitcal.InputError as fault:
            say(f"{name}: left out: {fault}")
    say(*hips.hip_lines(fits), "", *hips.population_lines(fits))
    return hips.hip_figures(fits)


def halves_part(names: list[str], settings: Mapping[str, object]) -> Figures:
    """Isolated trials against gait."""
    if "uf3" not in names:
        return {}
    found = hips.halves(settings)
    say(*hips.half_lines(found))
    return {f"{words}: largest z": float(abs(hips.gap_scores(*pair)[1]).max()) for words, pair in found.items()}


PARTS = {"hips": hips_part, "halves": halves_part}


def main(arguments: list[str] | None = None) -> dict[str, Figures]:
    """Print the parts that are asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--parts", default=",".join(PARTS), help=f"of {', '.join(PARTS)}")
    parser.add_argument("--only", default=",".join(PEOPLE), metavar="NAME,...", help=f"of {', '.join(PEOPLE)}")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="a setting of [calibration]")
    parser.add_argument("--json", type=Path, help="write the figures to this file")
    chosen = parser.parse_args(arguments)
    for words, allowed in ((chosen.parts, PARTS), (chosen.only, PEOPLE)):
        if unknown := [word for word in words.split(",") if word not in allowed]:
            parser.error(f"found {', '.join(unknown)}; allowed: {', '.join(allowed)}")
    say(f"gaitcal of {Path(gaitcal.__file__).parent}" + (f", {', '.join(chosen.set)}" if chosen.set else ""))
    out, settings = {}, changed_settings(chosen.set)
    for part in chosen.parts.split(","):
        start = time.perf_counter()
        say("", f"== {part}")
        out[part] = PARTS[part](chosen.only.split(","), settings)
        say(f"({part}: {time.perf_counter() - start:.0f} s)")
    if chosen.json:
        chosen.json.write_text(json.dumps(out, indent=1) + "\n", encoding="utf-8")
    return out


if __name__ == "__main__":
    main()
