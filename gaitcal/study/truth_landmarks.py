"""Whether a study's static trial is the one in whose segment frames its truth is told.

Segment frames are made of the landmarks of the static trial: another static trial, or another marker set of the same
name, makes others, and the true numbers then mean something else. The truth therefore names its landmarks (`[truth]`
landmarks, a CSV file): their distances from each other, and their heights above their mean, must be those that the
study finds. Neither changes where the laboratory is turned about the vertical, the floor lies higher, or the recording
is converted to another format.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from gaitcal.arrays import Array
from gaitcal.codes import Code
from gaitcal.errors import InputError
from gaitcal.io.recording import Recording
from gaitcal.io.still import still_window
from gaitcal.model.landmarks import static_posture
from gaitcal.model.marker_roles import MarkerSet
from gaitcal.study.truth_rows import read_rows

COLUMNS = ["name", "x", "y", "z"]
SAME = 1e-4
"""m: files keep a thousandth of this; a tenth of a millimetre turns a segment by less than 0.1 degrees."""


def landmarks_text(landmarks: Mapping[str, Array]) -> str:
    """The content of the landmarks file: name -> (3,) m, laboratory, y up."""
    import pandas as pd

    rows = [[name, *map(float, place)] for name, place in landmarks.items()]
    text: str = pd.DataFrame(rows, columns=COLUMNS).to_csv(index=False, lineterminator="\n", float_format="%.9g")
    return f"# landmarks of the static trial in m, laboratory, y up\n{text}"


def read_landmarks(path: Path) -> dict[str, Array]:
    """Landmark -> (3,) m. InputError, one line, where the file is not as `landmarks_text` writes it."""
    rows = read_rows(path)
    if list(rows.names) != COLUMNS or not rows.lines:
        raise InputError(
            f"found columns {list(rows.names)}; allowed: name,x,y,z and a landmark a row", source=path, code=Code.TRUTH
        )
    places = rows.numbers(COLUMNS[1:])
    if not np.isfinite(places).all():
        raise InputError(
            "found a place that is no finite number; allowed: m", source=path, field="x,y,z", code=Code.TRUTH
        )
    return dict(zip((row[0] for row in rows.cells()), places, strict=True))


def other_landmarks(told: Mapping[str, Array], static: Recording, marker_set: MarkerSet) -> str | None:
    """Why the landmarks of a static trial, as worn by `marker_set`, are not those of the truth; None: they are."""
    found = static_posture(static, marker_set, still_window(static, marker_set.labels).frames).landmarks
    unlike = sorted(set(told) ^ set(found))
    if unlike:
        there = "the static trial does not show it" if unlike[0] in told else "the truth does not have it"
        return f"found other landmarks than those of the static trial: {unlike[0]}, {there}"
    names = sorted(told)
    one, other = (np.array([places[name] for name in names]) for places in (told, found))
    gap = np.abs(_shape(one) - _shape(other))
    if gap.max() <= SAME:
        return None
    worst = names[int(np.argmax(gap.mean(axis=1)))]
    return (
        f"found landmarks that the static trial has elsewhere, by up to {1e3 * gap.max():.1f} mm ({worst} most): the "
        "truth was told in the segment frames of another static trial or marker set"
    )


def _shape(places: Array) -> Array:
    """(n, n) m: distances from each other, and on the diagonal heights above their mean."""
    out: Array = np.linalg.norm(places[:, None] - places[None], axis=-1)
    out[np.diag_indices(len(places))] = places[:, 1] - places[:, 1].mean()
    return out
