"""`python -m scripts.validation force_faults`: what it counts, and that it runs."""

from typing import Any

import numpy as np
import pytest

from scripts.validation.force_faults import faults
from scripts.validation.harness import main


def test_every_fault_changes_a_recording_and_says_how_large_it_is() -> None:
    from tests.quality.walks import exact_walk

    recording = exact_walk().recording
    kinds = set()
    for make in faults.FAULTS:
        fault = make(np.random.default_rng(3), None)
        changed = fault.change(recording)
        same = np.array_equal(changed.markers, recording.markers)
        pairs = zip(recording.plates, changed.plates, strict=True)
        assert not same or any(not np.array_equal(a.wrench(), b.wrench()) for a, b in pairs), (
            fault.row
        )
        kinds.add(fault.row)
    assert len(kinds) == len(faults.FAULTS)


@pytest.mark.slow
def test_the_script_runs_on_a_synthetic_person(
    monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    monkeypatch.delenv("GAITCAL_DATA", raising=False)
    assert main(["force_faults", "--cases", "2", "--only", "synthetic3", "--seed", "1"]) in (0, 1)
    said = capsys.readouterr().out
    assert "told: 0 causes, 0 unexplained" in said and "right cause first in" in said
