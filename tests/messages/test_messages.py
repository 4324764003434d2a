"""What holds messages to their reviewed wording."""

from pathlib import Path

import pytest

import tests.messages as messages
from gaitcal.errors import Code, InputError
from tests.messages import check_text, numbers, read_book, refuses, without_figures, write_book


def test_figures_and_folders_are_no_wording() -> None:
    text = "/tmp/x/walk.csv: C7 at 0.30-0.49 s, -2 mm, 1e-3; version 1.2.3"
    assert numbers(text) == [0.3, 0.49, -2.0, 0.001]
    assert without_figures(text) == "walk.csv: C7 at #-# s, # mm, #; version #"


@pytest.mark.parametrize(
    ("what", "parts", "field"),
    [(Code.TOML, (1,), "mass"), (Code.BAD_VALUE, (2,), "mass"), (Code.BAD_VALUE, (1,), "height")],
)
def test_another_code_number_or_field_fails(what: Code, parts: tuple[int], field: str) -> None:
    with pytest.raises(AssertionError), refuses(what, *parts, field=field):
        raise InputError("found 1", field="mass", code=Code.BAD_VALUE)


def test_a_missing_name_fails() -> None:
    with pytest.raises(AssertionError):
        check_text(["R.Heel left its place"], "L.Heel")


def test_written_messages_are_read_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    book = read_book()
    monkeypatch.setattr(messages, "FILES", {s: tmp_path / n for s, n in messages.FILES.items()})
    write_book(book)
    for path in tmp_path.iterdir():
        kept = messages.FOLDER / path.name
        assert path.read_text(encoding="utf-8") == kept.read_text(encoding="utf-8")
