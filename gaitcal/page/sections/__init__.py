"""The tables, sentences and pictures of each preset of the page, as plain data (`blocks.py`)."""

from gaitcal.page.sections.sections import result_lines, result_sections, trial_sections

__all__ = ["result_lines", "result_sections", "trial_sections"]
