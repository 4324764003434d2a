"""The tables, sentences and pictures of each preset of the page, as plain data (`blocks.py`).

`monte_carlo.py` adds a study to a finished sheet; only its command reads that module, and with it the libraries of a
study.
"""

from gaitcal.page.sections.fit import Origin, further_lines, further_sections, recorded_blocks
from gaitcal.page.sections.sections import result_lines, result_sections, trial_sections

__all__ = [
    "Origin",
    "further_lines",
    "further_sections",
    "recorded_blocks",
    "result_lines",
    "result_sections",
    "trial_sections",
]
