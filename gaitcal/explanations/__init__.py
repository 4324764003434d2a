"""What every code means: one page each, in Markdown, brought with the package and read without a network.

A page has a title, says how bad it can be, and has the parts `PARTS`. The program, the page of a result and the
documentation show the same text.
"""

from gaitcal.explanations.explanation import (
    PARTS,
    Bullets,
    Explanation,
    Paragraph,
    Verbatim,
    all_explanations,
    explanation_of,
    parts_of,
)

__all__ = ["PARTS", "Bullets", "Explanation", "Paragraph", "Verbatim", "all_explanations", "explanation_of", "parts_of"]
