"""The marker set of one static trial: what is open in a protocol is decided by the markers that the
person wears.

- A landmark is the first of its alternatives whose markers are all seen. A medial marker that lies
  too far from the lateral one to be on the same joint is none.
- A lateral knee marker that the trial lacks is put where a knee alignment device has its corner,
  else where the file's own modelled marker is. Neither was measured in walks: they serve the static
  trial only.
- A marker that only an alternative needs which was not chosen is missed by nobody.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace

import numpy as np

from gaitcal.arrays import Array
from gaitcal.errors import Code, InputError
from gaitcal.io.recording import Recording, find_visible
from gaitcal.model.landmarks import corner, is_device
from gaitcal.model.linkage import SIDE_WORDS, SIDES
from gaitcal.model.marker_set import PARTNER, REQUIRED, MarkerSet

ROD_M = (
    0.05,
    0.15,
)  # m, allowed length of a rod of a knee alignment device; the usual one has 0.095
JOINT_WIDTH_M = (
    0.03,
    0.2,
)  # m, allowed distance between the lateral and the medial marker of a knee or an ankle


def complete_static(static: Recording, marker_set: MarkerSet) -> Recording:
    """The static trial with the lateral knee markers, and others of landmarks, that it has in
    another way; with notes.

    `static`: its labels as the set spells them. A recording that lacks nothing comes back as it is.

    Raises InputError: A marker of the device passes for the lateral knee marker.
    """
    _check_no_rod_is_a_knee(static, marker_set)
    added: dict[str, Array] = {}
    notes: list[str] = []
    seen = _seen(static)
    devices = _devices(static, marker_set)
    at_corner = {label: path for label, path in devices.items() if label not in seen}
    if at_corner:
        added |= at_corner
        notes.append(
            f"{', '.join(at_corner)}: not a marker of this trial, but the corner of a knee "
            "alignment device; the "
            "marker worn in walks may sit some mm from there"
        )
    modelled = _modelled(static, marker_set, seen | set(added))
    if modelled:
        added |= modelled
        notes.append(
            f"{', '.join(modelled)}: not a marker of this trial, but a point that the file's "
            "program modelled"
        )
    if not added:
        return static
    kept = [i for i, label in enumerate(static.labels) if label not in added]
    markers = np.concatenate(
        [static.markers[:, kept], np.stack(list(added.values()), axis=1)], axis=1
    )
    labels = (*(static.labels[i] for i in kept), *added)
    return replace(static, labels=labels, markers=markers).with_notes(*notes)


def _check_no_rod_is_a_knee(static: Recording, marker_set: MarkerSet) -> None:
    """The end of a rod under the name of the knee marker would put the knee 95 mm outwards of where
    it is.
    """
    seen = _seen(static)
    for label, (axis, second, third) in marker_set.knee_device.items():
        rods = {label, second, third} <= seen and axis not in seen
        if rods and is_device(*(path_of(static, part) for part in (label, second, third))):
            raise InputError(
                f"found the end of a rod of a knee alignment device, as far from '{second}' and "
                f"'{third}' as they are "
                "from each other; allowed: a marker on the knee. "
                f"Leave its label as '{axis}': the set knows the device",
                source=static.source,
                field=f"marker '{label}'",
                code=Code.MARKER_SET,
            )


def _modelled(static: Recording, marker_set: MarkerSet, seen: set[str]) -> dict[str, Array]:
    """Marker -> (nf, 3) m, points that another program computed, for landmarks that no marker
    `seen` gives.
    """
    labels = () if static.computed is None else static.computed.labels
    paths = {label: path for label in labels if (path := _computed(static, label)) is not None}
    at = {label: path for label, path in paths.items() if np.isfinite(path).any()}
    out: dict[str, Array] = {}
    for name in marker_set.landmarks:
        options = marker_set.options(name)
        if not any(seen.issuperset(group) for group in options):
            group = next((group for group in options if (seen | set(at)).issuperset(group)), ())
            out |= {label: at[label] for label in group if label not in seen}
    return out


def present_markers(
    marker_set: MarkerSet, static: Recording, elsewhere: Iterable[str] = ()
) -> MarkerSet:
    """The set with nothing left open, as the static trial (from `complete_static`) shows it worn;
    its notes say how.

    A required landmark that the trial gives in no way stays as the set prefers it, so that its
    absence can be told; but heel or toe, where no trial has it (`elsewhere`: labels of the other
    trials) and the other end of the foot is there.
    """
    if not (marker_set.alternatives or marker_set.optional or marker_set.knee_device):
        return marker_set
    seen = _seen(static)
    landmarks: dict[str, tuple[str, ...]] = {}
    choices: list[str] = []
    notes: list[str] = []
    for name in marker_set.landmarks:
        options = marker_set.options(name)
        chosen = options[0] if len(options) == 1 and name not in PARTNER else None
        for group in options:
            if seen.issuperset(group) and _fits(name, group, marker_set, landmarks, static, notes):
                chosen = group
                break
        if (
            chosen is None
            and name in REQUIRED
            and not _guessed(name, marker_set, static, seen, set(elsewhere))
        ):
            chosen = options[0]
        if chosen is None:
            continue
        landmarks[name] = chosen
        if len(options) > 1 and seen.issuperset(chosen):
            instead = (
                f", as {', '.join(options[0])} are not worn"
                if name in REQUIRED and chosen != options[0]
                else ""
            )
            choices.append(f"{name} is {', '.join(chosen)}{instead}")
    whole = _devices(static, marker_set)
    for label, parts in marker_set.knee_device.items():
        if label in whole or _on_rod(static, label, parts[0]):
            side = _side_of(marker_set, label)
            landmarks[f"knee_axis_{side}"] = (parts[0],)
            of = ", ".join(parts) if label in whole else f"{parts[0]} and the modelled {label}"
            notes.append(
                f"knee, {SIDE_WORDS[side]}: {of} taken as a knee alignment device, whose rod is "
                "the "
                "direction of the knee's axis"
            )
    tracking, static_only = _groups(marker_set, landmarks, seen)
    made = replace(
        marker_set,
        landmarks=landmarks,
        alternatives={},
        knee_device={},
        devices=tuple(m for parts in marker_set.knee_device.values() for m in parts),
        notes=(
            *(
                [f"landmarks of the set that have alternatives: {'; '.join(choices)}"]
                if choices
                else []
            ),
            *notes,
        ),
        tracking=tracking,
        static_only=static_only,
        optional={},
    )
    known = set(made.labels)
    return replace(
        made,
        weights={label: weight for label, weight in made.weights.items() if label in known},
        reasons={label: why for label, why in made.reasons.items() if label in known},
        aliases={label: others for label, others in made.aliases.items() if label in known},
    )


def _guessed(
    name: str, marker_set: MarkerSet, static: Recording, seen: set[str], elsewhere: set[str]
) -> bool:
    """Whether this end of a foot has no marker in any trial, while the other end has one."""
    if name not in PARTNER:
        return False
    known = {label for group in marker_set.options(name) for label in group}
    other = marker_set.options(PARTNER[name]) if PARTNER[name] in marker_set.landmarks else ()
    return known.isdisjoint({*static.labels, *elsewhere}) and any(
        seen.issuperset(group) for group in other
    )


def _groups(
    marker_set: MarkerSet, landmarks: Mapping[str, tuple[str, ...]], seen: set[str]
) -> Iterator[dict[str, tuple[str, ...]]]:
    """`tracking` and `static_only`, those of `optional` among them, without what nobody wears and
    nobody misses.
    """
    in_use = {label for group in landmarks.values() for label in group}
    open_names = [
        name
        for name in marker_set.landmarks
        if name in marker_set.alternatives or name not in landmarks
    ]
    rejected = (
        {m for name in open_names for group in marker_set.options(name) for m in group}
        - in_use
        - seen
    )
    tracking = {
        s: tuple(m for m in labels if m not in rejected)
        for s, labels in marker_set.tracking.items()
    }
    static_only = {
        s: tuple(m for m in labels if m not in rejected)
        for s, labels in marker_set.static_only.items()
    }
    lasting = {m for name, group in landmarks.items() if "_med_" not in name for m in group}
    for segment, labels in marker_set.optional.items():
        there = tuple(m for m in labels if m in seen)
        always = (
            there
            if seen.isdisjoint(tracking.get(segment, ()))
            else tuple(m for m in there if m in lasting)
        )
        tracking[segment] = (*tracking.get(segment, ()), *always)
        static_only[segment] = (
            *static_only.get(segment, ()),
            *(m for m in there if m not in always),
        )
    followed = {
        s for s, labels in tracking.items() if any(marker_set.weight(m) > 0 for m in labels)
    }
    for segment in set(static_only) - followed:  # landmarks without a cluster
        tracking[segment] = (*tracking.get(segment, ()), *static_only.pop(segment))
    return (
        {s: labels for s, labels in table.items() if labels} for table in (tracking, static_only)
    )


def _seen(recording: Recording) -> set[str]:
    """Labels of markers with a position in some frame."""
    seen = find_visible(recording.markers)
    return {label for i, label in enumerate(recording.labels) if seen[:, i].any()}


def path_of(recording: Recording, label: str) -> Array:
    """(nf, 3) m, of a marker."""
    return recording.markers[:, recording.labels.index(label)]


def _mean(recording: Recording, labels: tuple[str, ...]) -> Array:
    """(nf, 3) m."""
    return np.mean([path_of(recording, label) for label in labels], axis=0)


def _devices(static: Recording, marker_set: MarkerSet) -> dict[str, Array]:
    """Lateral knee marker -> (nf, 3) m, corner of the device that the trial has in its place."""
    seen, out = _seen(static), dict[str, Array]()
    right, left = (marker_set.landmarks.get(f"asis_{side}", ()) for side in SIDES)
    known = right and left and seen.issuperset({*right, *left})
    across = _mean(static, left) - _mean(static, right) if known else None
    for label, parts in marker_set.knee_device.items():
        if not seen.issuperset(parts):
            continue
        axis, second, third = (path_of(static, part) for part in parts)
        if is_device(axis, second, third):
            inwards = across if across is None or _side_of(marker_set, label) == "r" else -across
            found = corner(axis, second, third, inwards, _computed(static, label))
            if found is not None:
                out[label] = found
    return out


def _computed(static: Recording, label: str) -> Array | None:
    """(nf, 3) m, where another program has a marker; None where it has none."""
    if static.computed is None or label not in static.computed.labels:
        return None
    return static.computed.points[:, static.computed.labels.index(label)]


def _on_rod(static: Recording, label: str, end: str) -> bool:
    """Whether a modelled knee marker and a measured one are as far apart as a rod of the device is
    long.

    Its other markers were then seen by the program that modelled the knee, if not by us.
    """
    if _computed(static, label) is None or not {label, end} <= _seen(static):
        return False
    return ROD_M[0] <= _apart(path_of(static, end), path_of(static, label)) <= ROD_M[1]


def _apart(one: Array, other: Array) -> float:
    """m, median distance of two paths (nf, 3); NaN where they are never seen together."""
    apart = np.linalg.norm(one - other, axis=1)
    apart = apart[np.isfinite(apart)]
    return float(np.median(apart)) if len(apart) else np.nan


def _side_of(marker_set: MarkerSet, label: str) -> str:
    """Side of the knee on which a lateral marker sits."""
    return next((s for s in SIDES if label in marker_set.landmarks.get(f"knee_lat_{s}", ())), "r")


def _fits(
    name: str,
    group: tuple[str, ...],
    marker_set: MarkerSet,
    landmarks: Mapping[str, tuple[str, ...]],
    static: Recording,
    notes: list[str],
) -> bool:
    """Whether markers can be a landmark: a medial one lies as far from the lateral one as a joint
    is wide.
    """
    joint, _, side = name.partition("_med_")
    lateral = landmarks.get(
        f"{joint}_lat_{side}", marker_set.landmarks.get(f"{joint}_lat_{side}", ())
    )
    if joint not in ("knee", "ankle") or not lateral or not _seen(static).issuperset(lateral):
        return True
    apart = _apart(_mean(static, group), _mean(static, lateral))
    if JOINT_WIDTH_M[0] <= apart <= JOINT_WIDTH_M[1]:
        return True
    found = f"{1e3 * apart:.0f} mm from" if np.isfinite(apart) else "never seen with"
    notes.append(
        f"{', '.join(group)} not taken for {name}: {found} {', '.join(lateral)}, no width of a "
        "joint"
    )
    return False
