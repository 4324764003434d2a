"""A marker set written out says the same as the file it came from."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from gaitcal.model.marker_set import NO_REASON, built_in_sets, load_marker_set, marker_set_text


@pytest.mark.parametrize("name", built_in_sets())
def test_built_in_sets_come_back(name: str, tmp_path: Path) -> None:
    made = load_marker_set(name)
    path = tmp_path / f"{name}.toml"
    path.write_text(marker_set_text(made), encoding="utf-8")
    assert load_marker_set(path) == made


def test_weights_and_labels_of_a_study(tmp_path: Path) -> None:
    made = load_marker_set("published")
    tracked = next(iter(made.tracking.values()))[0]
    odd = 'a "b" \\ {x} é'
    aliases = {**made.aliases, tracked: (odd,)}
    made = replace(made, aliases=aliases).with_weights({tracked: 0.25, "not tracked": 0.0})
    path = tmp_path / "marker_set.toml"
    path.write_text(marker_set_text(made), encoding="utf-8")
    back = load_marker_set(path)
    assert back.weight(tracked) == 0.25 and back.reasons[tracked] == NO_REASON
    assert "not tracked" not in back.weights
    assert back.aliases[tracked] == (odd,)
