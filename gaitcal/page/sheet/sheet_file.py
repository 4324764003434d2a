"""`page.json` of a result folder: the sheet, from which its page is made again at any time."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from gaitcal.codes import Code
from gaitcal.errors import InputError
from gaitcal.page.sheet.sheet import FORMAT

SHEET: Final = "page.json"


def sheet_text(sheet: Mapping[str, Any] | None) -> str:
    """JSON that is all ASCII and may stand inside a `<script>` element whatever the names are: it holds no `<`."""
    return json.dumps(sheet, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")


def write_sheet(sheet: Mapping[str, Any], path: Path) -> None:
    """Write a sheet; the page reads the same text."""
    path.write_text(sheet_text(sheet), encoding="utf-8")


def read_sheet(path: Path) -> dict[str, Any]:
    """Read back what `write_sheet` wrote.

    Raises
    ------
    InputError
        The file is not there, or is no sheet of this version.
    """
    try:
        sheet = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise InputError(f"cannot be read: {error}", source=path, code=Code.DAMAGED_RESULT) from None
    if not isinstance(sheet, dict) or sheet.get("format") != FORMAT or not isinstance(sheet.get("trials"), list):
        raise InputError("is no page of this version; calibrate again", source=path, code=Code.NO_RESULT)
    return sheet
