"""Real people stand beside the experimental figures and are told apart from them."""

from __future__ import annotations

from pathlib import Path

import pytest

from gaitcal.published.people import people_rows


def test_no_recordings_no_rows(tmp_path: Path) -> None:
    assert people_rows(tmp_path) == []


@pytest.mark.slow
def test_subject01_and_uf3(data_dir: Path) -> None:
    said: list[str] = []
    rows = {(r.table, r.row, r.column): r for r in people_rows(data_dir, said.append)}
    assert all(r.published is None and r.ours is not None for r in rows.values())
    assert all("another person" in r.note for r in rows.values())
    for joint in ("hip", "knee", "ankle"):
        before, after = (
            rows["I", f"uf3, {words}: marker distance RMS", joint].ours for words in ("anatomical", "phase 1")
        )
        assert before is not None and after is not None
        assert rows["I", "uf3: fall of marker distance", joint].ours == pytest.approx(100.0 * (1.0 - after / before))
        assert after < before
    force = {
        words: rows["III", f"subject01, {words}", "residual force RMS"].ours for words in ("phase 1", "third step")
    }
    assert (force["third step"] or 0.0) < 0.6 * (force["phase 1"] or 0.0)
    scaled = [
        rows["discussion", f"subject01, torque divided by {w}", "residual torque RMS"].ours for w in ("BW*H", "BW*1 mm")
    ]
    assert (scaled[1] or 0.0) < (scaled[0] or 0.0)
    assert any("third step" in line for line in said)
