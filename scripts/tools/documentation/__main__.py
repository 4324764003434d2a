"""Is everything explained, and does the built site ask nothing of the network?

    python -m scripts.tools.documentation [--site site/VERSION] [--index] [--table]

Every command, option, key of a TOML file, marker set, result file, column, finding code and public
Python name needs a page (`--table` prints which). With `--site`: nothing may be loaded from
elsewhere, and types of ours in signatures must lead to a page (whether links lead somewhere, MkDocs
itself says: `validation` in `mkdocs.yml`). Exit code 1 where something is missing.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path

from scripts.tools.documentation import coverage

LEADS = """<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><title>gaitcal</title>
<meta http-equiv="refresh" content="0; url={newest}/index.html"></head>
<body><p><a href="{newest}/index.html">gaitcal {newest}</a></p></body></html>
"""


def write_index(site: Path) -> None:
    """Write `versions.json` and `index.html` of the versions that lie in a folder, the newest
    first; a version is a folder whose name is one (`0.3.0`).
    """
    found = [
        path.parent.name for path in site.glob("*/index.html") if path.parent.name[0].isdigit()
    ]
    names = sorted(
        found,
        key=lambda name: [int(part) for part in name.split(".") if part.isdigit()],
        reverse=True,
    )
    listed = [
        {"version": name, "title": name, "aliases": ["latest"] if k == 0 else []}
        for k, name in enumerate(names)
    ]
    (site / "versions.json").write_text(json.dumps(listed, indent=1) + "\n", encoding="utf-8")
    (site / "index.html").write_text(LEADS.format(newest=names[0]), encoding="utf-8")


LOADED = re.compile(
    r'<(?!a\s|link rel="?(?:canonical|next|prev))[^>]*\s(?:src|href)="?((?:https?:)?//[^"\s>]+)'
)
"""An address elsewhere that a page loads by itself, and that is no link to be clicked."""
NO_PAGE = re.compile(r'<span[^>]*title="(gaitcal(?:\.\w+)+\.[A-Z]\w*[a-z]\w*)"')
"""A class in a signature; one that has a page is a link instead."""


def faults_of(site: Path) -> Iterator[str]:
    """What a built site should not have."""
    for path in sorted(site.rglob("*.html")):
        text = path.read_text(encoding="utf-8")
        yield from (
            f"{path.relative_to(site)}: loads {address}" for address in LOADED.findall(text)
        )
        if path.stem == "python":
            yield from (
                f"type without a page: {name}" for name in sorted(set(NO_PAGE.findall(text)))
            )


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--site", type=Path, help="folder of the built site")
    parser.add_argument("--table", action="store_true", help="print what is explained where")
    parser.add_argument(
        "--index", action="store_true", help="list the versions of the site that lie side by side"
    )
    chosen = parser.parse_args(arguments)
    if chosen.table:
        print(coverage.markdown())
    counts = Counter(item.kind for item in coverage.items())
    print(
        "explained: " + ", ".join(f"{number} of kind '{kind}'" for kind, number in counts.items())
    )
    faults = [*coverage.faults(), *(faults_of(chosen.site) if chosen.site else ())]
    if chosen.site and chosen.index and not faults:
        write_index(chosen.site.parent)
    for fault in faults:
        print(fault, file=sys.stderr)
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
