"""What the page tells beside the body in motion: curves, strides, events, tables. Plain data, kept as `page.json`."""

from gaitcal.page.sheet.rows import sheet_rows
from gaitcal.page.sheet.sheet import (
    SHEET,
    calibration_sheet,
    curves_left_out,
    doubted,
    followed_by,
    further_sheet,
    merged,
    only,
    person_sheet,
    read_sheet,
    renamed,
    sheet_text,
    thinned,
    write_sheet,
)
from gaitcal.page.sheet.trial_sheet import curves_of, trial_sheet

__all__ = [
    "SHEET",
    "calibration_sheet",
    "curves_left_out",
    "curves_of",
    "doubted",
    "followed_by",
    "further_sheet",
    "merged",
    "only",
    "person_sheet",
    "read_sheet",
    "renamed",
    "sheet_rows",
    "sheet_text",
    "thinned",
    "trial_sheet",
    "write_sheet",
]
