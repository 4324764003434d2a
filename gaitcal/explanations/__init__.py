"""What every code means: one page each, in Markdown, brought with the package and read without a network.

A page has a title, how bad it can be, and these parts, for which the program, the page of a result and the documentation
read the same text: `PARTS`.
"""

from gaitcal.explanations.explanation import PARTS, Explanation, all_explanations, explanation_of
from gaitcal.explanations.markdown import Bullets, Paragraph, Verbatim, parts_of

__all__ = [
    "PARTS",
    "Bullets",
    "Explanation",
    "Paragraph",
    "Verbatim",
    "all_explanations",
    "explanation_of",
    "parts_of",
]
