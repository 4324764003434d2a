"""A marker set of your own: a TOML file that says which marker is which landmark and follows which
segment.

    python scripts/examples/04_own_marker_set.py OUT
        a synthetic person, with the set it was recorded with and with the smaller one below
    python scripts/examples/04_own_marker_set.py OUT ONE.toml TWO.toml
        two study files of your own, of the same trials, that name different sets

Prints what the other set does to marker errors and joint torques.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

import gaitcal as gc

OWN_SET = """
description = "Without head, wrists and half of the foot"

[landmarks] # {S} stands for R and L, {s} for r and l; a list means the mean of its markers
"asis_{s}" = "{S}.ASIS"
sacrum = "V.Sacral"
"knee_lat_{s}" = "{S}.Knee.Lat"
"knee_med_{s}" = "{S}.Knee.Med"
"ankle_lat_{s}" = "{S}.Ankle.Lat"
"ankle_med_{s}" = "{S}.Ankle.Med"
"heel_{s}" = "{S}.Heel"
"toe_{s}" = "{S}.Toe.Tip"
"acromion_{s}" = "{S}.Acromium"
"elbow_lat_{s}" = "{S}.Elbow"

[tracking]
pelvis = ["R.ASIS", "L.ASIS", "V.Sacral"]
"thigh_{s}" = ["{S}.Thigh.Upper", "{S}.Thigh.Front", "{S}.Thigh.Rear"]
"shank_{s}" = ["{S}.Shank.Upper", "{S}.Shank.Front", "{S}.Shank.Rear"]
"foot_{s}" = ["{S}.Heel", "{S}.Midfoot.Lat", "{S}.Toe.Tip"]
head_trunk = ["Sternum", "R.Acromium", "L.Acromium"]
"upper_arm_{s}" = ["{S}.Bicep", "{S}.Elbow"]

[static_only]
"thigh_{s}" = ["{S}.Knee.Lat", "{S}.Knee.Med"]
"shank_{s}" = ["{S}.Ankle.Lat", "{S}.Ankle.Med"]

[weights]
"{S}.Bicep" = { weight = 0.2, reason = "the moving shoulder girdle, which the model lacks, carries the arm" }
"{S}.Elbow" = { weight = 0.2, reason = "the moving shoulder girdle, which the model lacks, carries the arm" }
"""  # noqa: E501


def example(out: Path) -> tuple[Path, Path]:
    """A synthetic person's study file, and one beside it that names the set above."""
    study = gc.synthesize(out / "subject", seed=1, noise=True)
    (study.parent / "my_markers.toml").write_text(OWN_SET, encoding="utf-8")
    other = study.with_name("study_my_markers.toml")
    text = study.read_text(encoding="utf-8").replace('set = "published"', 'set = "my_markers.toml"')
    text = text.split("[truth]")[0]  # which is told in the frames of the first set
    other.write_text(text, encoding="utf-8")
    return study, other


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("out", type=Path)
    parser.add_argument("studies", type=Path, nargs="*", metavar="STUDY.toml")
    chosen = parser.parse_args(arguments)
    if len(chosen.studies) not in (0, 2):
        parser.error("give two study files, or none")
    first, second = (gc.Study.load(path) for path in chosen.studies or example(chosen.out))
    for study in (first, second):
        used = study.marker_set
        print(
            f"{used.name}: {len(used.labels)} markers on {len(used.tracking)} segments. "
            f"{used.description}"
        )
    compare(gc.calibrate(first), gc.calibrate(second))


def compare(first: gc.Calibration, second: gc.Calibration) -> None:
    """Print marker errors and torques of the one beside the other."""
    for trial in first.trials:
        other = second.trial(trial.name)
        before, after = (1e3 * (t.calibrated.errors.rms() or 0.0) for t in (trial, other))
        print(f"{trial.name}: RMS marker error {before:.2f} mm, with the other set {after:.2f} mm")
        if trial.loads is None or other.loads is None:
            continue
        valid = trial.loads.reactions.valid & other.loads.reactions.valid
        change = trial.loads.final.tau[valid] - other.loads.final.tau[valid]
        share = 100.0 * np.sqrt(np.mean(change**2, axis=0)) / first.model.subject.bwh
        for name in ("hip_flexion_r", "hip_adduction_r", "knee_angle_r", "ankle_angle_r"):
            print(
                f"  {name}: torque differs by {share[gc.COORDINATES.index(name)]:.2f} % of body "
                "weight x height (RMS)"
            )


if __name__ == "__main__":
    main()
