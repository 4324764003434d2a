"""Measure the static posture: mean markers and landmarks, and their plausibility.

Errors of a file are found here, before the geometry uses it: missing or never visible landmarks,
swapped sides or medial and lateral markers, lengths that no body of that height has.

A knee alignment device (KAD) replaces the lateral knee marker. Its three markers are the ends of
three orthogonal rods of one length L that meet at the position of that marker. The rod of the first
marker is parallel to the flexion axis. The markers are L sqrt(2) apart, and with their mean c, the
unit normal n of their plane and their mean distance d

    corner = c + n d / sqrt(6),      n towards the other knee.

The rods are inclined by 55 deg to n. So n points inwards along the line between both ASIS as far as
the knee axis does. The line to the middle of the pelvis is mostly vertical and cannot be used.
(Vicon, Plug-in Gait reference guide. In static trials of two hospitals the corner is within 0.1 mm
of the knee marker that Vicon's program computed.)
"""

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np

from gaitcal.arrays import Array
from gaitcal.errors import Code, InputError, suggest_name
from gaitcal.io.recording import Recording, average_visible
from gaitcal.model.linkage import SIDES
from gaitcal.model.marker_set import PARTNER, REQUIRED, MarkerSet, describe_substitute

PLAUSIBLE = {
    "distance between the ASIS": (0.08, 0.25),
    "knee to ankle": (0.15, 0.36),
    "heel to toe": (0.05, 0.25),
}
"""Allowed lengths as fractions of height. The nominal subject has 0.144, 0.222, 0.160."""
FOOT_TO_SHANK = 0.46
"""Heel to toe marker, on the second metatarsal, over knee to ankle marker: 0.38 to 0.49 on ten feet
of five people.
"""


@dataclass(frozen=True)
class StaticPosture:
    """Mean positions in the still window of the static trial, laboratory."""

    source: str
    # label -> (3,) m, for every visible marker of the set
    markers: Mapping[str, Array]
    # landmark -> (3,) m, for every landmark whose markers were all visible
    landmarks: Mapping[str, Array]
    # landmark of the set -> its markers that were not visible
    absent: Mapping[str, tuple[str, ...]]
    # landmarks that no marker shows, and how they were guessed
    notes: tuple[str, ...] = ()
    hips: Mapping[str, Array] = field(default_factory=dict)
    """Side -> (3,) m: hip centres that the file itself has, measured or computed by another
    program.
    """
    # side -> their names
    hip_labels: Mapping[str, str] = field(default_factory=dict)

    def has(self, *names: str) -> bool:
        """Return whether all these landmarks are available."""
        return all(name in self.landmarks for name in names)

    def describe_absence(self, name: str) -> str:
        """Describe why a landmark is missing, for use in brackets."""
        if name in self.absent:
            return f"marker {', '.join(self.absent[name])} was not seen"
        return f"the marker set names no {name}"


def measure_static_posture(
    recording: Recording, marker_set: MarkerSet, window: slice
) -> StaticPosture:
    """Measure mean positions of markers and landmarks in a window of a static trial.

    Parameters
    ----------
    recording : Recording
        The static trial, with the labels of the marker set; m, y up.
    marker_set : MarkerSet
        Meaning of the markers, with no alternatives left open.
    window : slice
        Frames in which the person stands still.

    Returns
    -------
    StaticPosture
        Mean positions (m) in the laboratory, and notes about guessed landmarks.

    Raises
    ------
    InputError
        A required landmark is missing. The message names its marker and possible replacements.
    """
    column = {label: i for i, label in enumerate(recording.labels)}
    markers = average_visible(
        {m: recording.markers[window, column[m]] for m in marker_set.labels if m in column}
    )
    landmarks: dict[str, Array] = {}
    absent: dict[str, tuple[str, ...]] = {}
    for name, labels in marker_set.landmarks.items():
        if missing := tuple(label for label in labels if label not in markers):
            absent[name] = missing
        else:
            landmarks[name] = np.mean([markers[label] for label in labels], axis=0)
    notes: list[str] = []
    one = find_single_psis(marker_set, markers)
    if one and "sacrum" in absent and {"asis_r", "asis_l"} <= set(landmarks):
        # the middle of one posterior spine and its mirror image, in the plane midway between the
        # ASIS and across them
        across = landmarks["asis_r"] - landmarks["asis_l"]
        across = across / np.linalg.norm(across)
        aside = (markers[one[0]] - 0.5 * (landmarks["asis_r"] + landmarks["asis_l"])) @ across
        landmarks["sacrum"] = markers[one[0]] - aside * across
        notes.append(describe_guessed_sacrum(one[0]))
    for name in REQUIRED:
        guessed = name not in marker_set.landmarks and PARTNER.get(name) in landmarks
        if name not in landmarks and not guessed:
            raise InputError(
                _describe_missing_landmark(name, absent.get(name, ()), recording, marker_set),
                source=recording.source,
                field=f"marker set '{marker_set.name}', landmark {name}",
                code=Code.LANDMARKS,
            )
    guesses = {name: _guess_foot_end(name, landmarks) for name in PARTNER if name not in landmarks}
    for name, at in guesses.items():
        length = 1e3 * float(np.linalg.norm(at - landmarks[PARTNER[name]]))
        line = "the malleoli" if f"ankle_med_{name[-1]}" in landmarks else "the pelvis"
        notes.append(
            f"{name}: no marker; assumed {length:.0f} mm from {PARTNER[name]}, at its height "
            f"and perpendicular to the line of {line}; the direction of the foot, and so the zero "
            "of ankle angles, is an assumption"
        )
    hips, hip_labels = _locate_hips(recording, landmarks, window)
    return StaticPosture(
        recording.source, markers, landmarks | guesses, absent, tuple(notes), hips, hip_labels
    )


def find_single_psis(marker_set: MarkerSet, visible: Collection[str]) -> tuple[str, ...]:
    """Find the visible marker of the sacrum's pair if the other one is not visible.

    Parameters
    ----------
    marker_set : MarkerSet
        Its landmark `sacrum` may be the mean of two markers.
    visible : collection of str
        Labels of visible markers.

    Returns
    -------
    tuple of str
        One label; empty if both, neither, or no pair is visible.
    """
    pair = marker_set.landmarks.get("sacrum", ())
    there = tuple(label for label in pair if label in visible)
    return there if len(pair) == 2 and len(there) == 1 else ()


def describe_guessed_sacrum(label: str) -> str:
    """Describe how the sacrum is guessed from one posterior spine."""
    return (
        f"sacrum: only '{label}' of its two markers is visible; assumed midway between it and its "
        "mirror image in the median plane of the ASIS (symmetric pelvis)"
    )


def _guess_foot_end(name: str, p: Mapping[str, Array]) -> Array:
    """Guess heel or toe (3,) m of a foot with one marked end.

    It is level with the marked end and straight ahead of the ankle: horizontal, at right angles to
    the malleolar line or else to the line of the ASIS.
    """
    side = name[-1]
    outwards = 1.0 if side == "r" else -1.0
    across = p["asis_r"] - p["asis_l"]
    if f"ankle_med_{side}" in p:
        across = outwards * (p[f"ankle_lat_{side}"] - p[f"ankle_med_{side}"])
    ahead = np.cross([0.0, 1.0, 0.0], across)
    length = FOOT_TO_SHANK * np.linalg.norm(p[f"knee_lat_{side}"] - p[f"ankle_lat_{side}"])
    step = length * ahead / np.linalg.norm(ahead)
    return p[PARTNER[name]] + (step if name.startswith("toe") else -step)


def _locate_hips(
    recording: Recording, landmarks: Mapping[str, Array], window: slice
) -> tuple[dict[str, Array], dict[str, str]]:
    """Locate hip centres of the file: side -> (3,) m, and side -> label."""
    tracks = {label: recording.markers[:, i] for i, label in enumerate(recording.labels)}
    if recording.computed is not None:
        tracks = {
            n: recording.computed.points[:, i] for i, n in enumerate(recording.computed.labels)
        } | tracks
    places, names = {}, {}
    labels = find_hip_labels(tracks)
    for side, mean in average_visible(
        {side: tracks[label][window] for side, label in labels.items()}
    ).items():
        by = "" if labels[side] in recording.labels else " (computed by another program)"
        places[side], names[side] = mean, f"{labels[side]}{by}"
    for side in SIDES:
        if f"hjc_{side}" in landmarks:
            places[side], names[side] = landmarks[f"hjc_{side}"], f"landmark hjc_{side}"
    return places, names


def find_hip_labels(labels: Iterable[str]) -> dict[str, str]:
    """Find labels of hip centres among those that laboratories and OpenSim use: side -> label."""
    out: dict[str, str] = {}
    for label in labels:
        plain = "".join(c for c in label if c.isalnum()).lower()
        for side in SIDES:
            if plain in {word.replace("s", side, 1) for word in ("shjc", "hjcs", "shj", "shipjc")}:
                out.setdefault(side, label)
    return out


def _describe_missing_landmark(
    name: str, labels: tuple[str, ...], recording: Recording, marker_set: MarkerSet
) -> str:
    """Describe why a required landmark is missing, and possible replacements."""
    if not labels:
        return f"the marker set does not name it; it needs {describe_substitute(name)}"
    label, instead = labels[0], describe_substitute(name)
    if label in recording.labels:
        return f"marker '{label}' was not visible while the subject stood still; it needs {instead}"
    taken = {m for group in marker_set.landmarks.values() for m in group}
    known = suggest_name(label, [other for other in recording.labels if other not in taken])
    return (
        f"the file has no marker '{label}'{known}; instead it could be {instead}, assigned by "
        "'rename'"
    )


def check_plausible(posture: StaticPosture, height: float) -> None:
    """Check that the landmarks can be those of a person who stands upright.

    Parameters
    ----------
    posture : StaticPosture
        Landmarks of the static trial.
    height : float
        Body height, m.

    Raises
    ------
    InputError
        A length is implausible for this height, or sides, medial and lateral, or front and back are
        swapped.
    """

    def fault(found: str, field: str) -> InputError:
        return InputError(found, source=posture.source, field=field, code=Code.LANDMARKS)

    def check_length(what: str, side: str, one: str, other: str) -> None:
        found = float(np.linalg.norm(p[one] - p[other]))
        low, high = (share * height for share in PLAUSIBLE[what])
        if not low <= found <= high:
            hint = (
                "; is the file's unit of length right?"
                if found > 50 * height or found < height / 100
                else ""
            )
            raise fault(
                f"found {1e3 * found:.4g} mm; allowed: {1e3 * low:.0f} to {1e3 * high:.0f} mm "
                f"for a height of {height:.2f} m{hint}",
                what + {"": "", "r": ", right", "l": ", left"}[side],
            )

    p = posture.landmarks
    asis = p["asis_r"] - p["asis_l"]
    check_length("distance between the ASIS", "", "asis_r", "asis_l")
    right = asis / np.linalg.norm(asis)
    if right @ (p["knee_lat_r"] - p["knee_lat_l"]) < 0:
        raise fault(
            "the right knee is to the left of the left one, relative to the pelvis: are the sides "
            "swapped?",
            "landmarks asis_r, asis_l, knee_lat_r, knee_lat_l",
        )
    for s, side in zip((1.0, -1.0), SIDES, strict=True):
        check_length("knee to ankle", side, f"knee_lat_{side}", f"ankle_lat_{side}")
        check_length("heel to toe", side, f"toe_{side}", f"heel_{side}")
        for joint in ("knee", "ankle"):
            medial = p.get(f"{joint}_med_{side}")
            if medial is not None and s * right @ (p[f"{joint}_lat_{side}"] - medial) < 0:
                raise fault(
                    f"the lateral marker is on the medial side of {joint}_med_{side}: are the two "
                    "swapped?",
                    f"landmark {joint}_lat_{side}",
                )
    middle = 0.5 * (p["asis_r"] + p["asis_l"])
    up = np.cross(asis, middle - p["sacrum"])
    if up @ (middle - 0.5 * (p["ankle_lat_r"] + p["ankle_lat_l"])) < 0:
        raise fault(
            "the pelvis is upside down: are right and left, or front and back, swapped?",
            "landmarks asis_r, asis_l, sacrum",
        )


EQUAL_SIDES = 0.15
"""Share by which the distances between the three markers may differ from their mean. Real devices
are within 0.01; a triangle of other markers is not equilateral."""
# m, allowed distance between the three; the usual device has 0.134
DEVICE_SIZE_M = (0.05, 0.25)


def locate_device_corner(
    axis: Array,
    second: Array,
    third: Array,
    inwards: Array | None = None,
    modelled: Array | None = None,
) -> Array | None:
    """Locate the corner where the rods of a knee alignment device meet.

    Parameters
    ----------
    axis, second, third : (nf, 3) array
        Markers of the device, m; `axis` is on the rod along the flexion axis.
    inwards : (nf, 3) array or None
        Direction towards the other knee, of any length; None if unknown.
    modelled : (nf, 3) array or None
        Corner as computed by another program, m; it decides the side of the plane.

    Returns
    -------
    (nf, 3) array or None
        Corner, m; None if its side of the plane is unknown. The side is the same in all frames.
    """
    normal = np.cross(second - axis, third - axis)
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    normal = normal / np.where(length > 0, length, np.nan)
    mean = (axis + second + third) / 3.0
    distance = _measure_distances(axis, second, third).mean(axis=1, keepdims=True)
    for towards in (None if modelled is None else modelled - mean, inwards):
        if towards is not None:
            along = np.sum(normal * towards, axis=1)
            if np.isfinite(along).any():
                return mean + np.sign(np.nanmedian(along)) * normal * distance / np.sqrt(6.0)
    return None


def is_device(axis: Array, second: Array, third: Array) -> bool:
    """Return whether three markers have the distances of a knee alignment device.

    Parameters
    ----------
    axis, second, third : (nf, 3) array
        Markers, m; NaN if not visible.

    Returns
    -------
    bool
        Whether the median distances are equal and of the size of a device.
    """
    distances = _measure_distances(axis, second, third)
    distances = distances[np.isfinite(distances).all(axis=1)]
    typical = np.median(distances, axis=0) if len(distances) else np.full(3, np.nan)
    mean = float(typical.mean())
    return bool(
        DEVICE_SIZE_M[0] <= mean <= DEVICE_SIZE_M[1]
        and np.abs(typical - mean).max() <= EQUAL_SIDES * mean
    )


def _measure_distances(a: Array, b: Array, c: Array) -> Array:
    """Measure the distances (nf, 3) m between each two of three markers (nf, 3)."""
    return np.stack([np.linalg.norm(x - y, axis=1) for x, y in ((a, b), (a, c), (b, c))], axis=1)
