"""A marker set as the text of a marker set file, so that a result can keep the one it was made with."""

from __future__ import annotations

from collections.abc import Mapping

from gaitcal.model.marker_set import MarkerSet
from gaitcal.toml_files import toml_table, toml_value

STUDY_S = "weight of the study"
"""Reason of weights that a study gave without one."""


def marker_set_text(marker_set: MarkerSet) -> str:
    """TOML that `load_marker_set` reads back to the same set, both sides written out.

    Weights of markers that no segment follows are left out: they pull nothing.
    """
    tables = [toml_table("", {"description": marker_set.description}).lstrip()]
    groups = {
        "landmarks": marker_set.landmarks,
        "tracking": marker_set.tracking,
        "static_only": marker_set.static_only,
        "aliases": marker_set.aliases,
    }
    tables += [toml_table(f"[{name}]", _quoted(group)) for name, group in groups.items()]
    tracked = {m for group in (marker_set.tracking, marker_set.static_only) for own in group.values() for m in own}
    weights = {
        label: {"weight": float(weight), "reason": marker_set.reasons.get(label, STUDY_S)}
        for label, weight in marker_set.weights.items()
        if label in tracked
    }
    return "\n".join([*tables, toml_table("[weights]", _quoted(weights))])


def _quoted(table: Mapping[str, object]) -> dict[str, object]:
    return {toml_value(name): list(v) if isinstance(v, tuple) else v for name, v in table.items()}
