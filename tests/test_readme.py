"""The README is short, and what it leads to is there."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[1]
MOST_LINES = 120
"""What a visitor reads; the rest is in `docs/`."""


def test_the_readme_is_short_and_its_links_lead_somewhere() -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    assert len(text.splitlines()) <= MOST_LINES
    links = re.findall(r"\]\(([^)#]+)\)", text)
    assert len(links) > 10
    assert [link for link in links if not (ROOT / link).exists()] == []
    scripts = set(re.findall(r"scripts/\w+\.\w+", text))
    assert [name for name in scripts if not (ROOT / name).exists()] == []
