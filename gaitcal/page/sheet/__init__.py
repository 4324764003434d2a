"""What the page tells beside the body in motion: curves, strides, events, tables. Plain data, kept as `page.json`."""

from gaitcal.page.sheet.merging import doubted, followed_by, merged, only, renamed
from gaitcal.page.sheet.rows import sheet_rows
from gaitcal.page.sheet.sheet import calibration_sheet, further_sheet, person_sheet
from gaitcal.page.sheet.sheet_file import SHEET, read_sheet, sheet_text, write_sheet
from gaitcal.page.sheet.thinning import curves_left_out, thinned
from gaitcal.page.sheet.trial_curves import curves_of
from gaitcal.page.sheet.trial_sheet import trial_sheet

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
