"""`python -m scripts.validation one_body`: a table over a person, and faults that are found."""

from __future__ import annotations

import pytest

from scripts.validation import one_body as check


@pytest.mark.slow
def test_the_table_of_one_person(capsys: pytest.CaptureFixture[str]) -> None:
    assert check.main(["--people", "1", "--draws", "1", "--only", "exchanged"]) == 0
    printed = capsys.readouterr().out
    rows = {line[:38].strip(): line[38:].split() for line in printed.splitlines() if "exchanged" in line}
    assert rows["sides exchanged"] == ["1", "100", "100", "100"]
    assert rows["labels exchanged throughout"][1] == "100"
    assert "findings on sound studies: 0" in printed
