"""The report of a calibration: one self-contained page, and its figures as files for papers."""

from gaitcal.report.figure_files import write_figures
from gaitcal.report.html import report_html, write_report

__all__ = ["write_report", "report_html", "write_figures"]
