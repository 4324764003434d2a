"""Resolve the alternatives of a marker set by the markers worn in the static trial.

- A landmark is the first of its options whose markers are all visible. A medial marker too far from
  the lateral one cannot be on the same joint, and is not used.
- A missing lateral knee marker is placed at the corner of a knee alignment device, or else at the
  modelled marker of the file. Neither is measured in walks, so it serves the static trial only.
- Markers used only by a rejected alternative are not reported as missing.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace

import numpy as np

from gaitcal.arrays import Array
from gaitcal.errors import Code, InputError
from gaitcal.io.recording import Recording, find_visible
from gaitcal.model.landmarks import is_device, locate_device_corner
from gaitcal.model.linkage import SIDE_WORDS, SIDES
from gaitcal.model.marker_set import PARTNER, REQUIRED, MarkerSet

# m, allowed length of a rod of a knee alignment device; the usual one has 0.095
ROD_M = (0.05, 0.15)
# m, allowed distance between the lateral and the medial marker of a knee or an ankle
JOINT_WIDTH_M = (0.03, 0.2)


def complete_static(static: Recording, marker_set: MarkerSet) -> Recording:
    """Complete the static trial with markers of landmarks that it contains in another form.

    These are lateral knee markers at the corner of a device, and points that another program
    modelled.

    Parameters
    ----------
    static : Recording
        The static trial, with labels as the set spells them.
    marker_set : MarkerSet
        The set, with its alternatives.

    Returns
    -------
    Recording
        With notes; the same object if nothing is added.

    Raises
    ------
    InputError
        A marker of the device is named like the lateral knee marker.
    """
    _check_knee_is_no_rod(static, marker_set)
    added: dict[str, Array] = {}
    notes: list[str] = []
    observed = _find_observed(static)
    devices = _find_devices(static, marker_set)
    at_corner = {label: path for label, path in devices.items() if label not in observed}
    if at_corner:
        added |= at_corner
        notes.append(
            f"{', '.join(at_corner)}: not a marker of this trial, but the corner of a knee "
            "alignment device; the "
            "marker worn in walks may sit some mm from there"
        )
    modelled = _find_modelled_points(static, marker_set, observed | set(added))
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


def _check_knee_is_no_rod(static: Recording, marker_set: MarkerSet) -> None:
    """Check that no end of a rod has the name of the knee marker: it is 95 mm too far outwards."""
    observed = _find_observed(static)
    for label, (axis, second, third) in marker_set.knee_device.items():
        rods = {label, second, third} <= observed and axis not in observed
        if rods and is_device(*(get_path(static, part) for part in (label, second, third))):
            raise InputError(
                f"found the end of a rod of a knee alignment device, as far from '{second}' and "
                f"'{third}' as they are "
                "from each other; allowed: a marker on the knee. "
                f"Leave its label as '{axis}': the set knows the device",
                source=static.source,
                field=f"marker '{label}'",
                code=Code.MARKER_SET,
            )


def _find_modelled_points(
    static: Recording, marker_set: MarkerSet, observed: set[str]
) -> dict[str, Array]:
    """Find computed points (nf, 3) m of landmarks without visible markers: marker -> path."""
    labels = () if static.computed is None else static.computed.labels
    paths = {
        label: path for label in labels if (path := _find_computed_path(static, label)) is not None
    }
    at = {label: path for label, path in paths.items() if np.isfinite(path).any()}
    out: dict[str, Array] = {}
    for name in marker_set.landmarks:
        options = marker_set.options(name)
        if not any(observed.issuperset(group) for group in options):
            group = next((group for group in options if (observed | set(at)).issuperset(group)), ())
            out |= {label: at[label] for label in group if label not in observed}
    return out


def resolve_marker_set(
    marker_set: MarkerSet, static: Recording, elsewhere: Iterable[str] = ()
) -> MarkerSet:
    """Resolve the alternatives of a marker set as the static trial shows them.

    Parameters
    ----------
    marker_set : MarkerSet
        The set, with its alternatives.
    static : Recording
        The static trial from `complete_static`.
    elsewhere : iterable of str
        Labels of the other trials.

    Returns
    -------
    MarkerSet
        Without alternatives; its notes list the choices. A required landmark that is missing keeps
        its preferred markers, so that its absence is reported. Heel or toe is left out if no trial
        has its marker and the other end of the foot is marked.
    """
    if not (marker_set.alternatives or marker_set.optional or marker_set.knee_device):
        return marker_set
    observed = _find_observed(static)
    landmarks: dict[str, tuple[str, ...]] = {}
    choices: list[str] = []
    notes: list[str] = []
    for name in marker_set.landmarks:
        options = marker_set.options(name)
        chosen = options[0] if len(options) == 1 and name not in PARTNER else None
        for group in options:
            if observed.issuperset(group) and _is_plausible(
                name, group, marker_set, landmarks, static, notes
            ):
                chosen = group
                break
        if (
            chosen is None
            and name in REQUIRED
            and not _is_guessed(name, marker_set, static, observed, set(elsewhere))
        ):
            chosen = options[0]
        if chosen is None:
            continue
        landmarks[name] = chosen
        if len(options) > 1 and observed.issuperset(chosen):
            instead = (
                f", as {', '.join(options[0])} are not worn"
                if name in REQUIRED and chosen != options[0]
                else ""
            )
            choices.append(f"{name} is {', '.join(chosen)}{instead}")
    whole = _find_devices(static, marker_set)
    for label, parts in marker_set.knee_device.items():
        if label in whole or _is_on_rod(static, label, parts[0]):
            side = _find_side(marker_set, label)
            landmarks[f"knee_axis_{side}"] = (parts[0],)
            found = ", ".join(parts) if label in whole else f"{parts[0]} and the modelled {label}"
            notes.append(
                f"knee, {SIDE_WORDS[side]}: {found} taken as a knee alignment device, whose rod is "
                "the "
                "direction of the knee's axis"
            )
    tracking, static_only = _assign_groups(marker_set, landmarks, observed)
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


def _is_guessed(
    name: str, marker_set: MarkerSet, static: Recording, observed: set[str], elsewhere: set[str]
) -> bool:
    """Return whether this end of a foot has no marker in any trial while the other end has one."""
    if name not in PARTNER:
        return False
    known = {label for group in marker_set.options(name) for label in group}
    other = marker_set.options(PARTNER[name]) if PARTNER[name] in marker_set.landmarks else ()
    return known.isdisjoint({*static.labels, *elsewhere}) and any(
        observed.issuperset(group) for group in other
    )


def _assign_groups(
    marker_set: MarkerSet, landmarks: Mapping[str, tuple[str, ...]], observed: set[str]
) -> Iterator[dict[str, tuple[str, ...]]]:
    """Assign the markers to `tracking` and `static_only`, those of `optional` included.

    Markers of rejected alternatives that are not visible are left out.
    """
    in_use = {label for group in landmarks.values() for label in group}
    open_names = []
    for name in marker_set.landmarks:
        if name in marker_set.alternatives or name not in landmarks:
            open_names.append(name)
    rejected = (
        {m for name in open_names for group in marker_set.options(name) for m in group}
        - in_use
        - observed
    )

    def keep(labels: tuple[str, ...]) -> tuple[str, ...]:
        return tuple(m for m in labels if m not in rejected)

    tracking = {segment: keep(labels) for segment, labels in marker_set.tracking.items()}
    static_only = {segment: keep(labels) for segment, labels in marker_set.static_only.items()}
    # medial markers are worn in the static trial only
    lasting = {m for name, group in landmarks.items() if "_med_" not in name for m in group}
    for segment, labels in marker_set.optional.items():
        there = tuple(m for m in labels if m in observed)
        always = (
            there
            if observed.isdisjoint(tracking.get(segment, ()))
            else tuple(m for m in there if m in lasting)
        )
        tracking[segment] = (*tracking.get(segment, ()), *always)
        static_only[segment] = (
            *static_only.get(segment, ()),
            *(m for m in there if m not in always),
        )
    followed = {
        s for s, labels in tracking.items() if max(map(marker_set.weight, labels), default=0.0) > 0
    }
    # segments with landmarks but without a cluster are tracked by their landmarks
    for segment in set(static_only) - followed:
        tracking[segment] = (*tracking.get(segment, ()), *static_only.pop(segment))
    for table in (tracking, static_only):
        yield {s: labels for s, labels in table.items() if labels}


def _find_observed(recording: Recording) -> set[str]:
    """Find the labels of markers with a position in some frame."""
    observed = find_visible(recording.markers)
    return {label for i, label in enumerate(recording.labels) if observed[:, i].any()}


def get_path(recording: Recording, label: str) -> Array:
    """Get the path (nf, 3) m of a marker."""
    return recording.markers[:, recording.labels.index(label)]


def _average_paths(recording: Recording, labels: tuple[str, ...]) -> Array:
    """Average the paths (nf, 3) m of some markers."""
    return np.mean([get_path(recording, label) for label in labels], axis=0)


def _find_devices(static: Recording, marker_set: MarkerSet) -> dict[str, Array]:
    """Find the corners of knee alignment devices: lateral knee marker -> (nf, 3) m."""
    observed, out = _find_observed(static), dict[str, Array]()
    right, left = (marker_set.landmarks.get(f"asis_{side}", ()) for side in SIDES)
    known = right and left and observed.issuperset({*right, *left})
    across = _average_paths(static, left) - _average_paths(static, right) if known else None
    for label, parts in marker_set.knee_device.items():
        if not observed.issuperset(parts):
            continue
        axis, second, third = (get_path(static, part) for part in parts)
        if is_device(axis, second, third):
            inwards = across if across is None or _find_side(marker_set, label) == "r" else -across
            found = locate_device_corner(
                axis, second, third, inwards, _find_computed_path(static, label)
            )
            if found is not None:
                out[label] = found
    return out


def _find_computed_path(static: Recording, label: str) -> Array | None:
    """Find the path (nf, 3) m of a point that another program computed; None if there is none."""
    if static.computed is None or label not in static.computed.labels:
        return None
    return static.computed.points[:, static.computed.labels.index(label)]


def _is_on_rod(static: Recording, label: str, end: str) -> bool:
    """Return whether a modelled knee marker is as far from a measured one as a rod is long.

    The program that modelled the knee has then used the other markers of the device.
    """
    if _find_computed_path(static, label) is None or not {label, end} <= _find_observed(static):
        return False
    return ROD_M[0] <= _measure_distance(get_path(static, end), get_path(static, label)) <= ROD_M[1]


def _measure_distance(one: Array, other: Array) -> float:
    """Measure the median distance (m) of two paths (nf, 3); NaN if never visible together."""
    distance = np.linalg.norm(one - other, axis=1)
    distance = distance[np.isfinite(distance)]
    return float(np.median(distance)) if len(distance) else np.nan


def _find_side(marker_set: MarkerSet, label: str) -> str:
    """Find the side of the knee that a lateral marker is on."""
    return next((s for s in SIDES if label in marker_set.landmarks.get(f"knee_lat_{s}", ())), "r")


def _is_plausible(
    name: str,
    group: tuple[str, ...],
    marker_set: MarkerSet,
    landmarks: Mapping[str, tuple[str, ...]],
    static: Recording,
    notes: list[str],
) -> bool:
    """Return whether markers can be a landmark: a medial one a joint width from the lateral one."""
    joint, _, side = name.partition("_med_")
    lateral = landmarks.get(
        f"{joint}_lat_{side}", marker_set.landmarks.get(f"{joint}_lat_{side}", ())
    )
    if (
        joint not in ("knee", "ankle")
        or not lateral
        or not _find_observed(static).issuperset(lateral)
    ):
        return True
    distance = _measure_distance(_average_paths(static, group), _average_paths(static, lateral))
    if JOINT_WIDTH_M[0] <= distance <= JOINT_WIDTH_M[1]:
        return True
    found = f"{1e3 * distance:.0f} mm from" if np.isfinite(distance) else "never seen with"
    notes.append(
        f"{', '.join(group)} not taken for {name}: {found} {', '.join(lateral)}, no width of a "
        "joint"
    )
    return False
