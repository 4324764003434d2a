"""Everything that the page of a calibration says in words and formatted numbers."""

from collections.abc import Iterator, Mapping
from typing import Any

from gaitcal.page.page_data import calibration_page_data
from gaitcal.session.result import Calibration


def page_words(calibration: Calibration) -> str:
    """A line for each piece: verdict, top lines, sections of the result and of its trials."""
    sheet = calibration_page_data(calibration)
    parts = (sheet["verdict"], sheet["lines"], sheet["sections"], [trial["sections"] for trial in sheet["trials"]])
    return "\n".join(_pieces(parts))


def _pieces(data: Any) -> Iterator[str]:
    if isinstance(data, str):
        yield data
    elif isinstance(data, Mapping):
        for value in data.values():
            yield from _pieces(value)
    elif isinstance(data, list | tuple):
        for value in data:
            yield from _pieces(value)
