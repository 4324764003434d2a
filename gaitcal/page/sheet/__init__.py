"""What the page tells beside the body in motion: curves, strides, events, tables. Plain data, kept as `page.json`."""

from gaitcal.page.sheet.rows import sheet_rows
from gaitcal.page.sheet.sheet import calibration_sheet, merged, person_sheet
from gaitcal.page.sheet.sheet_file import SHEET, read_sheet, write_sheet
from gaitcal.page.sheet.trial_curves import curves_of
from gaitcal.page.sheet.trial_sheet import trial_sheet

__all__ = [
    "SHEET",
    "calibration_sheet",
    "curves_of",
    "merged",
    "person_sheet",
    "read_sheet",
    "sheet_rows",
    "trial_sheet",
    "write_sheet",
]
