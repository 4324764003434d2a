"""The versions of the site that lie side by side: a list that their pages read, and a page that leads to the newest.

    python -m scripts.tools.documentation.versions SITE

A version is a folder of SITE whose name is one (`0.3.0`); older ones stay where they are.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

LEADS = """<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><title>gaitcal</title>
<meta http-equiv="refresh" content="0; url={newest}/index.html"></head>
<body><p><a href="{newest}/index.html">gaitcal {newest}</a></p></body></html>
"""


def versions_in(site: Path) -> list[str]:
    """Names of the built versions, the newest first."""
    found = [path.parent.name for path in site.glob("*/index.html") if path.parent.name[0].isdigit()]
    return sorted(found, key=lambda name: [int(part) for part in name.split(".") if part.isdigit()], reverse=True)


def write(site: Path) -> list[str]:
    """Write `versions.json` and `index.html`; returns the versions."""
    names = versions_in(site)
    listed = [{"version": name, "title": name, "aliases": ["latest"] if k == 0 else []} for k, name in enumerate(names)]
    (site / "versions.json").write_text(json.dumps(listed, indent=1) + "\n", encoding="utf-8")
    (site / "index.html").write_text(LEADS.format(newest=names[0]), encoding="utf-8")
    return names


if __name__ == "__main__":
    write(Path(sys.argv[1]))
